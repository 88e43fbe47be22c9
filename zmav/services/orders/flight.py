"""The orders that arm, move and land a vehicle: each a few commands, and then watched until it has come true."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable, Coroutine
from typing import Any

from zmav import geo, wire
from zmav.autopilots import Command, Message, Target
from zmav.autopilots.base import reposition
from zmav.autopilots.safety import by_command
from zmav.errors import BadInput, Refused, TimedOut, ZmavError
from zmav.services.authority.bounds import Bounds
from zmav.services.authority.leader import PositionLeader
from zmav.services.authority.targets import resolve
from zmav.services.companion import Companion
from zmav.services.link.timesync import TimeSync
from zmav.services.orders.command import Commander
from zmav.services.orders.orders import Report
from zmav.services.status.px4_events import with_reasons
from zmav.services.status.state import StateService
from zmav.waiting import within
from zmav.wire.orders import DISARMED

RETRY_EVERY = 1.0
"""s between attempts to arm a vehicle that says no"""
STOPS, STOP_EVERY = 3, 0.1
"""a stop has no acknowledgement, and may be lost"""
BEAT = 1.5
"""s in which a HEARTBEAT comes"""
ARMED = 128
"""MAV_MODE_FLAG_SAFETY_ARMED"""
ON_GROUND = 1
"""MAV_LANDED_STATE"""
LAND_TIMEOUT = 180.0
RISEN, CLIMBS = 0.3, 10.0
"""m that a takeoff rises within so many s, or it has ended too low"""
RETURN_TIMEOUT = 900.0
REBOOT_LOOK = 0.2
RALLY_TIMEOUT = 20.0
"""s for the rally points to be read, where they are not known"""
RESTS, LONGER = 0.3, 3.0
"""m/s below which it stands; what is straight across a circle is two of its radii"""
HOME_POSITION = 242.0
"""its MAVLink id"""
STANDS = 5.0
"""m from home at which a rover has arrived: ArduRover stops within 2 m of a place, where it does not overshoot"""
CIRCLE, WIDER = 80.0, 1.3
"""m, both autopilots' default radius of a circle; how much wider a real one is: ArduPlane was seen at 1.2 times"""


