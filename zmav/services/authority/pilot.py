"""Who has the vehicle: any mode that was not ordered here, and the pilot's switch, take it from every agent.

Nobody gives it back but an agent that asks for a lease again, and not while the switch says pilot.
"""

from __future__ import annotations

import asyncio
import time
from typing import NamedTuple

from zmav.autopilots import Autopilot
from zmav.autopilots.base import Fields, mode_of
from zmav.autopilots.safety import by_command, ends_in
from zmav.config import PilotSwitch
from zmav.mavlink import Frame
from zmav.services.authority.control import Control, Mover
from zmav.services.companion import Companion
from zmav.services.link.heard import AutopilotMessages
from zmav.services.orders.command import Commander

NEEDS = {"RC_CHANNELS": 10.0}
"""what must flow for his switch, in Hz"""
GRACE = 3.0
"""s after an order in which its command may still change the mode or disarm"""
DISARMING = ("disarm", "MAV_CMD_COMPONENT_ARM_DISARM", "MAV_CMD_DO_FLIGHTTERMINATION", "MAV_CMD_DO_PARACHUTE")
UNHEARD = (0, 65535)
"""RC_CHANNELS of a channel that the autopilot does not hear"""
CRITICAL = 5
"""MAV_STATE from which on a mode that the autopilot enters by itself is a failsafe's"""


class TakenByPilot(NamedTuple):
    """Somebody else than us changed the mode, disarmed, or moved the switch. Told on the event loop."""

    text: str
    by_switch: bool


class Pilot:
    """Watches the mode, the arming and RC_CHANNELS. On the event loop; :meth:`allowed` from any thread."""

    def __init__(
        self,
        companion: Companion,
        commander: Commander,
        switch: PilotSwitch | None,
        control: Control,
    ) -> None:
        self._port, self._identity, self._commander, self.switch = companion.port, companion.identity, commander, switch
        self._control = control
        self._mode: str | None = None
        self._armed = False
        self._unsaid: str | None = None
        """the mode before one that was let pass while the autopilot did not say what it intends"""
        self._what, self._grace = "", 0.0
        self._passing: asyncio.TimerHandle | None = None
        """until an overtaken mode that was let pass must have been left"""
        self._rc = AutopilotMessages(companion, {"RC_CHANNELS": self._on_rc} if switch else {})

    def start(self) -> None:
        self._rc.start()

    def close(self) -> None:
        self._rc.close()
        if self._passing is not None:
            self._passing.cancel()

    def order_begins(self, what: str) -> None:
        """What the autopilot does until it ends, and in the next seconds, may be what its command asks for.

        ``what``: its verb, or the MAV_CMD it gives by name.
        """
        self._what, self._grace = what, time.monotonic() + GRACE

    def changed(self) -> None:
        """It shows another mode or arming, or is another autopilot."""
        mode, armed, intended = self._identity.mode, bool(self._identity.armed), self._identity.intended
        before, late = self._mode, armed and mode == self._mode and intended not in (None, mode)
        if late and self._unsaid is not None:
            before = self._unsaid  # a failsafe's, as it turns out
        if mode != self._mode or intended is not None:
            self._unsaid = None
        if self._armed and before is not None:  # else nobody flies it
            self._judge(mode, armed, before)
        self._commander.mode_came(mode)
        self._mode, self._armed = mode, armed  # only now: the watchdog's thread may not take the mode for one let pass

    def _judge(self, mode: str | None, armed: bool, before: str) -> None:
        if not armed:
            flown = mode if self._expected(mode, before) else before
            if not self._ends_on_ground(flown):
                self._tell("it was disarmed, which was not ordered here")
        elif mode != before and not self._expected(mode, before):
            self._tell(f"the mode is now {mode}, which was not ordered here")

    def allowed(self, mode: str | None) -> bool:
        """``mode`` is the one that was seen and let pass, or was ordered here since."""
        if mode is None:
            return False
        return mode in (self._mode, self._commander.ordered) or self._commander.overtaken(mode)

    def _expected(self, mode: str | None, before: str) -> bool:
        """The change was ordered here, or follows by itself from what was."""
        autopilot, heartbeat, intended = self._identity.autopilot, self._identity.heartbeat, self._identity.intended
        if mode is None or autopilot is None or heartbeat is None:
            return False
        if self._control.claimed(Mover.ORDER) and mode in self._commander.follows:
            return True
        if mode == self._commander.ordered:
            return True
        if self._commander.overtaken(mode) and intended in (None, mode):
            self._let_pass(mode)
            return True
        by_order = self._under_order() and intended in (None, mode) and mode in by_command(autopilot, self._what)
        failsafe = int(heartbeat["system_status"]) >= CRITICAL if intended is None else intended != mode
        by_itself = by_order or (mode in ends_in(autopilot, before) and not failsafe)
        if by_itself and intended is None:
            self._unsaid = before
        return by_itself

    def _let_pass(self, mode: str) -> None:
        """An overtaken mode: where it stays, it was somebody's wish after all."""
        if self._passing is not None:
            self._passing.cancel()
        loop = asyncio.get_running_loop()
        ordered = self._commander.ordered
        self._passing = loop.call_later(self._commander.confirm_timeout, self._judge_passed, mode, ordered)

    def _judge_passed(self, mode: str, ordered: str | None) -> None:
        """``ordered``: what was to come after it."""
        if self._armed and self._mode == mode and self._commander.ordered == ordered is not None:
            self._tell(f"the mode is still {mode}, and {ordered} was ordered here since")

    def _under_order(self) -> bool:
        return self._control.claimed(Mover.ORDER) or time.monotonic() < self._grace

    def _ends_on_ground(self, mode: str | None) -> bool:
        """It disarms there by itself, or somebody ordered it."""
        if self._what in DISARMING and time.monotonic() < self._grace:
            return True
        autopilot = self._identity.autopilot
        return autopilot is not None and mode is not None and mode in _landing_modes(autopilot)

    def _on_rc(self, fields: Fields, frame: Frame) -> None:
        switch = self.switch
        assert switch is not None
        pwm = int(fields[f"chan{switch.channel}_raw"])
        if pwm in UNHEARD:
            return  # a lost radio does not give the vehicle back
        if not switch.low <= pwm <= switch.high:
            self._control.leave(self)
        elif self._control.pilot is None:
            self._control.take(self, Mover.PILOT, f"his switch (channel {switch.channel}) is at {pwm} µs")
            self._tell(f"the pilot's switch (channel {switch.channel}) is at {pwm} µs", by_switch=True)

    def _tell(self, text: str, *, by_switch: bool = False) -> None:
        self._port.bus.tell(TakenByPilot(text, by_switch))


def _landing_modes(autopilot: Autopilot) -> set[str | None]:
    return {"AUTO", "MISSION", mode_of(autopilot.land), mode_of(autopilot.rtl)}
