"""The fleet file: TOML, typed and strict, one for the whole fleet.

fleet = "alpha"

[origin]
lat_deg = 52.756
lon_deg = -1.246
alt_amsl = 60.0

[failsafe]                      # what happens when a stream of setpoints stops
hold_after = 0.5
land_after = 30.0               # or "never"
action = "rtl"                  # or "loiter", "land"
return = "together"             # the planner's way home for everybody first, where it sent one; absent: none

[geofence]                      # nothing is flown beyond it; what is absent is as for a club's field
radius = 300.0                  # m about the origin (1000); inf: none
polygon = [[52.75, -1.25], [52.76, -1.25], [52.76, -1.24]]
floor = 2.0                     # m above home (the ground there)
ceiling = 60.0                  # m above home (120)

[limits]                        # nor faster; what is absent is 30 m/s, and 10 m/s up and down
speed = 12.0
climb = 3.0
descend = 2.0

[body]                          # how much room a vehicle needs and what it can do, for planners
radius = 0.8
speed = 5.0
reserve = 0.25                  # share of its battery with which it is to be on the ground again (0.2)

[separation]                    # vehicles move aside for each other by themselves, as a last resort
on = true

[traffic]                       # aircraft that are not of the fleet: docs/traffic.md
mates = true                    # each autopilot is told of the others in flight, as ADSB_VEHICLE (false)
distance = 500.0                # m over the ground, and of height, within which one is warned of
height = 150.0

[rights]                        # orders that are the operators' unless they are given away here
planner = ["servo"]             # and mission_upload, mission_clear

[ros2]
domain = 0                      # routers with credentials let this domain of ROS through, by role; absent: no ROS
beside = ["quad1"]              # 'zmav ros2' runs on these vehicles' own computers
orders = true                   # what ROS says there may move and change them

[vehicles.quad1]
link = "/dev/ttyAMA0,921600"
listen = ["tcp/127.0.0.1:7447", "udp/10.77.0.1:7447?rel=1;mixed_rel=1"]
connect = ["udp/10.77.0.2:7447?rel=1;mixed_rel=1"]

[vehicles.quad1.cameras.down]   # its encoded video, the stream with most bytes first: 'zmav video run'
streams = ["rtsp://192.168.144.25:8554/main", "rtsp://192.168.144.25:8554/sub"]

[vehicles.quad1.pilot_switch]   # while the radio's channel 7 is high, no agent has the vehicle
channel = 7
low = 1700
high = 2200

``[mesh]``, ``[vehicles.quad1.mesh]`` and ``[stations.ground]`` are for the network: :mod:`zmav.config.mesh`.
``[sim]`` and ``[vehicles.quad1.sim]`` are for the simulator: :mod:`zmav.sim.fleetfile` says what they hold.
``[demo]`` is for ``zmav demo``.
A vehicle's own ``failsafe``, ``geofence``, ``limits`` or ``body`` table takes the whole place of the fleet's.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import msgspec

from zmav import keys, wire
from zmav.config.body import BodyConfig, check_body
from zmav.config.camera import CameraConfig
from zmav.config.mesh import Host, Mesh, Profile, check_hosts
from zmav.config.table import Positive, Table, convert, reading
from zmav.errors import BadConfig

Action = Literal["loiter", "rtl", "land"]
RETURN_LEAD = 3.0
"""s for which the first place of a way home is streamed before it begins, and the mode that follows it asked for"""
H = TypeVar("H")


class Failsafe(Table, frozen=True):
    """The vehicle's answers to a stream of setpoints that stops, in seconds since the last good one."""

    hold_after: Annotated[float, msgspec.Meta(ge=0.1, le=5.0)] = 0.5
    """then it holds its position"""
    land_after: Annotated[float, msgspec.Meta(ge=1.0, le=86_400.0)] | Literal["never"] = 30.0
    """then it does ``action``"""
    action: Action = "rtl"
    returns: Literal["together"] | None = msgspec.field(default=None, name="return")
    """then, in the place of ``action``, the way home that a planner sent with its last segment, where it has one"""

    @property
    def returns_after(self) -> float | None:
        """s after a segment's end at which such a way may begin; None: none is asked for."""
        return None if self.returns is None or self.land_after == "never" else self.land_after + RETURN_LEAD


class Geofence(Table, frozen=True):
    """Where vehicles may be led. A part that is absent is as for a club's field; ``inf`` bounds nothing."""

    polygon: list[tuple[float, float]] = []
    """corners as latitude and longitude in degrees, three or more; the last one joins the first"""
    radius: Positive | None = None
    """m over the ground from the fleet's origin; absent: 1000 about the origin, or home, where there is no polygon"""
    floor: float | None = None
    """m above home; absent: the ground there, which vehicles that stay on the surface are free of"""
    ceiling: float | None = None
    """m above home; absent: 120"""
    above_ground: float | None = None
    """m above the ground, where 'zmav terrain load' has told how high that is: of places, straight ways and segments,
    not of velocities, landings and climbs. With it, ground that is not known is refused; absent: only what is 10 m deep
    in the ground is
    """


