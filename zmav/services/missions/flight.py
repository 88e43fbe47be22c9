"""Flying a mission: it is begun, watched to its end, and another item is gone on with.

https://mavlink.io/en/services/mission.html#flight-plan-missions
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Mapping
from typing import Any

from zmav import wire
from zmav.autopilots import Command, Message
from zmav.autopilots.base import mode_of
from zmav.errors import BadInput, Refused, TimedOut, Unsupported
from zmav.services.authority.bounds import Bounds
from zmav.services.authority.clearance import FORCE
from zmav.services.companion import Companion
from zmav.services.missions.items import Raw, ends_at
from zmav.services.missions.missions import Missions
from zmav.services.orders.command import Commander
from zmav.services.orders.orders import Report

START_AGAIN = 1.0
"""s until the mission's mode is asked for again where it was refused"""
LAST_WORD = 1.5
"""s that a mission's end may be told after the autopilot has left its mode: MISSION_CURRENT comes once a second"""
ACTIVE, PAUSED, COMPLETE = 3, 4, 5
"""MISSION_STATE"""
RETURN, LAND, VTOL_LAND = 20, 21, 85
MOST_SWITCH = 0x7FFF
"""the largest number of an auxiliary function: ArduPilot's parameters for them have 16 bits"""
FLIES = ("MAV_CMD_MISSION_START", "MAV_CMD_DO_LAND_START")
"""commands that fly the mission, from its beginning or from where it lands"""


class MissionFlight:
    """Handlers of ``mission_start`` and ``mission_current``. Lives on the event loop."""

    set_timeout = 4.0
    """s for MISSION_CURRENT to show an item that only a message without acknowledgement could set"""

    def __init__(self, companion: Companion, commander: Commander, missions: Missions, bounds: Bounds) -> None:
        self._port, self._identity, self._do = companion.port, companion.identity, commander
        self._missions, self._bounds = missions, bounds

    async def start(self, args: wire.MissionStart, report: Report) -> dict[str, Any]:
        """Fly the mission from item ``first`` on, the vehicle being armed; ``wait_end``: done at its end.

        Raises :class:`Refused` when the pilot takes over or the vehicle disarms on the way.
        """
        rules = self._do.autopilot().missions
        async with self._do.move():  # first: what comes while the plan is read ends this
            plan, start = await self._judged(args, report)
            await self._set_current(args.first + start)
            if rules.mode:
                await self._enter(rules.mode)
            if rules.start_command:
                await self._do.command(Command("MAV_CMD_MISSION_START"))
            told = {"mode": self._identity.mode, "total": len(plan) - start}
            if args.wait_end:
                told |= await self._watch(plan, start, report)
        return told

    async def judge_start(self, args: wire.MissionStart, report: Report) -> None:
        """Raise where the mission cannot be begun, before anything is changed for it."""
        await self._judged(args, report)

    async def judge_mode(self, args: wire.SetMode, report: Report) -> None:
        """The mode that flies a mission leads where the mission does."""
        autopilot = self._do.autopilot()
        if autopilot.mode(args.mode).name == autopilot.missions.mode:
            await self._judge_flown(args.force, report)

    async def judge_command(self, command: Command, force: bool, report: Report) -> None:
        """The commands that fly a mission, or land by it, lead where the mission does; one that enters a mode, as
        :meth:`judge_mode` has it. Raises :class:`BadInput` for a mode that is not known (with ``force`` it passes where
        none is, and set_mode can enter none), a standard mode, and a pilot's switch that has an order.
        """
        if command.name in FLIES:
            await self._judge_flown(force, report)
        elif command.name == "MAV_CMD_DO_AUX_FUNCTION":
            function = command.params[0]
            if not (0.0 <= function <= MOST_SWITCH and function == int(function)):  # it would be cut to one
                raise BadInput.wrong("param1", function, f"a whole number from 0 to {MOST_SWITCH}")
            if function in self._do.autopilot().switches:
                raise BadInput.wrong("param1", function, "another function: arm, disarm and set_mode are orders")
        elif command.name == "MAV_CMD_DO_SET_STANDARD_MODE":
            text = "standard modes are not judged: set_mode enters one by its name"
            raise BadInput(text, field="command", value=command.name, expected="set_mode")
        elif command.name == "MAV_CMD_DO_SET_MODE":
            autopilot = self._do.autopilot()
            mode = autopilot.mode_by(command)
            if mode is not None:
                await self.judge_mode(wire.SetMode(mode=mode, force=force), report)
            elif autopilot.modes():
                text = f"no mode is known that {command.params[:3]} enters: set_mode enters one by its name"
                raise BadInput(text, field="params", value=list(command.params[:3]), expected="set_mode")
            elif not force:  # it may be the one that flies the mission
                text = f"no mode is known that {command.params[:3]} enters on this {autopilot.name} {autopilot.kind}"
                raise BadInput(f"{text}{FORCE}", field="params", value=list(command.params[:3]), expected="force")

    async def _judge_flown(self, force: bool, report: Report) -> None:
        if self._identity.armed:
            plan = await self._missions.plan("mission", report)
            self._bounds.check_mission(plan[self._missions.items().offset("mission") :], force=force)

    async def _judged(self, args: wire.MissionStart, report: Report) -> tuple[list[Raw], int]:
        if not self._identity.armed:
            raise Refused("it is disarmed: arm it first", vehicle=self._port.name)
        plan = await self._missions.plan("mission", report)
        start = self._check(args.first, "first", plan)
        self._bounds.check_mission(plan[start:], force=args.force)
        return plan, start

    async def set_current(self, args: wire.MissionJump, report: Report) -> dict[str, Any]:
        """Go on with another item; where no mission is being flown, the next start begins there."""
        plan = await self._missions.plan("mission", report)
        start = self._check(args.index, "index", plan)
        if self._identity.armed:
            self._bounds.check_mission(plan[args.index + start :], force=args.force)
        await self._set_current(args.index + start)
        return {"current": args.index, "total": len(plan) - start}

    # How it is done.

    def _check(self, index: int, field: str, plan: list[Raw]) -> int:
        """How many items stand before our first; raises where there is no such item."""
        start = self._missions.items().offset("mission")
        count = len(plan) - start
        if count <= 0:
            raise Refused("there is no mission on the autopilot: upload one first", vehicle=self._port.name)
        if not 0 <= index < count:
            text = f"no item {index}: the mission has {count}, from 0 to {count - 1}"
            raise BadInput(text, field=field, value=index, expected=f"0 to {count - 1}")
        return start

    async def _set_current(self, seq: int) -> None:
        """MAV_CMD_DO_SET_MISSION_CURRENT, or the message before it, which is judged by MISSION_CURRENT."""
        if self._do.autopilot().missions.set_by_command:
            with contextlib.suppress(Unsupported, TimedOut):
                await self._do.command(Command("MAV_CMD_DO_SET_MISSION_CURRENT", (float(seq),)))
                return
        with self._do.inbox("MISSION_CURRENT") as inbox:
            deadline = time.monotonic() + self.set_timeout
            while time.monotonic() < deadline:
                await self._do.give(Message("MISSION_SET_CURRENT", {"seq": seq}))
                again = time.monotonic() + 1.0
                while (heard := await inbox.get(again - time.monotonic())) is not None:
                    if heard[1]["seq"] == seq:
                        return
        raise TimedOut(f"the autopilot does not go to item {seq} (as it counts)", vehicle=self._port.name)

    async def _enter(self, mode: str) -> None:
        """PX4 looks at a mission that was just uploaded a moment later, and until then refuses to fly it."""
        try:
            await self._do.enter(mode)
        except Refused:
            await asyncio.sleep(START_AGAIN)
            await self._do.enter(mode)

    async def _watch(self, plan: list[Raw], start: int, report: Report) -> dict[str, Any]:
        """Until the last item is reached, the autopilot says that the mission is complete, or it has landed by it."""
        flight = _Flight(plan, start, ends_at(self._missions.items(), plan))
        mode, left = self._identity.mode, None  # since when its mode is another
        with self._do.inbox("MISSION_CURRENT", "MISSION_ITEM_REACHED", "HEARTBEAT") as inbox:
            while True:
                name, fields = await self._do.next(inbox, math.inf, "")
                if flight.hear(name, fields):
                    report(flight.told())
                if flight.over:
                    return flight.told()
                if not self._identity.armed:
                    if flight.landing:
                        return flight.told()
                    raise Refused(f"it disarmed at {flight.where()}", vehicle=self._port.name, **flight.told())
                self._do.follows = self._leads_to(flight)
                if self._identity.mode == mode or (flight.landing and self._identity.mode in self._do.follows):
                    left = None
                    continue
                left = left or time.monotonic()
                if self._identity.mode not in self._do.follows or time.monotonic() - left > LAST_WORD:
                    self._do.check_mode(mode)

    def _leads_to(self, flight: _Flight) -> frozenset[str]:
        """Modes that the autopilot may enter by itself where the mission is: for its landing, or at its end."""
        autopilot = self._do.autopilot()
        home = mode_of(autopilot.rtl) if flight.returning or flight.may_be_over else None
        down = mode_of(autopilot.land) if flight.landing and not flight.returning else None
        return frozenset(mode for mode in (home, down) if mode is not None)


