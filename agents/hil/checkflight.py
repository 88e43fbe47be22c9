"""The check flight: the same for every stage, on whatever is at the vehicle's link."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Coroutine
from typing import Any

from agents.hil.flight import PACE, Flight, LeftOut, kind_of
from agents.hil.report import Identity
from agents.hil.steps import STEPS
from zmav.autopilots import Command
from zmav.doctor.ways import LINK_LOSS
from zmav.errors import LinkDown, Refused, TimedOut, ZmavError
from zmav.vehicle.params import values
from zmav.waiting import until_any

FOUND_S = 60.0
SILENT_S = 3.0
"""s without the autopilot after which the flight is over: it was unplugged"""
FORCE = 21196.0
"""MAV_CMD_COMPONENT_ARM_DISARM: disarm in the air, too"""


class CheckFlight(Flight):
    """All checks of one vehicle's kind."""

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
        self.report.identity = Identity(str(state.autopilot), str(state.kind), state.firmware, state.uid, state.sysid)
        what = f"{state.kind} by {state.autopilot} {state.firmware}, system id {state.sysid}, uid {state.uid}"
        self.say("autopilot", f"{what}, after {time.monotonic() - began:.1f} s")
        began = time.monotonic()
        table = await self.vehicle.params.list()
        self.report.params = values(table)
        for name in ("MAV_GCS_SYSID", "SYSID_MYGCS"):
            self.station = int(self.report.params.get(name) or self.station)
        self.say("parameters", f"{table.count} read in {time.monotonic() - began:.1f} s")

    async def fly(self, *guards: Coroutine[Any, Any, None]) -> None:
        """All checks of its kind, while none of the ``guards`` raises; ends with the vehicle disarmed, however it ends.

        The report says how it went. :meth:`meet` comes before.
        """
        if self.hurry is not None:
            self.hurry(PACE)
        try:
            await until_any(self._fly(), self._heard(), self.children.watch(), *guards)
        except ZmavError as e:
            self.say("flight", f"ended: {e.message}", "BAD")
        finally:
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
        if len(self.links) < 2:
            return
        first, last = self.links[0], self.links[-1]
        frames, lost = last.rx_frames - first.rx_frames, last.lost - first.lost
        rtts = sorted(each.rtt for each in self.links if each.rtt is not None)
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
        disarm = Command("MAV_CMD_COMPONENT_ARM_DISARM", (0.0, FORCE)).message(self.client.dialect)
        for _ in range(10):
            self.put(disarm.name, disarm.fields)
            await asyncio.sleep(0.5)
            state = self.vehicle.last_state
            age = self.vehicle.age
            if state is not None and state.connected and not state.armed and age is not None and age < 1.0:
                self.arming = False
                if self.report.stage == "bench":
                    self.say("disarmed", "in its simulated flight, by force" if self.kind.height else "by force")
                return
        lost = "it was armed when it was last heard, and cannot be reached (was it unplugged?)"
        text = f"{lost}: take its power off before you touch it"
        self.say("disarmed", text, "BAD")