class Limits(Table, frozen=True):
    """How fast and how hard vehicles may be led. Speeds that are absent are as for a club's field; ``inf`` bounds
    nothing.
    """

    speed: Positive | None = None
    """m/s over the ground; absent: 30"""
    climb: Positive | None = None
    """m/s; absent: 10"""
    descend: Positive | None = None
    """m/s; absent: 10"""
    accel: Positive | None = None
    """m/s²"""
    tilt: Positive | None = None
    """rad, of an attitude from upright"""
    yaw_rate: Positive | None = None
    """rad/s"""


RADIUS, CEILING = 1000.0, 120.0
"""m: a club's field, which bounds a vehicle for which nobody has declared anything"""
SPEED, CLIMB, DESCEND = 30.0, 10.0, 10.0
"""m/s"""
_BOUNDLESS = {"radius": math.inf, "floor": -math.inf, "ceiling": math.inf}
BOUNDLESS = (*(f"geofence.{name}" for name in _BOUNDLESS), "limits.speed", "limits.climb", "limits.descend")


def usual_fence(declared: Geofence) -> Geofence:
    """What is declared, radius and ceiling filled up. An absent floor stays absent: the ground is no number here."""
    radius = declared.radius or (None if declared.polygon else RADIUS)
    ceiling = max(declared.floor or 0.0, 0.0) + CEILING if declared.ceiling is None else declared.ceiling
    return msgspec.structs.replace(declared, radius=radius, ceiling=ceiling)


def usual_limits(declared: Limits) -> Limits:
    """What is declared, the speeds filled up."""
    speed, climb, descend = declared.speed or SPEED, declared.climb or CLIMB, declared.descend or DESCEND
    return msgspec.structs.replace(declared, speed=speed, climb=climb, descend=descend)


class Separation(Table, frozen=True):
    """The last resort against a collision (:mod:`zmav.services.authority.separation`): all of a fleet, or none."""

    on: bool = False


class Traffic(Table, frozen=True):
    """Aircraft that are not of the fleet (:mod:`zmav.services.traffic`), and what autopilots are told of mates."""

    mates: bool = False
    """tell the autopilot of the fleet's others in flight, as ADSB_VEHICLE; what it does then, its parameters say"""
    within: Positive = 2000.0
    """m within which it is told of them"""
    distance: Positive = 500.0
    """m over the ground, now or at the closest approach within ``time`` s, within which an aircraft is warned of"""
    height: Positive = 150.0
    """m of height, the same"""
    time: Positive = 60.0


class Rights(Table, frozen=True):
    """What the fleet's operators give away, where it has credentials. The same in the files of all its routers."""

    planner: list[Literal["servo", "mission_upload", "mission_clear"]] = []
    """orders that planners, and programs on board for their own vehicle, may give besides their own"""


class Ros2(Table, frozen=True):
    """ROS 2 (docs/ros2.md). ``domain`` is the same in the files of all routers."""

    domain: Annotated[int, msgspec.Meta(ge=0, le=232)] | None = None
    """whose keys and tokens pass the doors of routers with credentials; None: no ROS does"""
    beside: list[str] = []
    """vehicles beside which 'zmav ros2' runs, each on the vehicle's own computer"""
    orders: bool = False
    """there, what ROS says may move and change the vehicle"""
    rates: dict[str, float] = {}
    """there, Hz of topics that are to come at least so fast"""


class PilotSwitch(Table, frozen=True):
    """A switch of the pilot's radio: while ``channel`` is from ``low`` to ``high`` µs, no agent has the vehicle."""

    channel: Annotated[int, msgspec.Meta(ge=1, le=18)]
    low: Annotated[int, msgspec.Meta(ge=700, le=2500)] = 1700
    high: Annotated[int, msgspec.Meta(ge=700, le=2500)] = 2200
    mode: str | None = None
    """what the autopilot is asked for where it follows setpoints; None: what it holds its position in by itself"""


class Signing(Table, frozen=True):
    """MAVLink 2 signing on the link to the autopilot; see :mod:`zmav.mavlink.signing`."""

    key_file: str
    """only its owner may read it; the last timestamp used is kept beside it"""
    unsigned: Literal["refuse", "accept"] = "refuse"
    """what happens to frames of the vehicle that are not signed"""
    sign_forwarded: bool = False
    """sign what others put on ``mav/tx``: anyone who may put there then speaks with the key"""
    link_id: Annotated[int, msgspec.Meta(ge=0, le=255)] = 0


