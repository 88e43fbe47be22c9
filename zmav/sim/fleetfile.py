"""What a simulator reads in zmav's own fleet file, so that one file starts the simulator and the agents alike.

fleet = "alpha"

[origin]                        # also the world's origin, unless [sim] has a home
lat_deg = 47.3977
lon_deg = 8.5456
alt_amsl = 488.0

[sim]                           # the world; all of it may be absent
wind = "5@270,gusty"
speed = 1.0                     # 0: as fast as it goes
scene = "field.toml"            # what cameras see, beside this file

[vehicles.quad1]
link = "tcp:127.0.0.1:5760"     # where 'zmav up --file ... --name quad1' finds it: the simulator is reached there
sysid = 1

[vehicles.quad1.sim]            # it is simulated; an empty table is an ArduCopter with all its defaults
airframe = "hexa"
start_ned_m = [0.0, 10.0, 0.0]
params = { FS_GCS_ENABLE = 1 }

A vehicle without a ``sim`` table is not simulated. Everything else in the file is for :mod:`zmav.config`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from zmav.config import FleetConfig, VehicleConfig, load_fleet
from zmav.errors import BadConfig, BadInput
from zmav.sim.camera.scene import Scene, load_scene
from zmav.sim.spec import PX4, Home, VehicleSpec, check
from zmav.sim.values import check_home, parse_wind

T = TypeVar("T")
_SOCKET = re.compile(r"(tcp|udpin|udpout):(.*):(\d+)", re.ASCII)
_SERIAL = re.compile(r"(?:serial:)?(/[^,:]*)(?:[,:]\d+)?", re.ASCII)
_ANY_HOST = ("", "0.0.0.0")
_LOOPBACK = "127.0.0.1"
_PX4_REMOTE, _PX4_LOCAL, _PX4_LINKS = 14540, 14580, 10


class WorldTable(msgspec.Struct, kw_only=True, forbid_unknown_fields=True, frozen=True):
    """``[sim]``: options of :class:`zmav.sim.World`, with units in their names or as the command line has them."""

    home: Home | None = None
    wind: str = "0"
    """SPEED[@FROM][,gusty|light|moderate|severe]"""
    noise: str = "none"
    spacing_m: float = 10.0
    speed: float = 1.0
    """times real time; 0: as fast as it goes"""
    lockstep: bool = False
    tick_hz: int = 100
    seed: int = 0
    real_boot: bool = False
    scene: str | None = None
    """a scene file; a path that is not absolute starts at the fleet file"""


class FleetFile(msgspec.Struct, frozen=True):
    """What a simulator needs of a fleet file."""

    world: WorldTable
    home: Home | None
    scene: Scene | None
    vehicles: list[VehicleSpec]


def load_simulated(path: str | Path) -> FleetFile:
    """Read a fleet file; raises :class:`BadConfig` that names the file, the field and what was expected."""
    fleet = load_fleet(path)
    try:
        world = _convert(fleet.sim, WorldTable, "sim")
        parse_wind(world.wind)
        simulated = {name: table for name, table in fleet.vehicles.items() if table.sim is not None}
        if not simulated:
            expected = "a table [vehicles.NAME.sim] for each vehicle to simulate"
            raise BadConfig(f"nothing is to be simulated; expected {expected}", field="vehicles", expected=expected)
        vehicles = [_spec(name, table) for name, table in simulated.items()]
        home = check_home(world.home) if world.home else _home(fleet)
    except BadInput as e:
        raise BadConfig(f"{path}: {e}", **e.detail) from None
    scene = load_scene(Path(path).parent / world.scene) if world.scene else None
    return FleetFile(world, home, scene, vehicles)


def _home(fleet: FleetConfig) -> Home | None:
    origin = fleet.origin
    return Home(origin.lat_deg, origin.lon_deg, origin.alt_amsl) if origin else None


def _convert(table: Mapping[str, Any], kind: type[T], where: str) -> T:
    """``table`` as a ``kind``, strictly; :class:`BadConfig` names the field within ``where``."""
    try:
        return msgspec.convert(table, kind)
    except msgspec.ValidationError as e:
        what, _, place = str(e).partition(" - at `$")
        field = where + place.strip("`")
        raise BadConfig(f"{what} (at {field})", field=field, expected=what) from None


def _spec(name: str, table: VehicleConfig) -> VehicleSpec:
    """``[vehicles.NAME.sim]``: what a :class:`VehicleSpec` holds, but for name and system id, which the vehicle has."""
    where = f"vehicles.{name}.sim"
    given = _convert(table.sim or {}, VehicleSpec, where)
    for field in ("name", "sysid"):
        if getattr(given, field) is not None:
            expected = f"none here: the {field} is the one that [vehicles.{name}] has"
            raise BadConfig.wrong(
                f"{where}.{field}", getattr(given, field), expected, f"{where}.{field} is {getattr(given, field)!r}"
            )
    check(given, where)
    endpoints = given.endpoints or (_endpoint(table.link, given.autopilot, f"vehicles.{name}.link"),)
    return msgspec.structs.replace(given, name=name, sysid=table.sysid, endpoints=endpoints)


def _endpoint(link: str, autopilot: str, field: str) -> str:
    """Where a vehicle has to be for an agent with that ``link`` to find it."""
    plain = link.partition("?")[0]
    found = _SOCKET.fullmatch(plain)
    if found:
        kind, host, port = found[1], found[2], int(found[3])
        if kind == "tcp":
            return f"tcp:{host or _LOOPBACK}:{port}"
        if kind == "udpout":
            return f"udp-listen:{host or _LOOPBACK}:{port}"
        to = _LOOPBACK if host in _ANY_HOST else host
        if autopilot != PX4:
            return f"udp:{to}:{port}"
        number = port - _PX4_REMOTE
        local = _PX4_LOCAL + number if 0 <= number < _PX4_LINKS else 0
        return f"onboard:{local}:{to}:{port}"
    serial = _SERIAL.fullmatch(plain)
    if serial and not serial[1].startswith("/dev/"):
        return f"pty:{serial[1]}"
    expected = (
        "tcp:HOST:PORT, udpin:HOST:PORT, udpout:HOST:PORT or a path outside /dev, or else 'endpoints' in the vehicle's "
        "sim table"
    )
    raise BadConfig.wrong(field, link, expected, f"{field} {link!r} cannot be simulated")


def speed_of(world: WorldTable) -> float:
    """Times real time, as :class:`zmav.sim.World` takes it."""
    return world.speed or math.inf
