"""Commands beside the autopilot: sent over the local link, acknowledged, retried, and seen to come true."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import AsyncIterator, Callable, Mapping
from typing import Any

from zmav import geo, wire
from zmav.autopilots import Autopilot, Command, Message, Target
from zmav.errors import BadInput, Refused, Stale, TimedOut
from zmav.services.events import Events
from zmav.services.identity import Identity
from zmav.services.orders import Report
from zmav.services.port import Inbox, Port
from zmav.services.state import StateService
from zmav.services.target import resolve

ACK_TIMEOUT = 0.5
RETRIES = 3
IN_PROGRESS_TIMEOUT = 10.0
CONFIRM_TIMEOUT = 4.0
"""s for a HEARTBEAT to show what an acknowledgement promised"""
ACCEPTED, IN_PROGRESS = 0, 5


class Commander:
    """Turns orders into MAVLink commands and watches them through. Lives on the event loop."""

    def __init__(self, port: Port, identity: Identity, state: StateService, events: Events) -> None:
        self._port, self._identity, self._state, self._events = port, identity, state, events
        self._locks: dict[str, asyncio.Lock] = {}
        self._mover: asyncio.Task[Any] | None = None

    # What others use.

    @property
    def moving(self) -> bool:
        """An order is moving the vehicle, or is about to."""
        return self._mover is not None

    def supersede(self) -> None:
        """End the order that moves the vehicle, if one is under way."""
        if self._mover is not None and self._mover is not asyncio.current_task():
            self._mover.cancel()
        self._mover = None

    async def arm(self, args: wire.Arm, report: Report) -> dict[str, Any]:
        """Wait until the autopilot is ready, arm, and see it armed; a refusal is retried until ``ready_timeout``."""
        autopilot, deadline = self._autopilot(), time.monotonic() + args.ready_timeout
        if self._identity.armed:
            return {"armed": True}
        async with self._moving():  # so that whoever orders otherwise meanwhile is not surprised by it later
            if args.ready_timeout > 0:
                await self._until_ready(autopilot, deadline, report)
            while True:
                try:
                    await self.command(autopilot.arm(True))
                    break
                except Refused as e:
                    report({"refused": e.message})
                    if time.monotonic() + 1.0 > deadline:
                        raise
                    await asyncio.sleep(1.0)
            await self._until_heartbeat(lambda: self._identity.armed is True, "armed, but HEARTBEAT does not show it")
        return {"armed": True}

    async def disarm(self, args: wire.Order, report: Report) -> dict[str, Any]:
        if not self._identity.armed:
            self.supersede()  # somebody waits to arm it
        await self.command(self._autopilot().arm(False))
        await self._until_heartbeat(lambda: self._identity.armed is False, "disarmed, but HEARTBEAT does not show it")
        return {"armed": False}

    async def set_mode(self, args: wire.SetMode, report: Report) -> dict[str, Any]:
        async with self._moving():
            await self._enter(args.mode)
        return {"mode": self._identity.mode}

    async def takeoff(self, args: wire.Takeoff, report: Report) -> dict[str, Any]:
        """Climb to ``alt_rel`` metres above home; done when the vehicle is there."""
        if not 0.5 <= args.alt_rel <= 1000.0:
            raise BadInput("alt_rel must be from 0.5 to 1000 m", field="alt_rel", value=args.alt_rel)
        async with self._moving():
            mode, command = self._autopilot().takeoff(args.alt_rel, self._state.latest)
            if not self._identity.armed:
                raise Refused("it is disarmed: arm it first", vehicle=self._port.name)
            if mode:
                await self._enter(mode)
            if command:
                await self.command(command)
            altitude = await self._climb(args.alt_rel, mode, report)
        return {"alt_rel": altitude}

    async def goto(self, args: wire.GoTo, report: Report) -> dict[str, Any]:
        """Fly to a point; done when within ``tolerance`` of it, or at once where ``arrive`` is false."""
        if args.pos is None and args.lat_deg is None:
            raise BadInput("a goto needs a position", field="pos", value=None, expected="pos, or lat_deg and lon_deg")
        target = resolve(args, self._state.origin)
        async with self._moving():
            autopilot = self._autopilot()
            if not self._identity.armed:
                raise Refused("it is disarmed: arm it and take off first", vehicle=self._port.name)
            await self._enter(autopilot.guided)
            action = autopilot.goto(target)
            await self._give(action)
            if not args.arrive:
                return {}
            away = await self._arrive(action, target, args, report)
        return {"away": away}

    async def hold(self, args: wire.Order, report: Report) -> dict[str, Any]:
        """Stop where the vehicle is."""
        async with self._moving():
            mode, message = self._autopilot().hold()
            await self._enter(mode)
            if message:
                await self._give(message)
        return {"mode": self._identity.mode}

    async def land(self, args: wire.Order, report: Report) -> dict[str, Any]:
        """Land where the vehicle is; done when it has disarmed itself."""
        async with self._moving():
            mode = self._autopilot().land()
            await self._enter(mode)
            with self._inbox("HEARTBEAT", "GLOBAL_POSITION_INT") as inbox:
                deadline = time.monotonic() + 180.0
                while self._identity.armed:
                    name, fields = await self._next(inbox, deadline, "still armed three minutes after LAND")
                    if name == "GLOBAL_POSITION_INT":
                        report({"alt_rel": fields["relative_alt"] / 1000.0})
                    elif self._identity.armed:
                        self._check_mode(mode)
        return {"armed": False}

    async def command(self, command: Command) -> None:
        """Send a MAV_CMD until it is acknowledged; raises :class:`Refused` with the autopilot's words, or TimedOut."""
        lock = self._locks.setdefault(command.name, asyncio.Lock())
        async with lock:
            with self._inbox("COMMAND_ACK", "STATUSTEXT") as inbox:
                since = time.monotonic()
                result = await self._acknowledged(command, inbox)
                if result != ACCEPTED:
                    raise await self._refusal(command, result, since, inbox)

    # How it is done.

    def _autopilot(self) -> Autopilot:
        if self._identity.autopilot is None:
            raise Stale(f"no autopilot has been heard on {self._port.link.url}", vehicle=self._port.name)
        if not self._identity.connected:
            raise Stale("the autopilot is silent", vehicle=self._port.name)
        return self._identity.autopilot

    def _source(self) -> tuple[int, int]:
        self._autopilot()
        assert self._identity.source is not None
        return self._identity.source

    def _inbox(self, *names: str) -> Inbox:
        return Inbox(self._port, self._source(), *names)

    @contextlib.asynccontextmanager
    async def _moving(self) -> AsyncIterator[None]:
        """One order at a time moves the vehicle: a later one ends an earlier one."""
        self.supersede()
        self._mover = me = asyncio.current_task()
        try:
            yield
        finally:
            if self._mover is me:
                self._mover = None

    async def _acknowledged(self, command: Command, inbox: Inbox) -> int:
        number = self._port.dialect.value("MAV_CMD", command.name)
        for attempt in range(RETRIES + 1):
            self._send_command(command, number, attempt)
            deadline = time.monotonic() + ACK_TIMEOUT
            while (heard := await inbox.get(deadline - time.monotonic())) is not None:
                name, fields = heard
                if name != "COMMAND_ACK" or fields["command"] != number or not self._is_for_us(fields):
                    continue
                if fields["result"] != IN_PROGRESS:
                    return int(fields["result"])
                deadline = time.monotonic() + IN_PROGRESS_TIMEOUT
        why = f"no acknowledgement of {command.name} after {RETRIES + 1} attempts"
        raise TimedOut(why, vehicle=self._port.name, command=command.name)

    def _is_for_us(self, ack: Mapping[str, Any]) -> bool:
        """A ground station behind ``mav/tx`` may have given the same command; nought is everybody."""
        system, component = self._port.address
        return ack["target_system"] in (0, system) and ack["target_component"] in (0, component)

    def _send_command(self, command: Command, number: int, attempt: int) -> None:
        system, component = self._source()
        p = command.padded()
        common = {"target_system": system, "target_component": component, "command": number}
        first = {f"param{i + 1}": p[i] for i in range(4)}
        if command.frame is None:
            rest = {"param5": p[4], "param6": p[5], "param7": p[6], "confirmation": attempt}
            self._port.send("COMMAND_LONG", **common, **first, **rest)
        else:
            frame = self._port.dialect.value("MAV_FRAME", command.frame)
            self._port.send("COMMAND_INT", **common, **first, x=int(p[4]), y=int(p[5]), z=p[6], frame=frame)

    async def _refusal(self, command: Command, result: int, since: float, inbox: Inbox) -> Refused:
        """The error for a result, with the words that came shortly before or after it."""
        deadline = time.monotonic() + 0.2
        while await inbox.get(deadline - time.monotonic()) is not None:
            pass
        name = self._port.dialect.enum_name("MAV_RESULT", result) or str(result)
        reasons = self._events.texts_since(since)
        text = f"{command.name} refused: {name.removeprefix('MAV_RESULT_')}"
        text += f" ({'; '.join(reasons)})" if reasons else ""
        return Refused(text, vehicle=self._port.name, command=command.name, result=name, reasons=reasons)

    async def _give(self, action: Command | Message) -> None:
        if isinstance(action, Command):
            await self.command(action)
        else:
            system, component = self._source()
            self._port.send(action.name, target_system=system, target_component=component, **action.fields)

    async def _enter(self, name: str) -> None:
        """Change the mode, judged by HEARTBEAT: PX4 acknowledges DO_SET_MODE before its commander has decided."""
        mode = self._autopilot().mode(name)
        if self._identity.mode == mode.name:
            return
        await self.command(mode.command)
        await self._until_heartbeat(
            lambda: self._identity.mode == mode.name, f"mode {mode.name} was acknowledged, but does not come"
        )

    async def _until_heartbeat(self, true: Callable[[], bool], otherwise: str) -> None:
        with self._inbox("HEARTBEAT") as inbox:
            deadline = time.monotonic() + CONFIRM_TIMEOUT
            while not true():
                if await inbox.get(deadline - time.monotonic()) is None:
                    raise TimedOut(otherwise, vehicle=self._port.name)

    async def _until_ready(self, autopilot: Autopilot, deadline: float, report: Report) -> None:
        while missing := autopilot.missing(self._state.latest):
            report({"waiting_for": missing})
            if time.monotonic() > deadline:
                raise Refused(f"not ready to arm: {', '.join(missing)}", vehicle=self._port.name, reasons=missing)
            await asyncio.sleep(0.2)

    def _check_mode(self, mode: str | None) -> None:
        """The pilot wins: an order ends when the mode is no longer its own."""
        if self._identity.mode != mode:
            text = f"taken over: the mode is now {self._identity.mode}"
            raise Refused(text, vehicle=self._port.name, mode=self._identity.mode)

    async def _next(self, inbox: Inbox, deadline: float, late: str) -> tuple[str, Mapping[str, Any]]:
        """The next message; raises :class:`TimedOut` after the deadline, :class:`Stale` for a silent autopilot."""
        while (heard := await inbox.get(min(deadline - time.monotonic(), 1.0))) is None:
            self._autopilot()
            if time.monotonic() >= deadline:
                raise TimedOut(late, vehicle=self._port.name)
        return heard

    async def _climb(self, alt_rel: float, mode: str | None, report: Report) -> float:
        deadline = time.monotonic() + 20.0 + 2.0 * alt_rel
        with self._inbox("GLOBAL_POSITION_INT") as inbox:
            altitude = -math.inf
            while altitude < alt_rel - max(0.3, 0.03 * alt_rel):
                late = f"only at {altitude:.1f} m of {alt_rel:.1f} m"
                _, position = await self._next(inbox, deadline, late)
                altitude = position["relative_alt"] / 1000.0
                report({"alt_rel": altitude})
                if not self._identity.armed:
                    raise Refused("it disarmed during the takeoff", vehicle=self._port.name)
                if mode:  # where a command alone takes off, the autopilot changes the mode by itself
                    self._check_mode(mode)
        return altitude

    async def _arrive(self, action: Command | Message, target: Target, args: wire.GoTo, report: Report) -> float:
        deadline, given = time.monotonic() + args.timeout, time.monotonic()
        mode = self._identity.mode
        with self._inbox("GLOBAL_POSITION_INT") as inbox:
            while True:
                _, position = await self._next(inbox, deadline, f"not there after {args.timeout:.0f} s")
                away = _distance(target, position, flat=self._autopilot().on_surface)
                report({"away": away})
                if away <= args.tolerance:
                    return away
                self._check_mode(mode)
                if isinstance(action, Message) and time.monotonic() - given > 1.0:
                    given = time.monotonic()
                    await self._give(action)  # a target has no acknowledgement: say it again in case it was lost


def _distance(target: Target, position: Any, flat: bool) -> float:
    """Metres from a GLOBAL_POSITION_INT to the target; over the ground alone where ``flat``."""
    assert target.lat_deg is not None and target.lon_deg is not None
    over_ground = geo.horizontal_distance(target.lat_deg, target.lon_deg, position["lat"] / 1e7, position["lon"] / 1e7)
    if flat:
        return over_ground
    if target.alt_amsl is not None:
        up = target.alt_amsl - position["alt"] / 1e3
    else:
        up = (target.alt_rel or 0.0) - position["relative_alt"] / 1e3
    return math.hypot(over_ground, up)
