"""Who is on the link: found by HEARTBEAT, told apart by AUTOPILOT_VERSION, watched for a second one of the same id."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from zmav.autopilots import Autopilot, Command, autopilot_for, kind_of
from zmav.mavlink import Frame, decode
from zmav.services.link.port import Port
from zmav.services.link.reported import INTENTION_LASTS, in_the_air
from zmav.services.status.events import Events
from zmav.waiting import on_loop

VERSION = Command("MAV_CMD_REQUEST_MESSAGE", (148.0,))
"""AUTOPILOT_VERSION"""
HEARTBEAT_TIMEOUT = 3.0
NOT_AUTOPILOTS = (6, 18, 26, 27, 30)
"""MAV_TYPE of a ground station, an onboard controller, a gimbal, ADS-B, a camera"""
AUTOPILOT_INVALID = 8


class VehicleChanged(NamedTuple):
    """Who the vehicle is, its mode or the one intended, its arming, or whether two claim to be it. On the loop."""


class Identity:
    """The autopilot behind the link: its address, rules, uid, and whether it is heard. Lives on the event loop."""

    heartbeat_timeout = HEARTBEAT_TIMEOUT
    uid_memory = 15.0
    ask_every = 5.0

    def __init__(self, port: Port, events: Events, sysid: int | None = None) -> None:
        self._port, self._events, self._wanted = port, events, sysid
        self.source: tuple[int, int] | None = None
        self.autopilot: Autopilot | None = None
        self.mav_type = 0
        self._stack: int | None = None
        """its MAV_AUTOPILOT"""
        self.uid: str | None = None
        self.firmware: str | None = None
        self.heartbeat: Mapping[str, Any] | None = None
        self._custom = 0
        """the custom mode by HEARTBEAT or what tells it sooner, whichever came last"""
        self._intended: int | None = None
        self._intended_at = 0.0
        self.connected = False
        self.clash: str | None = None
        """two autopilots of one system id on this very link"""
        self._heard = 0.0
        self._asked = 0.0
        self._uids: dict[str, float] = {}
        self._others: set[tuple[int, int]] = set()
        """autopilots heard beside ours: a link of several vehicles is no exchange when ours falls silent"""
        self._stops: list[Callable[[], None]] = []

    def start(self) -> None:
        loop = asyncio.get_running_loop()
        self._stops = [
            self._port.listen("HEARTBEAT", on_loop(loop, self._on_heartbeat)),
            self._port.listen("CURRENT_MODE", on_loop(loop, self._on_mode)),
            self._port.listen("AUTOPILOT_VERSION", on_loop(loop, self._on_version)),
        ]

    def close(self) -> None:
        for stop in self._stops:
            stop()

    @property
    def kind(self) -> str:
        return kind_of(self.mav_type)

    @property
    def mode(self) -> str | None:
        if self.heartbeat is None or self.autopilot is None:
            return None
        return self.autopilot.mode_name(self.heartbeat["base_mode"], self._custom)

    @property
    def intended(self) -> str | None:
        """The mode last asked for, by anybody: another that is flown is a failsafe's. None: it does not say, or has
        not said so since the mode changed.
        """
        if self.heartbeat is None or self.autopilot is None or self._intended is None:
            return None
        if time.monotonic() - self._intended_at > INTENTION_LASTS:
            return None
        return self.autopilot.mode_name(self.heartbeat["base_mode"], self._intended)

    @property
    def mode_messages(self) -> tuple[str, ...]:
        """The messages that tell the mode."""
        sooner = self.autopilot.mode_message if self.autopilot is not None else None
        return ("HEARTBEAT",) if sooner is None else ("HEARTBEAT", sooner)

    @property
    def armed(self) -> bool | None:
        return None if self.heartbeat is None else bool(self.heartbeat["base_mode"] & 128)

    def _on_heartbeat(self, frame: Frame) -> None:
        fields = decode(frame, self._port.dialect)
        if fields["autopilot"] == AUTOPILOT_INVALID or fields["type"] in NOT_AUTOPILOTS:
            return
        source = (frame.sysid, frame.compid)
        unwanted = self._wanted is not None and frame.sysid != self._wanted
        if unwanted or source in self._others or (source != self.source and self.connected):
            self._say_other(source)
            return
        same = source == self.source and self.autopilot is not None and self._is(fields)
        before = (self.mode, self.armed)
        if fields["custom_mode"] != self._custom or not self.connected:
            self._intended = None  # what was intended before: the next message that tells the mode tells this, too
        self.heartbeat, self._heard, self._custom = fields, time.monotonic(), fields["custom_mode"]
        if not same:
            self._adopt(source, fields)
        elif not self.connected:
            self.uid, self._asked = None, 0.0  # it may be another one by now: its uid tells
            self._events.emit("autopilot", "notice", f"autopilot {source[0]} is heard again")
        self.connected = True
        self._say_changes(before)

    def _on_mode(self, frame: Frame) -> None:
        if (frame.sysid, frame.compid) != self.source or self.autopilot is None or not self.connected:
            return
        if self.autopilot.mode_message is None:
            return
        fields, before, said = decode(frame, self._port.dialect), (self.mode, self.armed), self._intended
        self._intended, self._intended_at = fields["intended_custom_mode"], time.monotonic()
        if not (self.armed and in_the_air(self._port, self.source) is False):
            self._custom = fields["custom_mode"]
        # else: with a disarming the mode changes, too, and only a HEARTBEAT tells of that
        self._say_changes(before)
        if self._intended != said and (self.mode, self.armed) == before:
            self._port.bus.tell(VehicleChanged())

    def _is(self, fields: Mapping[str, Any]) -> bool:
        if fields["autopilot"] == self._stack and fields["type"] == self.mav_type:
            return True
        wanted = autopilot_for(fields["autopilot"], fields["type"])
        return bool(self.mav_type == fields["type"] and self.autopilot and self.autopilot.name == wanted.name)

    def _adopt(self, source: tuple[int, int], fields: Mapping[str, Any]) -> None:
        self.autopilot = autopilot_for(fields["autopilot"], fields["type"])
        self.source, self.mav_type, self._intended = source, fields["type"], None
        self._stack = fields["autopilot"]
        self.uid = self.firmware = None
        self._uids.clear()
        self._asked = 0.0
        self._events.emit(
            "autopilot", "notice", f"{self.autopilot.name} {self.kind} with system id {source[0]}", sysid=source[0]
        )
        self._port.bus.tell(VehicleChanged())

    def _say_other(self, source: tuple[int, int]) -> None:
        if source in self._others:
            return
        self._others.add(source)
        advice = "" if self._wanted is not None else "; choose one with --sysid"
        self._events.emit(
            "autopilot",
            "warning",
            f"another autopilot ({source[0]}/{source[1]}) is on this link and is not commanded from here{advice}",
            sysid=source[0],
        )

    def _say_changes(self, before: tuple[str | None, bool | None]) -> None:
        if self.mode != before[0]:
            self._events.emit("mode", "info", f"mode {self.mode}", mode=self.mode)
        if before[1] is not None and self.armed != before[1]:
            self._events.emit("armed", "notice", "armed" if self.armed else "disarmed", armed=self.armed)
        if (self.mode, self.armed) != before:
            self._port.bus.tell(VehicleChanged())

    def _on_version(self, frame: Frame) -> None:
        if (frame.sysid, frame.compid) != self.source:
            return
        fields = decode(frame, self._port.dialect)
        if self.autopilot is not None:
            self.autopilot = self.autopilot.told(fields["capabilities"])
        version = fields["flight_sw_version"]
        self.firmware = f"{version >> 24 & 255}.{version >> 16 & 255}.{version >> 8 & 255}" if version else None
        uid = _uid(fields)
        if uid is None:
            return
        self._uids[uid] = time.monotonic()
        if self.uid is None:
            self.uid = uid
            self._port.bus.tell(VehicleChanged())

    def tick(self) -> None:
        """A few times a second: presence, the question who it is, and whether two answer."""
        now = time.monotonic()
        if self.connected and now - self._heard > self.heartbeat_timeout:
            self.connected, self._intended = False, None
            self._uids.clear()
            self._events.emit("autopilot", "critical", f"autopilot silent for {self.heartbeat_timeout:.0f} s")
            self._port.bus.tell(VehicleChanged())
        if self.connected and self.source and now - self._asked > (self.ask_every if self.uid else 1.0):
            self._asked = now
            asked = VERSION.message(self._port.dialect)
            self._port.send(asked.name, **asked.addressed(*self.source))
        self._judge_uids(now)

    def _judge_uids(self, now: float) -> None:
        self._uids = {uid: t for uid, t in self._uids.items() if now - t < self.uid_memory}
        clash = None
        if len(self._uids) > 1 and self.source:
            clash = f"{len(self._uids)} autopilots with system id {self.source[0]} on this link"
        if self.uid not in self._uids and self._uids:
            self.uid = next(iter(self._uids))
            self._port.bus.tell(VehicleChanged())
        if clash != self.clash:
            self.clash = clash
            self._port.bus.tell(VehicleChanged())


def _uid(fields: Mapping[str, Any]) -> str | None:
    uid2 = bytes(fields["uid2"])
    if any(uid2):
        return uid2.rstrip(b"\0").hex()
    return f"{fields['uid']:016x}" if fields["uid"] else None
