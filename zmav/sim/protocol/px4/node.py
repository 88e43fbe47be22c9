"""One PX4's MAVLink face: what it sends by itself on which link, and who answers what comes in; what it reports and
which commands it takes is joined to it in :mod:`.copter`.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import Any, ClassVar

from zmav.mavlink import Dialect, Field, MessageType, load_dialect
from zmav.mavlink.results import CommandResult
from zmav.sim.autopilots.px4.copter import Px4Copter
from zmav.sim.autopilots.px4.events import Event
from zmav.sim.autopilots.px4.modes import BY_NUMBERS
from zmav.sim.protocol.base import Node, Target
from zmav.sim.protocol.channel import Channel, Sender
from zmav.sim.protocol.px4 import setpoint
from zmav.sim.protocol.px4.mission import Px4MissionProtocol
from zmav.sim.protocol.px4.params import Px4ParamProtocol
from zmav.sim.protocol.px4.storage import Px4Storage

_GCS = 6  # MAV_TYPE_GCS
_WARNING = 4
_ARGUMENTS = 40  # bytes of an EVENT's
TAKES_TORQUES = "1.13"
ONBOARD = "onboard"
GROUND = "ground"
UDP = (ONBOARD, GROUND)
"""those of a PX4 in software in the loop; any other is a board's"""
MOST_HZ = 181.0
"""what such a link gives of a message, whatever is asked for"""

# What it sends unasked, as recorded on PX4 1.16 with its SIH quadrotor.
HZ: Mapping[str, tuple[float, float]] = {
    "HEARTBEAT": (1, 1),
    "SYS_STATUS": (5, 1),
    "SYSTEM_TIME": (1, 0),
    "PING": (1, 0.1),
    "LINK_NODE_STATUS": (1, 1),
    "GPS_RAW_INT": (8, 5),
    "SCALED_PRESSURE": (1, 1),
    "ATTITUDE": (100, 50),
    "ATTITUDE_QUATERNION": (50, 50),
    "LOCAL_POSITION_NED": (30, 50),
    "GLOBAL_POSITION_INT": (50, 50),
    "SERVO_OUTPUT_RAW": (10, 50),
    "RC_CHANNELS": (20, 5),  # with a radio
    "MISSION_CURRENT": (1, 1),
    "VFR_HUD": (10, 4),
    "ATTITUDE_TARGET": (10, 50),
    "POSITION_TARGET_LOCAL_NED": (10, 50),
    "POSITION_TARGET_GLOBAL_INT": (10, 1),
    "HIGHRES_IMU": (50, 0),
    "TIMESYNC": (10, 0),
    "DISTANCE_SENSOR": (10, 0.5),
    "ALTITUDE": (10, 1),
    "BATTERY_STATUS": (0.5, 0.5),
    "ESTIMATOR_STATUS": (1, 0.5),
    "VIBRATION": (0.5, 0.1),
    "HOME_POSITION": (0.5, 0.5),
    "EXTENDED_SYS_STATE": (5, 1),
    "ODOMETRY": (30, 0),
    "CURRENT_EVENT_SEQUENCE": (1 / 3, 1 / 3),
    "CURRENT_MODE": (0.5, 0.5),
}
"""message -> Hz on the onboard link, and on the ground link; 0: it is not sent"""
# Numbers of the lists of items, which newer definitions have behind the others.
_LONGER = {
    "MISSION_COUNT": ("opaque_id",),
    "MISSION_ACK": ("opaque_id",),
    "MISSION_CURRENT": ("mission_id", "fence_id", "rally_points_id"),
}


def _longer(message: MessageType, names: tuple[str, ...]) -> MessageType:
    fields = [Field(name=name, type="uint32_t", extension=True) for name in names if name not in message.by_name]
    order = [field.name for field in (*message.wire_fields, *fields)]
    return MessageType.build(message.id, message.name, message.crc_extra, [*message.fields, *fields], order)


@functools.cache
def px4_dialect() -> Dialect:
    """ardupilotmega (for what a user's tools know) with the fields that PX4 has more."""
    base = load_dialect("ardupilotmega")
    longer = [_longer(base.by_name[name], fields) for name, fields in _LONGER.items()]
    return Dialect.build("px4", base.source, [*base.by_id.values(), *longer], base.enums)