class VehicleConfig(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """One vehicle's table."""

    link: str
    sysid: Annotated[int, msgspec.Meta(ge=1, le=255)] | None = None
    dialect: str = "ardupilotmega"
    listen: list[str] = []
    connect: list[str] = []
    failsafe: Failsafe | None = None
    geofence: Geofence | None = None
    limits: Limits | None = None
    body: BodyConfig | None = None
    pilot_switch: PilotSwitch | None = None
    cameras: dict[str, CameraConfig] = {}
    signing: Signing | None = None
    mesh: Host = Host()
    sim: dict[str, Any] | None = None
    """how ``zmav sim`` simulates it; None: not at all"""


class StationConfig(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """A host without a vehicle: a ground station, a relay, a rendezvous in the cloud."""

    listen: list[str] = []
    connect: list[str] = []
    mesh: Host = Host()


class FleetConfig(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """The whole file."""

    fleet: str = "demo"
    origin: wire.Origin | None = None
    failsafe: Failsafe = Failsafe()
    geofence: Geofence = Geofence()
    limits: Limits = Limits()
    body: BodyConfig | None = None
    separation: Separation = Separation()
    traffic: Traffic = Traffic()
    rights: Rights = Rights()
    ros2: Ros2 = Ros2()
    mesh: Mesh = Mesh()
    vehicles: dict[str, VehicleConfig] = {}
    stations: dict[str, StationConfig] = {}
    sim: dict[str, Any] = {}
    """the world of ``zmav sim``"""
    demo: dict[str, Any] = {}
    """what ``zmav demo`` does with it"""

    def hosts(self) -> dict[str, VehicleConfig | StationConfig]:
        """The tables of all hosts by their place in the file: ``vehicles.quad1``, ``stations.ground``."""
        vehicles = {f"vehicles.{name}": table for name, table in self.vehicles.items()}
        return {**vehicles, **{f"stations.{name}": table for name, table in self.stations.items()}}

    def host(self, name: str) -> VehicleConfig | StationConfig:
        """The table of a host, vehicle or not; raises :class:`BadConfig` naming those there are."""
        hosts: dict[str, VehicleConfig | StationConfig] = {**self.vehicles, **self.stations}
        return _named("host", name, hosts)

    def profile_of(self, host: Host) -> Profile:
        """The host's own, or else the fleet's."""
        return host.profile or self.mesh.profile

    def vehicle(self, name: str) -> VehicleConfig:
        """The table of that vehicle, the fleet's own filled in; raises :class:`BadConfig` naming those there are."""
        return self.filled(_named("vehicle", name, self.vehicles))

    def filled(self, table: VehicleConfig) -> VehicleConfig:
        """A vehicle's table, with the fleet's own where it has none."""
        return msgspec.structs.replace(
            table,
            failsafe=table.failsafe or self.failsafe,
            geofence=table.geofence or self.geofence,
            limits=table.limits or self.limits,
            body=table.body or self.body,
        )


def _named(what: str, name: str, tables: Mapping[str, H]) -> H:
    if name in tables:
        return tables[name]
    known = ", ".join(tables) or "none"
    raise BadConfig(f"no {what} {name!r} in the fleet file; it has {known}", field="name", value=name, expected=known)


def load_fleet(path: str | Path) -> FleetConfig:
    """Read a fleet file; raises :class:`BadConfig` that names the file, the field and what was expected."""
    with reading(path, "the fleet file"):
        fleet = convert(msgspec.toml.decode(Path(path).read_bytes()), FleetConfig, BOUNDLESS)
        for name in (fleet.fleet, *fleet.vehicles, *fleet.stations):
            keys.check_name(name)
        for name in fleet.stations:
            if name in fleet.vehicles:
                raise BadConfig.wrong(f"stations.{name}", name, "a name that no vehicle has")
        if fleet.origin:
            _check_origin(fleet.origin)
        _check_tables("", fleet)
        for name, table in fleet.vehicles.items():
            _check_tables(f"vehicles.{name}.", table)
            for camera in table.cameras:
                keys.check_name(camera, f"vehicles.{name}.cameras")
            check_fence(fleet.vehicle(name).geofence, fleet.origin, f"vehicles.{name}.geofence")
        _check_ros2(fleet)
        check_hosts(fleet.mesh, fleet.hosts())
        for (one, a), (other, b) in itertools.combinations(fleet.vehicles.items(), 2):
            if a.sysid is not None and a.sysid == b.sysid:
                raise BadConfig.wrong(f"vehicles.{other}.sysid", b.sysid, f"a system id of its own: {one} has this one")
            if a.link == b.link and not _links_apart(a, b):
                raise BadConfig.wrong(f"vehicles.{other}.link", b.link, f"a link of its own: {one} has this one")
    return fleet


def _links_apart(a: VehicleConfig, b: VehicleConfig) -> bool:
    """The same link of two vehicles is two: a serial port, or a port listened at, of each one's own computer."""
    scheme, _, place = a.link.partition(":")
    if scheme not in ("tcp", "udpout", "udpin"):
        return True
    if a.sim is not None and b.sim is not None:
        return False  # one simulator serves both
    if scheme == "udpin":
        return True
    here = place.startswith(("127.", "localhost", "[::1]"))
    return here and all(table.mesh.radios or table.listen or table.connect for table in (a, b))


def _check_tables(place: str, tables: FleetConfig | VehicleConfig) -> None:
    """What types cannot say: numbers that go together."""
    if tables.body:
        check_body(tables.body, f"{place}body")
    if tables.failsafe:
        check_failsafe(tables.failsafe, f"{place}failsafe")
    if isinstance(tables, FleetConfig):
        check_fence(tables.geofence, tables.origin, "geofence")
    elif tables.pilot_switch and tables.pilot_switch.low >= tables.pilot_switch.high:
        raise BadConfig.wrong(
            f"{place}pilot_switch.low", tables.pilot_switch.low, f"less than {tables.pilot_switch.high}"
        )


def _check_ros2(fleet: FleetConfig) -> None:
    for name in fleet.ros2.beside:
        if name not in fleet.vehicles:
            raise BadConfig.wrong("ros2.beside", name, f"a vehicle of this file: {', '.join(fleet.vehicles) or 'none'}")
    if fleet.ros2.beside and fleet.ros2.domain is None:
        raise BadConfig.wrong("ros2.domain", None, "a number, for 'zmav ros2' beside vehicles")


def check_failsafe(failsafe: Failsafe, field: str = "failsafe") -> Failsafe:
    """``failsafe`` itself; raises :class:`BadConfig` where its steps are not in order."""
    if failsafe.land_after != "never" and failsafe.land_after <= failsafe.hold_after:
        raise BadConfig.wrong(
            f"{field}.land_after", failsafe.land_after, f"more than hold_after ({failsafe.hold_after} s)"
        )
    if failsafe.returns and failsafe.land_after == "never":
        raise BadConfig.wrong(f"{field}.return", failsafe.returns, 'a land_after that is not "never", which it follows')
    return failsafe


def check_fence(fence: Geofence | None, origin: wire.Origin | None, field: str) -> None:
    """Raise :class:`BadConfig` where a fence encloses nothing."""
    if fence is None:
        return
    if fence.polygon and len(fence.polygon) < 3:
        raise BadConfig.wrong(f"{field}.polygon", fence.polygon, "three corners or more")
    for lat, lon in fence.polygon:
        if not (abs(lat) <= 89.0 and abs(lon) <= 180.0):
            raise BadConfig.wrong(f"{field}.polygon", [lat, lon], "latitude and longitude in degrees")
    for name in _BOUNDLESS:
        value = getattr(fence, name)
        if value is not None and not (abs(value) <= 100_000.0 or value == _BOUNDLESS[name]):
            raise BadConfig.wrong(f"{field}.{name}", value, "a number of metres")
    if fence.above_ground is not None and not 0.0 <= fence.above_ground <= 10_000.0:
        raise BadConfig.wrong(f"{field}.above_ground", fence.above_ground, "metres above the ground")
    if fence.floor is not None and fence.ceiling is not None and fence.floor >= fence.ceiling:
        raise BadConfig.wrong(f"{field}.floor", fence.floor, f"less than the ceiling ({fence.ceiling} m)")
    if fence.radius not in (None, math.inf) and origin is None:
        text = f"{field}.radius is about the fleet's origin, and none is declared"
        raise BadConfig(text, field=f"{field}.radius", value=fence.radius, expected="an origin")


def origin_of(lat_deg: float, lon_deg: float, alt_amsl: float) -> wire.Origin:
    """The fleet's origin at a place that there is; raises :class:`BadConfig` otherwise."""
    return _check_origin(wire.Origin(lat_deg=lat_deg, lon_deg=lon_deg, alt_amsl=alt_amsl))


def _check_origin(origin: wire.Origin) -> wire.Origin:
    for name, most in (("lat_deg", 89.0), ("lon_deg", 180.0), ("alt_amsl", 10_000.0)):
        value = getattr(origin, name)
        if not abs(value) <= most:  # so that NaN is refused, too
            text = f"the origin's {name} is {value}; expected ±{most:.0f} at most"
            raise BadConfig(text, field=f"origin.{name}", value=value, expected=f"±{most:.0f}")
    return origin
