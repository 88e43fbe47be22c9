"""One vehicle in flight: what its kind is asked, what it says, what it is told, and where it may go. The checks are
made of this, and have no branches by kinds.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import zenoh

import zmav
from agents.hil.report import Check, Report, Status
from zmav import geo, keys, wire
from zmav.autopilots import autopilot_named
from zmav.children import Children
from zmav.config import FleetConfig
from zmav.errors import TimedOut, Unsupported, ZmavError
from zmav.mavlink import Packer, load_dialect
from zmav.services.authority.limits import Fence

HOVERS = ("ready", "arm", "takeoff", "square", "holder killed", "fence", "speed limit", "pilot", "home")
DRIVES = ("ready", "arm", "square", "holder killed", "fence", "speed limit", "pilot", "home")
CIRCLES = ("ready", "arm", "takeoff", "square", "holder killed", "fence", "pilot", "home")


@dataclass(frozen=True)
class Kind:
    """One kind of vehicle under one autopilot; metres, m/s, seconds."""

    autopilot: str
    kind: str
    pilots_mode: str
    """a mode that a pilot may choose, and no order of the flight's does"""
    steps: tuple[str, ...] = HOVERS
    height: float = 6.0
    """of the takeoff; 0: it has none"""
    side: float = 8.0
    """of the square"""
    least: float = 4.0
    """side below which it is not tried: the fence leaves no room"""
    near: float = 1.5
    """so close to a corner is there"""
    leg: float = 30.0
    """s for one side"""
    velocity: wire.Vector | None = (0.0, 1.5, 0.0)
    """streamed by who is then killed; None: it takes none, and flies to a far place"""
    rests: bool = True
    """its hold is a rest; else it circles"""
    lands: bool = True
    """its way home ends disarmed"""


KINDS = (
    Kind("ardupilot", "copter", "LOITER"),
    Kind("px4", "copter", "HOLD"),
    Kind("ardupilot", "rover", "MANUAL", DRIVES, height=0.0, side=12.0, least=8.0, near=3.2, leg=40.0, lands=False),
    Kind(
        "ardupilot",
        "plane",
        "CIRCLE",
        CIRCLES,
        height=50.0,
        side=300.0,
        least=200.0,
        near=130.0,
        leg=60.0,
        velocity=None,
        rests=False,
        lands=False,
    ),
)


def kind_of(autopilot: str | None, kind: str | None) -> Kind:
    """Raises :class:`Unsupported` for what there is no check flight for."""
    for each in KINDS:
        if (each.autopilot, each.kind) == (autopilot, kind):
            return each
    known = ", ".join(f"{each.kind} by {each.autopilot}" for each in KINDS)
    raise Unsupported(f"there is no check flight for a {kind} by {autopilot}; there is for {known}", kind=kind)


PACE, HURRY = 1.0, 5.0
"""times real time, where the simulator is ours: the checks, and ways up and home"""
STATION = 190
"""component id of a ground station's radio"""


class Failed(ZmavError):
    """A check has not been passed; the flight ends."""

    code = "failed"


class LeftOut(Exception):
    """A check cannot be tried, for this reason; the flight goes on."""