class Px4Node(Node):
    """Speaks for one :class:`Px4Copter`."""

    SYSID_PARAM: ClassVar[str] = "MAV_SYS_ID"
    TIMESYNC_PERIOD_S: ClassVar[float] = math.inf  # it is one of the streams
    STANDS_IN: ClassVar[bool] = False
    REFUSED: ClassVar[int] = CommandResult.TEMPORARILY_REJECTED
    ANSWERED_TWICE: ClassVar[tuple[int, ...]] = (176,)  # DO_SET_MODE: by the receiver, that passes it on, as well
    COMMANDS_NOT_SIMULATED: ClassVar[tuple[int, ...]] = (34, 35, 186, 310)
    # DO_ORBIT, DO_FIGURE_EIGHT, DO_CHANGE_ALTITUDE, ACTUATOR_TEST
    UNKNOWN_INTERVAL, UNKNOWN_REQUEST, UNKNOWN_PERIOD = (
        CommandResult.FAILED,
        CommandResult.DENIED,
        CommandResult.ACCEPTED,
    )
    ACKS_FIRST: ClassVar[bool] = False
    TEXT_END: ClassVar[str] = "\t"
    TARGETS: ClassVar[Mapping[str, Target]] = {
        "SET_POSITION_TARGET_LOCAL_NED": setpoint.local_target,
        "SET_POSITION_TARGET_GLOBAL_INT": setpoint.global_target,
        "SET_ATTITUDE_TARGET": setpoint.attitude_target,
    }

    def __init__(self, copter: Px4Copter, *, uid: int, epoch_us: int, firmware: str = "1.16") -> None:
        super().__init__(copter, px4_dialect(), uid=uid, epoch_us=epoch_us)
        self.copter = copter
        self.firmware = firmware
        self.imu_seen = (-1, -1)
        """numbers of the compass's and the barometer's last samples that were sent"""
        self.events_sent = 0
        self._with_ground: list[Channel] = []  # where a ground station was heard
        copter.event = self.send_event
        self.storage = Px4Storage(self)
        for part in self.storage.parts:
            self.add(part)
        self.add(Px4ParamProtocol(copter.params, lambda: self.channels, lambda text: self.say(_WARNING, text)))
        stores = (copter.mission.items, copter.fence, copter.rally)
        self.add(Px4MissionProtocol(self, stores, copter.mission.renew))
        copter.mission.reached = self._item_reached
        self.answer("HEARTBEAT", self._heartbeat)
        self.answer("SET_MODE", self._set_mode)
        self.answer("MANUAL_CONTROL", self._manual_control)
        self.answer("MISSION_SET_CURRENT", self._set_current)
        if firmware == TAKES_TORQUES:
            self.take_target("SET_ACTUATOR_CONTROL_TARGET", setpoint.actuator_target)

    # ---- out

    def greet(self, channel: Channel) -> None:
        """Start the streams of that link."""
        now = self.copter.now
        if channel.link in UDP:
            channel.streams.least = 1.0 / MOST_HZ
        for name in HZ:
            channel.streams.set_period(name, self.usual_period(channel, name), now)

    def usual_period(self, channel: Channel, name: str) -> float:
        rate = HZ.get(name, (0, 0))[channel.link == GROUND]  # any but the ground link is taken for an onboard one
        return 1.0 / rate if rate else 0.0

    def close_channel(self, channel: Channel) -> None:
        super().close_channel(channel)
        self._with_ground = [c for c in self._with_ground if c is not channel]

    def restart(self) -> None:
        super().restart()
        self._with_ground.clear()

    def say(self, severity: int, text: str) -> None:
        """A STATUSTEXT where a ground station was heard, and nowhere else; and into the log."""
        self.storage.flight_log.say(severity, text)
        for channel in self._with_ground:
            channel.send("STATUSTEXT", severity=severity, text=text[:50])

    def send_event(self, event: Event, arguments: bytes) -> None:
        """An EVENT with the next sequence number, to every link; it is sent once, also where a link missed it."""
        self.events_sent = (self.events_sent + 1) & 0xFFFF
        for channel in self.channels:
            channel.send(
                "EVENT",
                id=event.id,
                event_time_boot_ms=int(self.copter.uptime * 1000.0),
                sequence=self.events_sent,
                log_levels=event.levels,
                arguments=list(arguments.ljust(_ARGUMENTS, b"\0")),
            )

    # ---- in

    def _heartbeat(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        if msg["type"] != _GCS:
            return
        self.copter.failsafe.ground_spoke()
        if channel not in self._with_ground:
            self._with_ground.append(channel)

    def _set_mode(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        custom = msg["custom_mode"]
        mode = BY_NUMBERS.get((custom >> 16 & 0xFF, custom >> 24 & 0xFF))
        if msg["base_mode"] & 1 and mode is not None:
            self.copter.set_mode(mode)

    def _set_current(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        if self.copter.mission.jump(msg["seq"]):
            self.report(channel, "MISSION_CURRENT")

    def _item_reached(self, seq: int) -> None:
        for channel in self.channels:
            channel.send("MISSION_ITEM_REACHED", seq=seq)

    def _manual_control(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        """x forward, y right, r clockwise in -1000 to 1000; z is the throttle in 0 to 1000."""
        pitch, roll, yaw = (min(max(msg[name] / 1000.0, -1.0), 1.0) for name in ("x", "y", "r"))
        self.copter.sticks.joystick(roll, pitch, yaw, min(max(msg["z"] / 1000.0, 0.0), 1.0))
