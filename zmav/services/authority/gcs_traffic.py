"""What other stations put on ``mav/tx``, held against who commands the vehicle.

A ground station that changes the mode takes the vehicle from every agent, as a pilot does, and is known before the
HEARTBEAT shows it. Its setpoints wait for the agent that holds the lease: two streams at once fly neither. Plans
and parameters that it would write as files of MAVFTP, which nobody would judge, do not go out.
"""

from __future__ import annotations

import asyncio
from typing import NamedTuple

from zmav.autopilots.safety import changes_mode, makes_safe
from zmav.mavlink import Frame, decode
from zmav.mavlink.ftp import check_request
from zmav.services.authority.lease import Leases
from zmav.services.authority.may_move import MayMove
from zmav.services.companion import Companion
from zmav.services.link.port import FrameForwarded
from zmav.waiting import on_loop

STREAMED = (
    "SET_ATTITUDE_TARGET",
    "SET_POSITION_TARGET_LOCAL_NED",
    "SET_POSITION_TARGET_GLOBAL_INT",
    "SET_ACTUATOR_CONTROL_TARGET",
)
GUIDED_ITEMS, GUIDED = ("MISSION_ITEM", "MISSION_ITEM_INT"), (2, 3)
"""and ``current`` of those that are no plan's: a place that ArduPilot flies to now, and a height"""
SET_MODE, FILES = "SET_MODE", "FILE_TRANSFER_PROTOCOL"


class TakenByStation(NamedTuple):
    """A station has ordered a mode or a flight. Told on the event loop."""

    text: str


class GcsTraffic:
    """``guard`` raises while two claim to be the vehicle. The port's bus is told of :class:`TakenByStation`."""

    def __init__(self, companion: Companion, leases: Leases, guard: MayMove[[]]) -> None:
        self._port, self._identity, self._leases, self._guard = companion.port, companion.identity, leases, guard
        by_name = companion.port.dialect.by_name
        self._streamed = {by_name[name].id for name in STREAMED if name in by_name}
        self._items = {by_name[name].id for name in GUIDED_ITEMS if name in by_name}
        self._ordering = {by_name[name].id for name in ("COMMAND_LONG", "COMMAND_INT", SET_MODE) if name in by_name}
        self._files = {by_name[name].id for name in (FILES,) if name in by_name}

    def start(self) -> None:
        judge = on_loop(asyncio.get_running_loop(), self._judge)
        self._port.bus.on(
            FrameForwarded, lambda told: judge(told.frame) if told.frame.msgid in self._ordering else None
        )

    def admit(self, frame: Frame) -> None:
        """Any thread: raise :class:`~zmav.errors.NotHolder` for a setpoint while an agent holds the lease,
        :class:`~zmav.errors.BadInput` for a file that is written in place of a plan or of parameters, and
        :class:`~zmav.errors.Clash` where two claim to be the vehicle; what makes it safe passes, to both.
        """
        autopilot = self._identity.autopilot
        if autopilot is None or not makes_safe(frame, self._port.dialect, autopilot):
            self._guard()
        if frame.msgid in self._files:
            check_request(decode(frame, self._port.dialect)["payload"])
        if self._leases.holder is None:
            return
        guided = frame.msgid in self._items and decode(frame, self._port.dialect)["current"] in GUIDED
        if guided or frame.msgid in self._streamed:
            raise self._leases.refusal()

    def _judge(self, frame: Frame) -> None:
        fields, source = decode(frame, self._port.dialect), self._identity.source
        if source is None or fields["target_system"] not in (0, source[0]):
            return
        name = self._port.dialect.name_of(frame.msgid)
        if name != SET_MODE:
            name = self._port.dialect.enum_name("MAV_CMD", fields["command"]) or ""
            if not changes_mode(name):
                return
        self._port.bus.tell(TakenByStation(f"station {frame.sysid} ordered {name.removeprefix('MAV_CMD_')}"))