class _Flight:
    """What is known of a flight; ``last``: the autopilot's index of the item that ends it, where one does."""

    def __init__(self, plan: list[Raw], start: int, last: int | None) -> None:
        self._plan, self._start, self._last = plan, start, last
        self._current: int | None = None
        self._reached: int | None = None
        self._active = False
        self._down: int | None = None
        """the item it lands by, until a later one is flown: on disarming, ArduPilot goes back to the first"""
        self.over = False

    def hear(self, name: str, fields: Mapping[str, Any]) -> bool:
        """Take in a message; True: it says something new."""
        before = self.told()
        if name == "MISSION_ITEM_REACHED":
            self._reached = fields["seq"]
            self.over = self.over or (self._last is not None and self._reached >= self._last)
        elif name == "MISSION_CURRENT":
            self._current = at = int(fields["seq"])
            if self._command(at) in (RETURN, LAND, VTOL_LAND):
                self._down = at
            elif self._down is not None and at > self._down:
                self._down = None
            self._active = self._active or fields["mission_state"] in (ACTIVE, PAUSED)
            # What it says before the mission was seen active is of the flight before.
            if self._active and fields["mission_state"] == COMPLETE:
                self.over = True
                self._reached = self._reached if self._last is None else self._last  # that word may come later
        return self.told() != before

    @property
    def may_be_over(self) -> bool:
        """It was at its last item: the word that this was reached may be on its way, or lost."""
        return self._last is not None and self._current is not None and self._current >= self._last

    @property
    def returning(self) -> bool:
        return self._command(self._down) == RETURN

    @property
    def landing(self) -> bool:
        return self._down is not None

    def told(self) -> dict[str, Any]:
        known = {"current": self._current, "reached": self._reached}
        ours = {name: seq - self._start for name, seq in known.items() if seq is not None and seq >= self._start}
        return {**ours, "total": len(self._plan) - self._start}

    def where(self) -> str:
        told = self.told()
        return f"item {told['current']} of {told['total']}" if "current" in told else "an unknown item"

    def _command(self, at: int | None) -> int | None:
        return self._plan[at].command if at is not None and at < len(self._plan) else None
