"""The check flight: the same for every stage, on whatever is at the vehicle's link."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Awaitable, Callable, Iterator
from typing import Any

import zenoh

import zmav
from agents.hil.kinds import Kind, kind_of
from agents.hil.report import Check, Identity, Report, Status
from agents.hil.steps import STEPS, Failed, LeftOut, distance, station_frame
from zmav import geo, keys, wire
from zmav.autopilots import autopilot_named
from zmav.children import Children
from zmav.config import FleetConfig
from zmav.doctor.rules import LINK_LOSS
from zmav.errors import LinkDown, Refused, TimedOut, ZmavError
from zmav.services.authority.limits import Fence
from zmav.vehicle.params import values

FOUND_S, PARAMS_S = 60.0, 120.0
SILENT_S = 3.0
"""s without the autopilot after which the flight is over: it was unplugged"""
PACE, HURRY = 1.0, 5.0
"""times real time, where the simulator is ours: the checks, and ways up and home"""
FORCE = 21196.0
"""MAV_CMD_COMPONENT_ARM_DISARM: disarm in the air, too"""


class CheckFlight:
    """One flight of one vehicle. ``tell`` takes each check as it is made; ``hurry`` sets the simulator's speed, and
    ``radio`` a channel of its pilot's (from 1) to µs, where the simulator can.
    """

    def __init__(
        self, client: zmav.Client, file: FleetConfig, name: str, router: str, children: Children, report: Report,
        tell: Callable[[Check], None], hurry: Callable[[float], object] | None = None,
        radio: Callable[[int, int], object] | None = None,
    ) -> None:  # fmt: skip
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
        self.left_armed = False
        """it could not be disarmed at the end"""
        self._tell, self._hurry, self.radio = tell, hurry, radio
        self._links: list[wire.LinkQuality] = []
        client.session.declare_subscriber(keys.EVENT.key(self.fleet, name), self._on_event)
        client.session.declare_subscriber(keys.LINK.key(self.fleet, name, link="*"), self._on_link)

    def _on_event(self, sample: zenoh.Sample) -> None:
        with contextlib.suppress(ZmavError):
            self.events.append(wire.decode(sample.payload.to_bytes(), wire.Event, "event"))

    def _on_link(self, sample: zenoh.Sample) -> None:
        with contextlib.suppress(ZmavError):
            self._links.append(wire.decode(sample.payload.to_bytes(), wire.LinkQuality, "link"))

    # ---- the flight

    async def meet(self) -> None:
        """Who it is, and its parameters; what cannot be flown raises :class:`ZmavError`, and nothing was armed."""
        began = time.monotonic()
        wanted = f"an autopilot with system id {self.table.sysid}" if self.table.sysid else "an autopilot"
        try:
            state = await self.vehicle.wait_until(lambda s: s.connected and s.uid is not None, FOUND_S)
        except TimedOut as e:
            text = f"not heard: {wanted} that gives its uid, within {FOUND_S:.0f} s; {self.last_words()}"
            raise Refused(text) from e
        if state.armed:
            raise Refused("it is armed: disarm it, and begin again; nothing was sent to it")
        self.kind = kind_of(state.autopilot, state.kind)
        self.report.identity = Identity(
            str(state.autopilot), str(state.kind), state.firmware, state.uid, state.sysid
        )  # fmt: skip
        what = f"{state.kind} by {state.autopilot} {state.firmware}, system id {state.sysid}, uid {state.uid}"
        self.say("autopilot", f"{what}, after {time.monotonic() - began:.1f} s")
        began = time.monotonic()
        table = await self.vehicle.params.list()
        self.report.params = values(table)
        for name in ("MAV_GCS_SYSID", "SYSID_MYGCS"):
            self.station = int(self.report.params.get(name) or self.station)
        self.say("parameters", f"{table.count} read in {time.monotonic() - began:.1f} s")

    async def fly(self, *guards: Awaitable[None]) -> None:
        """All checks of its kind, while none of the ``guards`` raises; ends with the vehicle disarmed, however it ends.

        The report says how it went. :meth:`meet` comes before.
        """
        if self._hurry is not None:
            self._hurry(PACE)
        flight = asyncio.ensure_future(self._fly())
        tasks = [flight, *map(asyncio.ensure_future, (self._heard(), self.children.watch(), *guards))]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        except ZmavError as e:
            self.say("flight", f"ended: {e.message}", "BAD")
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            await asyncio.shield(self._make_safe())

    async def _fly(self) -> None:
        for name in self.kind.steps:
            try:
                self.say(name, await STEPS[name](self))
            except LeftOut as e:
                self.say(name, str(e), "left out")
            except ZmavError as e:
                self.say(name, f"{e.message}; {self.last_words()}", "BAD")
                return
        self._judge_link()

    def _judge_link(self) -> None:
        """Frames lost between autopilot and companion, all along."""
        if len(self._links) < 2:
            return
        first, last = self._links[0], self._links[-1]
        frames, lost = last.rx_frames - first.rx_frames, last.lost - first.lost
        rtts = sorted(each.rtt for each in self._links if each.rtt is not None)
        rtt = f", round trip {1e3 * rtts[len(rtts) // 2]:.1f} ms, {1e3 * rtts[-1]:.1f} ms at most" if rtts else ""
        found = f"{lost} of {frames + lost} frames lost{rtt}"
        self.say("link", found, "ok" if lost == 0 or lost < LINK_LOSS * (frames + lost) else "BAD")

    async def _heard(self) -> None:
        """Until the autopilot has been silent for too long: raises."""
        since = time.monotonic()
        while time.monotonic() - since < SILENT_S:
            state, age = self.vehicle.last_state, self.vehicle.age
            if state is not None and state.connected and age is not None and age < SILENT_S:
                since = time.monotonic()
            await asyncio.sleep(0.2)
        raise LinkDown(f"the autopilot has not been heard for {SILENT_S:.0f} s: was it unplugged?")

    async def _make_safe(self) -> None:
        """Nothing is left armed: what flies a simulation may be disarmed in the air. Said past all orders and leases,
        as a ground station does.
        """
        state = self.vehicle.last_state
        if state is None or not (state.armed or self.arming):
            return
        number = self.client.dialect.value("MAV_CMD", "MAV_CMD_COMPONENT_ARM_DISARM")
        fields: dict[str, Any] = {"command": number, "confirmation": 0}
        fields |= {f"param{i}": FORCE if i == 2 else 0.0 for i in range(1, 8)}
        for _ in range(10):
            self.put("COMMAND_LONG", fields)
            await asyncio.sleep(0.5)
            state = self.vehicle.last_state
            age = self.vehicle.age
            if state is not None and state.connected and not state.armed and age is not None and age < 1.0:
                self.arming = False
                if self.report.stage == "bench":
                    self.say("disarmed", "in its simulated flight, by force" if self.kind.height else "by force")
                return
        self.left_armed = True
        lost = "it was armed when it was last heard, and cannot be reached (was it unplugged?)"
        text = f"{lost}: take its power off before you touch it"
        self.say("disarmed", text, "BAD")

    # ---- what the checks use

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

    async def event(
        self, true: Callable[[wire.Event], bool], since: int, seconds: float, what: str
    ) -> wire.Event:  # fmt: skip
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
        if self._hurry is not None:
            self._hurry(HURRY)
        try:
            yield
        finally:
            if self._hurry is not None:
                self._hurry(PACE)

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
        return distance(self.place(), point, flat=not (self.kind.height and self.kind.rests))

    def from_start(self) -> float:
        """Metres over the ground from where it stood."""
        return distance(self.place(), self.from_here(0.0, 0.0), flat=True)

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
                **self.from_here(0.0, 0.0), "alt_rel": fence.ceiling + 5.0,
            }  # fmt: skip
        return None

    def _fence(self) -> Fence | None:
        return Fence(self.table.geofence, self.file.origin, ground=False) if self.table.geofence else None

    async def pilots_mode(self) -> None:
        """A pilot's mode, past all of zmav's own orders."""
        autopilot = autopilot_named(self.kind.autopilot, self.kind.kind)
        command = autopilot.mode(self.kind.pilots_mode).command
        fields: dict[str, Any] = {f"param{i + 1}": value for i, value in enumerate(command.padded())}
        number = self.client.dialect.value("MAV_CMD", command.name)
        self.put("COMMAND_LONG", {"command": number, "confirmation": 0, **fields})

    def put(self, name: str, fields: dict[str, Any]) -> None:
        """A message of the ground station's, as it comes from one."""
        target = (self.vehicle.last_state.sysid if self.vehicle.last_state else None) or 1
        frame = station_frame(self.table.dialect, self.station, name, fields, target)
        self.client.put(keys.TX, keys.TX.key(self.fleet, self.vehicle.name, sys=target, comp=1, msg=name), frame)