class Flight:
    """One vehicle in flight, and what its checks use. ``tell`` takes each check as it is made; ``hurry`` sets the
    simulator's speed, and ``radio`` a channel of its pilot's (from 1) to µs, where the simulator can.
    """

    def __init__(
        self,
        client: zmav.Client,
        file: FleetConfig,
        name: str,
        router: str,
        children: Children,
        report: Report,
        tell: Callable[[Check], None],
        hurry: Callable[[float], object] | None = None,
        radio: Callable[[int, int], object] | None = None,
    ) -> None:
        self.client, self.file, self.router, self.children, self.report = client, file, router, children, report
        self.fleet, self.vehicle, self.table = file.fleet, client.vehicle(name), file.vehicle(name)
        self.events: list[wire.Event] = []
        self.kind: Kind
        self.here: wire.GlobalPosition
        self.height = self.side = 0.0
        self.most_speed = self.table.limits.speed or math.inf if self.table.limits else math.inf
        self.station = 255
        self.arming = False
        """it was told to arm, and has not ended on the ground since"""
        self._tell, self.hurry, self.radio = tell, hurry, radio
        self.links: list[wire.LinkQuality] = []
        client.session.declare_subscriber(keys.EVENT.key(self.fleet, name), self._on_event)
        client.session.declare_subscriber(keys.LINK.key(self.fleet, name, link="*"), self._on_link)

    def _on_event(self, sample: zenoh.Sample) -> None:
        with contextlib.suppress(ZmavError):
            self.events.append(wire.decode(sample.payload.to_bytes(), wire.Event, "event"))

    def _on_link(self, sample: zenoh.Sample) -> None:
        with contextlib.suppress(ZmavError):
            self.links.append(wire.decode(sample.payload.to_bytes(), wire.LinkQuality, "link"))

    def say(self, name: str, found: str, status: Status = "ok") -> None:
        """A line of the report."""
        check = Check(name, status, found)
        self.report.checks.append(check)
        self._tell(check)

    @property
    def state(self) -> wire.VehicleState:
        return self.vehicle.state

    async def until(self, true: Callable[[wire.VehicleState], bool], seconds: float, what: str) -> wire.VehicleState:
        """Wait for a state; raises :class:`Failed` naming what was waited for, and what the vehicle said."""
        try:
            return await self.vehicle.wait_until(true, seconds)
        except TimedOut as e:
            raise Failed(f"not {what} within {seconds:.0f} s; {self.last_words()}") from e

    async def event(self, true: Callable[[wire.Event], bool], since: int, seconds: float, what: str) -> wire.Event:
        """The first such event after the first ``since`` ones."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            for event in self.events[since:]:
                if true(event):
                    return event
            await asyncio.sleep(0.05)
        raise Failed(f"{what} was not said within {seconds:.1f} s; {self.last_words()}")

    def last_words(self) -> str:
        """What the vehicle lacks, or said last."""
        state = self.vehicle.last_state
        missing = "; ".join(state.not_ready) if state and not state.armed else ""
        return missing or "it said: " + ("; ".join(event.text for event in self.events[-4:]) or "nothing")

    @contextlib.contextmanager
    def hurried(self) -> Iterator[None]:
        """What is the vehicle's own business takes less time, where the simulator is ours."""
        if self.hurry is not None:
            self.hurry(HURRY)
        try:
            yield
        finally:
            if self.hurry is not None:
                self.hurry(PACE)

    def counts(self) -> dict[str, int]:
        """The vehicle's setpoints so far, by what became of them."""
        return dict(self.state.setpoints)

    def speed(self, state: wire.VehicleState) -> float:
        """m/s over the ground and up."""
        return math.hypot(*state.velocity) if state.velocity else 0.0

    def place(self) -> wire.GlobalPosition:
        """Where it is; raises :class:`Failed`."""
        position = self.state.position
        if position is None:
            raise Failed("it says no position")
        return position

    def from_here(self, north: float, east: float) -> dict[str, Any]:
        """A setpoint's fields for a point so many metres from where it stood, at the flight's height."""
        here = wire.Origin(lat_deg=self.here.lat_deg, lon_deg=self.here.lon_deg, alt_amsl=0.0)
        lat, lon, _ = geo.to_global(here, (north, east, 0.0))
        return {"lat_deg": lat, "lon_deg": lon, "alt_rel": self.height}

    def away(self, point: dict[str, float]) -> float:
        """Metres from such a point; over the ground alone for what cannot choose its height, or only circles."""
        return _distance(self.place(), point, flat=not (self.kind.height and self.kind.rests))

    def from_start(self) -> float:
        """Metres over the ground from where it stood."""
        return _distance(self.place(), self.from_here(0.0, 0.0), flat=True)

    def check_room(self) -> None:
        """Choose height and side so that the flight stays within the fence; raises :class:`Failed`."""
        fence = self._fence()
        self.height, self.side = self.kind.height, self.kind.side
        if fence is None:
            return
        if self.height:
            self.height = max(self.height, (fence.floor or 0.0) + 2.0 if fence.floor is not None else 0.0)
            self.height = min(self.height, fence.ceiling - 2.0) if fence.ceiling is not None else self.height
        while (where := self._square_beyond(fence)) and self.side > self.kind.least:
            self.side = max(0.7 * self.side, self.kind.least)
        if where:
            text = f"the geofence leaves no room for a square of {self.kind.least:.0f} m north-east of where it stands"
            raise Failed(f"{text}: {where}")

    def _square_beyond(self, fence: Fence) -> str:
        height = self.height or None
        for north, east in ((0.0, 0.0), (self.side, 0.0), (self.side, self.side), (0.0, self.side)):
            point = self.from_here(north, east)
            _, where = fence.excess(*fence.local(point["lat_deg"], point["lon_deg"]), height)
            if where:
                return where
        return ""

    def beyond(self) -> tuple[str, dict[str, float]] | None:
        """A point outside the fence, and where that is in words; None: the fence does not limit this kind."""
        fence, far = self._fence(), 20.0
        if fence is None:
            return None
        while fence.limits_ground and far < 1e5:
            point = self.from_here(far, 0.0)
            excess, where = fence.excess(*fence.local(point["lat_deg"], point["lon_deg"]), None)
            if excess > 5.0:
                return where, point
            far *= 1.3
        if self.kind.height and fence.ceiling is not None:
            return f"5 m over the ceiling of {fence.ceiling:g} m", {
                **self.from_here(0.0, 0.0),
                "alt_rel": fence.ceiling + 5.0,
            }
        return None

    def _fence(self) -> Fence | None:
        return Fence(self.table.geofence, self.file.origin, ground=False) if self.table.geofence else None

    async def pilots_mode(self) -> None:
        """A pilot's mode, past all of zmav's own orders."""
        autopilot = autopilot_named(self.kind.autopilot, self.kind.kind)
        command = autopilot.mode(self.kind.pilots_mode).command
        message = command.message(self.client.dialect)
        self.put(message.name, message.fields)

    def put(self, name: str, fields: dict[str, Any]) -> None:
        """A message of the ground station's, as it comes from one."""
        target = (self.vehicle.last_state.sysid if self.vehicle.last_state else None) or 1
        packer = Packer(load_dialect(self.table.dialect), self.station, STATION)
        frame = packer.pack(name, target_system=target, target_component=1, **fields)
        self.client.put(keys.TX, keys.TX.key(self.fleet, self.vehicle.name, sys=target, comp=1, msg=name), frame)


def _distance(a: wire.GlobalPosition, point: dict[str, Any], flat: bool) -> float:
    """Metres from a place to a point; over the ground alone where ``flat``."""
    ground = geo.horizontal_distance(a.lat_deg, a.lon_deg, point["lat_deg"], point["lon_deg"])
    return ground if flat else math.hypot(ground, a.alt_rel - point["alt_rel"])