class Flight:
    """Handlers of the orders in :mod:`zmav.verbs` that move a vehicle. Lives on the event loop.

    ``param``: the autopilot's parameter of that name, where it is known; ``rally``: the rally points that are on it.
    """

    reboot_timeout = 60.0

    def __init__(
        self,
        companion: Companion,
        state: StateService,
        commander: Commander,
        bounds: Bounds,
        leader: PositionLeader,
        timesync: TimeSync,
        *,
        param: Callable[[str], float | None],
        rally: Callable[[], Coroutine[Any, Any, list[Target]]],
    ) -> None:
        self._port, self._identity = companion.port, companion.identity
        self._state, self._do, self._bounds = state, commander, bounds
        self._leader, self._timesync, self.param, self._known_rally = leader, timesync, param, rally

    # Whether an order can be done: raises before anything is changed for it, a landing under way included.

    async def judge_takeoff(self, args: wire.Takeoff, report: Report) -> None:
        if not 0.5 <= args.alt_rel <= 1000.0:
            raise BadInput("alt_rel must be from 0.5 to 1000 m", field="alt_rel", value=args.alt_rel)
        self._bounds.check_height(args.alt_rel, force=args.force)
        self._do.autopilot().takeoff(args.alt_rel, self._state.latest)
        if not self._identity.armed:
            raise Refused("it is disarmed: arm it first", vehicle=self._port.name)
        height = self._height_in_the_air()
        if height is not None:
            text = f"it is in the air already, {height:.1f} m above home: goto leads it to another height"
            raise Refused(text, vehicle=self._port.name)

    async def judge_place(self, args: wire.GoTo, report: Report) -> None:
        self._place(args)
        self._check_flying()

    async def judge_arming(self) -> None:
        """By a bare command, which enters no mode first, as :meth:`arm` does."""
        await self._do.until_mode_told()  # one entered since might set off
        if not self._identity.armed and (mode := self._arming_mode()) is not None:
            text = f"in {self._identity.mode} it refuses to be armed, or sets off by itself: 'arm' enters {mode} first"
            raise Refused(text, vehicle=self._port.name, field="command")

    # The orders.

    async def arm(self, args: wire.Arm, report: Report) -> dict[str, Any]:
        """Wait until the autopilot is ready, arm, and see it armed; a refusal is retried until ``ready_timeout``."""
        autopilot, deadline = self._do.autopilot(), time.monotonic() + args.ready_timeout
        if self._identity.armed:
            return {"armed": True}
        async with self._do.move():  # so that anyone who orders otherwise meanwhile is not surprised by it later
            if args.ready_timeout > 0:
                await self._until_ready(deadline, report)
            while True:
                await self._do.until_mode_told()  # one entered since the last HEARTBEAT might take off
                await self._enter_arming_mode()
                try:
                    await self._do.command(autopilot.arm(True))
                    break
                except Refused as e:
                    e = with_reasons(e, self._state.checks())
                    report({"refused": e.message})
                    if time.monotonic() + RETRY_EVERY > deadline:
                        raise e from None
                    await asyncio.sleep(RETRY_EVERY)
            await self._do.until_heartbeat(
                lambda: self._identity.armed is True, "armed, but HEARTBEAT does not show it"
            )
        return {"armed": True}

    async def disarm(self, args: wire.Order, report: Report) -> dict[str, Any]:
        if not self._identity.armed:
            self._do.supersede()  # somebody waits to arm it
        await self._do.command(self._do.autopilot().arm(False))
        await self._do.until_heartbeat(
            lambda: self._identity.armed is False, "disarmed, but HEARTBEAT does not show it"
        )
        return {"armed": False}

    async def set_mode(self, args: wire.SetMode, report: Report) -> dict[str, Any]:
        async with self._do.move():
            await self._do.enter(args.mode)
        return {"mode": self._identity.mode}

    async def takeoff(self, args: wire.Takeoff, report: Report) -> dict[str, Any]:
        """Climb to ``alt_rel`` metres above home; done when the vehicle is there."""
        await self.judge_takeoff(args, report)
        async with self._do.move():
            mode, command = self._do.autopilot().takeoff(args.alt_rel, self._state.latest)
            if mode:
                await self._do.enter(mode)
            if command:
                await self._do.command(command)
            altitude = await self._climb(args.alt_rel, mode, report)
        return {"alt_rel": altitude}

    async def goto(self, args: wire.GoTo, report: Report) -> dict[str, Any]:
        """Fly to a point; done when within ``tolerance`` of it, or at once where ``arrive`` is false.

        A plane has arrived when it circles: about ``radius`` from there over the ground (where none is given, its own;
        ``tolerance``, where that is more).
        """
        target = self._place(args)
        async with self._do.move():
            autopilot = self._do.autopilot()
            self._check_flying()
            target = autopilot.placed(target, self._state.latest)
            given = args.speed is not None or args.radius is not None
            action = reposition(target, speed=args.speed, radius=args.radius) if given else autopilot.goto(target)
            if autopilot.engage_after == 0.0 and not given:  # else by a command that changes the mode
                await self._do.enter(autopilot.guided)
            if isinstance(action, Command):
                await self._reposition(action)
            elif not self._leader.lead(target):
                await self._do.give(action)
            if not args.arrive:
                return {}
            return {"away": await self._arrive(action, target, args, report)}

    async def hold(self, args: wire.Order, report: Report) -> dict[str, Any]:
        """Stop where the vehicle is."""
        async with self._do.move():
            autopilot = self._do.autopilot()
            mode, message = autopilot.hold()
            there = self._identity.mode == mode
            await self._do.enter(mode)
            if there and autopilot.pause:
                await self._do.give(autopilot.pause)
            if message:
                for _ in range(STOPS):
                    await self._do.give(message)
                    await asyncio.sleep(STOP_EVERY)
        return {"mode": self._identity.mode}

    async def land(self, args: wire.Order, report: Report) -> dict[str, Any]:
        """Land where the vehicle is; done when it has disarmed itself, at once where it is disarmed."""
        async with self._do.move():
            mode = self._do.autopilot().land()
            if await self._is_disarmed():
                return {"armed": False}
            await self._do.enter(mode)
            await self._until_disarmed(mode, LAND_TIMEOUT, report)
        return {"armed": False}

    async def rtl(self, args: wire.Order, report: Report) -> dict[str, Any]:
        """Return to launch; done when it has landed and disarmed. A rover or a plane, which does not land there by
        itself, has done it when it is there; where its autopilot does not say where home is, once it is in the mode.
        """
        async with self._do.move():
            autopilot = self._do.autopilot()
            mode = autopilot.rtl()
            if await self._is_disarmed():
                text = "it is disarmed: there is nothing to bring back"
                raise Refused(text, vehicle=self._port.name, reason=DISARMED)
            await self._do.enter(mode)
            hovers = any((self.param(name) or 0.0) > 0.0 for name in autopilot.home_height_params)
            if autopilot.lands_after_rtl and not hovers:
                await self._until_disarmed(mode, RETURN_TIMEOUT, report)
                home = {}
            else:
                home = await self._until_home(mode, report)
        return {"mode": self._identity.mode, "armed": bool(self._identity.armed), **home}

    async def reboot(self, args: wire.Order, report: Report) -> dict[str, Any]:
        """Restart a disarmed autopilot; done when its time is seen to have begun again."""
        if self._identity.armed:
            raise Refused("it is armed: it would fall; land and disarm it first", vehicle=self._port.name)
        async with self._do.move():
            before, since = self._timesync.restarts, time.monotonic()
            await self._do.command(Command("MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN", (1.0,)))
            while self._timesync.restarts == before:
                if time.monotonic() - since > self.reboot_timeout:
                    late = f"it acknowledged the reboot {self.reboot_timeout:.0f} s ago, and has not come back"
                    raise TimedOut(late, vehicle=self._port.name)
                report({"connected": self._identity.connected})
                await asyncio.sleep(REBOOT_LOOK)
        return {"took": time.monotonic() - since}

    # How it is done.

    def _place(self, args: wire.GoTo) -> Target:
        if args.pos is None and args.lat_deg is None:
            raise BadInput("a goto needs a position", field="pos", value=None, expected="pos, or lat_deg and lon_deg")
        if args.speed is not None:
            if not 0.0 < args.speed < 200.0:
                raise BadInput("speed must be from 0 to 200 m/s", field="speed", value=args.speed, expected="0 to 200")
            self._bounds.check_speed("speed", args.speed, force=args.force)
        target = resolve(args, self._state.origin)
        self._bounds.check(target, force=args.force)
        return target

    async def _is_disarmed(self) -> bool:
        """By a HEARTBEAT of now: the last one may be of before it was armed."""
        if self._identity.armed or not self._identity.connected:
            return False
        with self._do.inbox("HEARTBEAT") as inbox:
            heard = await inbox.get(BEAT)
        return heard is not None and not heard[1]["base_mode"] & ARMED

    def _height_in_the_air(self) -> float | None:
        """Metres above home; None: it is on the ground, or nothing says otherwise."""
        position, extended = self._state.latest("GLOBAL_POSITION_INT"), self._state.latest("EXTENDED_SYS_STATE")
        height = position["relative_alt"] / 1e3 if position else 0.0
        if extended is not None and extended["landed_state"]:
            return None if extended["landed_state"] == ON_GROUND else height
        return height if height > 1.0 else None

    async def _reposition(self, action: Command) -> None:
        """Give it, and see the mode that it changes to by itself: from then on another one is the pilot's."""
        await self._do.give(action)
        modes = by_command(self._do.autopilot(), "goto")
        if modes:
            late = f"{action.name} was acknowledged, but none of its modes comes ({', '.join(modes)})"
            await self._do.until_heartbeat(lambda: self._identity.mode in modes, late)
        self._do.ordered = self._identity.mode

    def _check_flying(self) -> None:
        if not self._identity.armed:
            raise Refused("it is disarmed: arm it and take off first", vehicle=self._port.name)

    def _arming_mode(self) -> str | None:
        """What to enter before arming, by the mode that is shown or intended; None: as it is."""
        autopilot = self._do.autopilot()
        return autopilot.arming_mode(self._identity.mode) or autopilot.arming_mode(self._identity.intended)

    async def _enter_arming_mode(self) -> None:
        """Leave a mode in which it cannot be armed or would set off by itself."""
        if (mode := self._arming_mode()) is not None:
            await self._do.enter(mode)

    async def _until_ready(self, deadline: float, report: Report) -> None:
        while True:
            await self._enter_arming_mode()  # first: in such a mode it may not even become ready
            missing = self._state.missing()
            if not missing:
                return
            report({"waiting_for": missing})
            if time.monotonic() > deadline:
                raise Refused(f"not ready to arm: {', '.join(missing)}", vehicle=self._port.name, reasons=missing)
            await asyncio.sleep(0.2)

    async def _until_disarmed(self, mode: str, timeout: float, report: Report) -> None:
        with self._do.inbox("HEARTBEAT", "GLOBAL_POSITION_INT") as inbox:
            deadline = time.monotonic() + timeout
            while self._identity.armed:
                late = f"still armed {timeout / 60:.0f} minutes after {mode}"
                name, fields = await self._do.next(inbox, deadline, late)
                if name == "GLOBAL_POSITION_INT":
                    report({"alt_rel": fields["relative_alt"] / 1000.0})
                elif self._identity.armed:
                    self._do.check_mode(mode)

    async def _until_home(self, mode: str, report: Report) -> dict[str, Any]:
        """How far from home, or from the rally point it went to instead, it stays, where that is known: a plane circles
        there, a rover stands, a copter that is to stay over it hovers.
        """
        near = max(STANDS, WIDER * max(self._circle(), self._circle(home=True)))
        rallying, inside = asyncio.ensure_future(self._rally()), -math.inf
        try:
            with self._do.inbox("HOME_POSITION", "GLOBAL_POSITION_INT", "HEARTBEAT") as inbox:
                home = self._state.last("HOME_POSITION") or await self._ask_home()
                if home is None:
                    return {}
                places = [Target(lat_deg=home["latitude"] / 1e7, lon_deg=home["longitude"] / 1e7)]
                deadline = time.monotonic() + RETURN_TIMEOUT
                late = f"not home {RETURN_TIMEOUT / 60:.0f} minutes after {mode}"
                while True:
                    name, fields = await self._do.next(inbox, deadline, late)
                    if not self._identity.armed:
                        return {}
                    if name == "HEARTBEAT":
                        self._do.check_mode(mode)
                    elif name == "GLOBAL_POSITION_INT":
                        rally = rallying.result() if rallying.done() else []
                        away = min(_distance(place, fields, flat=True) for place in places + rally)
                        report({"away": away})
                        inside = (inside if math.isfinite(inside) else time.monotonic()) if away <= near else -math.inf
                        if away <= near and rallying.done() and (not rally or _stays(fields, near, inside)):
                            return {"away": away}
        finally:
            rallying.cancel()

    async def _rally(self) -> list[Target]:
        """Where it may return to instead of home."""
        with contextlib.suppress(ZmavError, asyncio.TimeoutError):
            return await within(RALLY_TIMEOUT, self._known_rally())
        return []

    async def _ask_home(self) -> Any:
        """HOME_POSITION, said again; None where the autopilot does not say it."""
        with self._do.inbox("HOME_POSITION") as inbox, contextlib.suppress(ZmavError):
            await self._do.command(Command("MAV_CMD_REQUEST_MESSAGE", (HOME_POSITION,)))
            heard = await inbox.get(BEAT)
            return heard[1] if heard else None
        return None

    async def _climb(self, alt_rel: float, mode: str | None, report: Report) -> float:
        """Until it is as high, or nearly; from where the autopilot's own takeoff ends below that it is led up."""
        deadline = time.monotonic() + 20.0 + 2.0 * alt_rel
        autopilot, near, began = self._do.autopilot(), max(0.3, 0.03 * alt_rel), False
        over, short = autopilot.takeoff_ends or (None, 0.0)
        with self._do.inbox("GLOBAL_POSITION_INT") as inbox:
            altitude = highest = -math.inf
            while altitude < alt_rel - near:
                late = f"only at {altitude:.1f} m of {alt_rel:.1f} m"
                _, position = await self._do.next(inbox, deadline, late)
                altitude = position["relative_alt"] / 1000.0
                report({"alt_rel": altitude})
                if altitude > highest + RISEN:  # who still climbs is waited for, however slowly
                    highest, deadline = altitude, max(deadline, time.monotonic() + CLIMBS)
                if not self._identity.armed:
                    raise Refused("it disarmed during the takeoff", vehicle=self._port.name)
                if mode:  # where a command alone takes off, the autopilot changes the mode by itself
                    self._do.check_mode(mode)
                elif began and self._identity.mode == over and alt_rel - short <= altitude < alt_rel - near:
                    await self._do.command(autopilot.climb_on(alt_rel, self._state.latest))
                    over = None  # once: a later hold is the pilot's
                began = began or self._identity.mode != over
        return altitude

    async def _arrive(self, action: Command | Message, target: Target, args: wire.GoTo, report: Report) -> float:
        deadline, given = time.monotonic() + args.timeout, time.monotonic()
        mode, (near, flat) = self._identity.mode, self._near(args)
        with self._do.inbox("GLOBAL_POSITION_INT") as inbox:
            while True:
                _, position = await self._do.next(inbox, deadline, f"not there after {args.timeout:.0f} s")
                away = _distance(target, position, flat=flat)
                report({"away": away})
                if away <= near:
                    return away
                self._do.check_mode(mode)
                if isinstance(action, Message) and not self._leader.leading and time.monotonic() - given > 1.0:
                    given = time.monotonic()
                    if not self._leader.lead(target):  # another order ended it: a far target is not given as it is
                        await self._do.give(action)  # it has no acknowledgement: say it again in case it was lost

    def _near(self, args: wire.GoTo) -> tuple[float, bool]:
        """Within how many metres it is there, and whether over the ground alone: what circles comes no nearer."""
        radius = abs(args.radius or 0.0) or self._circle()
        return max(args.tolerance, WIDER * radius), radius > 0.0 or self._do.autopilot().on_surface

    def _circle(self, *, home: bool = False) -> float:
        """Radius (m) of the circles that it flies where none is given, or over home; 0: it can stay at a place, or has
        no other over home.
        """
        autopilot = self._do.autopilot()
        if home:
            return abs(self.param(autopilot.home_circle_param or "") or 0.0)
        return 0.0 if autopilot.circle_param is None else abs(self.param(autopilot.circle_param) or CIRCLE)


def _stays(position: Any, near: float, since: float) -> bool:
    """It stands, or is so near for longer than it takes to fly by: there are other places it may be on its way to."""
    speed = math.hypot(position["vx"], position["vy"], position["vz"]) / 100.0
    return speed < RESTS or time.monotonic() - since > LONGER * near / speed


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
