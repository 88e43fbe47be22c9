"""One vehicle's MAVLink face: its channels, what it sends on them by itself, and who answers what comes in."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from zmav.errors import BadMessage
from zmav.mavlink.codec import decode
from zmav.mavlink.dialect import Dialect
from zmav.mavlink.frames import Frame
from zmav.sim.autopilots.arducopter import CRITICAL, INFO, ArduCopter
from zmav.sim.autopilots.arming import prearm_faults
from zmav.sim.control.setpoints import Vector
from zmav.sim.protocol import commands, setpoint
from zmav.sim.protocol.channel import Channel, Outlet
from zmav.sim.protocol.mission import MissionProtocol
from zmav.sim.protocol.params import ParamProtocol
from zmav.sim.protocol.reports.status import GIT_HASH
from zmav.sim.protocol.router import Router
from zmav.sim.protocol.streams import RATE_PARAMS
from zmav.sim.protocol.telemetry import REPORTS
from zmav.sim.sensors.magnetic import earth_field

COMPONENT = 1  # MAV_COMP_ID_AUTOPILOT1
TIMESYNC_PERIOD_S = 10.0
GCS = 6  # MAV_TYPE_GCS
REBOOT_DELAY_S = 0.2

Answer = Callable[[Channel, dict[str, Any], tuple[int, int]], None]


class MavNode:
    """Speaks for one :class:`ArduCopter` as system ``sysid``, component 1. Everything here runs in the world's
    thread.
    """

    def __init__(self, copter: ArduCopter, dialect: Dialect, *, uid: int, epoch_us: int) -> None:
        self.copter = copter
        self.dialect = dialect
        self.uid = uid
        self.wind: Vector = (0.0, 0.0, 0.0)
        place = copter.world
        self.field = earth_field(place.lat_deg, place.lon_deg)
        self.throttles: Callable[[], list[float]] = list  # of each rotor, 0..1
        self.rotor_speeds: Callable[[], list[float]] = list  # shares of the highest
        self.channels: list[Channel] = []
        self.bad_messages = 0
        self._epoch_us = epoch_us
        self._router = Router(dialect)
        self._params = ParamProtocol(copter.params, lambda: self.channels, self.banner)
        self._mission = MissionProtocol()
        self._ids = {dialect.by_name[name].id: name for name in REPORTS}
        self._pending: list[tuple[Channel, str]] = []
        self._next_timesync = TIMESYNC_PERIOD_S
        self._reboot_at: float | None = None
        self._answers = self._make_answers()
        copter.say, copter.beat, copter.announce = self.say, self.beat, self.announce
        self._hook_params()

    @property
    def sysid(self) -> int:
        """MAV_SYSID, or the nearest there is."""
        return min(max(int(self.copter.params["MAV_SYSID"]), 1), 255)

    @property
    def unix_us(self) -> int:
        """UTC as the GPS would tell it, microseconds."""
        return self._epoch_us + int(self.copter.now * 1e6)

    @property
    def prearm_ok(self) -> bool:
        return not prearm_faults(self.copter)

    def dialect_name(self, msgid: int) -> str:
        """Name of a message that this vehicle can report; empty for any other."""
        return self._ids.get(msgid, "")

    # ---- channels

    def open_channel(self, outlet: Outlet) -> Channel:
        """A new link; it hears the heartbeat from now on, and the streams of the MAV1_ parameters."""
        channel = Channel(self.dialect, outlet, self.sysid, COMPONENT, self.copter.now)
        for param, group in RATE_PARAMS.items():
            if self.copter.params[param] > 0:
                channel.streams.set_group(group, self.copter.params[param], self.copter.now)
        self.channels.append(channel)
        return channel

    def close_channel(self, channel: Channel) -> None:
        if channel in self.channels:
            self.channels.remove(channel)
        self._router.forget(channel)
        self._pending = [p for p in self._pending if p[0] is not channel]

    # ---- out

    def tick(self) -> None:
        """Send what is due."""
        now = self.copter.now
        if self._reboot_at is not None and now >= self._reboot_at:
            self._reboot_at = None
            self.copter.power_on()
        for channel in self.channels:
            for name in channel.streams.due(now):
                self.report(channel, name)
            self._params.feed(channel)
        if now >= self._next_timesync:
            self._next_timesync = now + TIMESYNC_PERIOD_S
            for channel in self.channels:
                channel.send("TIMESYNC", tc1=0, ts1=self._nanoseconds())

    def report(self, channel: Channel, name: str) -> None:
        """Send one message of :data:`REPORTS`, unless there is nothing to say yet."""
        try:
            fields = REPORTS[name](self)
            if fields is not None:
                channel.send(name, **fields)
        except (BadMessage, ArithmeticError, ValueError):
            # A number that its field cannot hold, such as a speed beyond all reason: this one message is not sent.
            self.bad_messages += 1

    def after_ack(self, channel: Channel, name: str) -> None:
        """Send a message once the acknowledgement of what is being handled is out."""
        self._pending.append((channel, name))

    def reboot_after_ack(self) -> None:
        self._reboot_at = self.copter.now + REBOOT_DELAY_S

    def say(self, severity: int, text: str) -> None:
        """A STATUSTEXT on every channel (at most 50 characters of it, as ArduPilot's are)."""
        for channel in self.channels:
            channel.send("STATUSTEXT", severity=severity, text=text[:50])

    def say_prearm(self) -> None:
        for fault in prearm_faults(self.copter):
            self.say(CRITICAL, f"PreArm: {fault}")

    def beat(self) -> None:
        for channel in self.channels:
            self.report(channel, "HEARTBEAT")

    def announce(self) -> None:
        """Where the origin and home are now."""
        for channel in self.channels:
            self.report(channel, "GPS_GLOBAL_ORIGIN")
            self.report(channel, "HOME_POSITION")

    def banner(self, channel: Channel) -> None:
        frame = "HEXA/X" if len(self.copter.airframe.rotors) == 6 else "QUAD/PLUS"
        for text in (f"ArduCopter V4.7.0-dev ({GIT_HASH})", f"{self.uid:032x}", f"Frame: {frame}"):
            channel.send("STATUSTEXT", severity=INFO, text=text)

    # ---- in

    def receive(self, channel: Channel, data: bytes) -> None:
        """Take bytes that came by ``channel``. Bad ones are counted and dropped; nothing raises."""
        for frame in channel.splitter.feed(data):
            if frame.verified and self._router.route(frame, channel, self.channels, (self.sysid, COMPONENT)):
                self._handle(channel, frame)

    def _handle(self, channel: Channel, frame: Frame) -> None:
        answer = self._answers.get(frame.msgid)
        if answer is None:
            return
        try:
            answer(channel, decode(frame, self.dialect), (frame.sysid, frame.compid))
        except (BadMessage, ArithmeticError, ValueError):
            # Whatever one client sends, the world goes on for the others.
            self.bad_messages += 1
        pending, self._pending = self._pending, []
        for where, name in pending:
            self.report(where, name)

    def _make_answers(self) -> dict[int, Answer]:
        copter, mission, params = self.copter, self._mission, self._params
        by_name: dict[str, Answer] = {
            "HEARTBEAT": self._heartbeat,
            "TIMESYNC": self._timesync,
            "PING": self._ping,
            "SET_MODE": self._set_mode,
            "REQUEST_DATA_STREAM": self._data_stream,
            "COMMAND_LONG": lambda ch, m, who: commands.run(self, commands.from_long(m, ch, who)),
            "COMMAND_INT": lambda ch, m, who: commands.run(self, commands.from_int(m, ch, who)),
            "PARAM_REQUEST_LIST": lambda ch, m, who: params.request_list(ch, m),
            "PARAM_REQUEST_READ": lambda ch, m, who: params.request_read(ch, m),
            "PARAM_SET": lambda ch, m, who: params.set(ch, m),
            "SET_POSITION_TARGET_LOCAL_NED": lambda ch, m, who: setpoint.local_target(copter, m),
            "SET_POSITION_TARGET_GLOBAL_INT": lambda ch, m, who: setpoint.global_target(copter, m),
            "SET_ATTITUDE_TARGET": lambda ch, m, who: setpoint.attitude_target(copter, m),
            "MISSION_REQUEST_LIST": mission.request_list,
            "MISSION_COUNT": mission.count,
            "MISSION_CLEAR_ALL": mission.clear_all,
            "MISSION_REQUEST": mission.request_item,
            "MISSION_REQUEST_INT": mission.request_item,
            "MISSION_ITEM": mission.item,
            "MISSION_ITEM_INT": mission.item,
        }
        return {self.dialect.by_name[name].id: answer for name, answer in by_name.items()}

    def _heartbeat(self, channel: Channel, msg: dict[str, Any], sender: tuple[int, int]) -> None:
        self.copter.gcs.heard(sender[0])

    def _timesync(self, channel: Channel, msg: dict[str, Any], sender: tuple[int, int]) -> None:
        if msg["tc1"] == 0:
            channel.send("TIMESYNC", tc1=self._nanoseconds(), ts1=msg["ts1"])

    def _ping(self, channel: Channel, msg: dict[str, Any], sender: tuple[int, int]) -> None:
        if msg["target_system"] == 0 and msg["target_component"] == 0:
            channel.send(
                "PING",
                time_usec=msg["time_usec"],
                seq=msg["seq"],
                target_system=sender[0],
                target_component=sender[1],
            )

    def _set_mode(self, channel: Channel, msg: dict[str, Any], sender: tuple[int, int]) -> None:
        if msg["base_mode"] & 1:
            self.copter.set_mode(msg["custom_mode"])

    def _data_stream(self, channel: Channel, msg: dict[str, Any], sender: tuple[int, int]) -> None:
        rate = float(msg["req_message_rate"]) if msg["start_stop"] == 1 else 0.0
        channel.streams.set_group(msg["req_stream_id"], rate, self.copter.now)

    def _nanoseconds(self) -> int:
        return int(self.copter.uptime * 1e9)

    def _hook_params(self) -> None:
        """A new MAV_SYSID is spoken with at once."""
        flying = self.copter.params.changed

        def changed(name: str, value: float) -> None:
            flying(name, value)
            if name == "MAV_SYSID":
                for channel in self.channels:
                    channel.adopt(self.sysid)

        self.copter.params.changed = changed
