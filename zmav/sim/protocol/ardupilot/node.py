"""One ArduPilot's MAVLink face: what it sends by itself, and who answers what comes in. What it reports and which
commands it takes is joined to it by the kind of vehicle: :mod:`.copter`, :mod:`.plane`, :mod:`.rover`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar, Generic, TypeVar

from zmav.mavlink.dialect import Dialect
from zmav.mavlink.results import CommandResult
from zmav.sim.autopilots.ardupilot.state import CRITICAL, INFO
from zmav.sim.autopilots.ardupilot.vehicle import ArduVehicle
from zmav.sim.protocol.ardupilot import setpoint
from zmav.sim.protocol.ardupilot.mission import MissionProtocol
from zmav.sim.protocol.ardupilot.setpoint import guided_item
from zmav.sim.protocol.ardupilot.signing import SigningPart
from zmav.sim.protocol.ardupilot.storage import Storage
from zmav.sim.protocol.base import GIT_HASH, Node, Target
from zmav.sim.protocol.channel import Channel, Command, Sender
from zmav.sim.protocol.params import ParamProtocol
from zmav.sim.protocol.streams import RATE_PARAMS, RATE_PREFIX

PIECE = 50  # characters of a STATUSTEXT
_NAN_ALLOWED = (22, 192, 1000)  # NAV_TAKEOFF, DO_REPOSITION, DO_GIMBAL_MANAGER_PITCHYAW
V_co = TypeVar("V_co", bound=ArduVehicle, covariant=True)


class MavNode(Node, Generic[V_co]):
    """Speaks for one :class:`ArduVehicle`; a kind of vehicle adds the commands that only it knows."""

    SYSID_PARAM: ClassVar[str] = "MAV_SYSID"
    REFUSED: ClassVar[int] = CommandResult.FAILED
    COMMANDS_NOT_SIMULATED: ClassVar[tuple[int, ...]] = (
        *(84, 85, 115, 181, 182, 184, 186, 189, 191, 193, 194, 195, 197, 201, 203, 204, 205, 207, 209, 218, 245),
        *(601, 2000, 2001, 43000, 43001, 43002),
    )
    # NAV_VTOL_*, CONDITION_YAW, relays, DO_REPEAT_SERVO, DO_CHANGE_ALTITUDE, DO_LAND_START, DO_GO_AROUND,
    # DO_PAUSE_CONTINUE, DO_SET_REVERSE, regions of interest, camera and mount, DO_FENCE_ENABLE, DO_MOTOR_TEST,
    # DO_AUX_FUNCTION, PREFLIGHT_STORAGE; DO_JUMP_TAG, GUIDED_CHANGE_*
    TARGETS: ClassVar[Mapping[str, Target]] = {
        "SET_POSITION_TARGET_LOCAL_NED": setpoint.local_target,
        "SET_POSITION_TARGET_GLOBAL_INT": setpoint.global_target,
        "SET_ATTITUDE_TARGET": setpoint.attitude_target,
    }

    def __init__(self, vehicle: V_co, dialect: Dialect, *, uid: int, epoch_us: int) -> None:
        super().__init__(vehicle, dialect, uid=uid, epoch_us=epoch_us)
        self.vehicle = vehicle
        self._reached: int | None = None
        self._text_id = 0
        self.storage = Storage(self, vehicle)
        for part in self.storage.parts:
            self.add(part)
        params = ParamProtocol(vehicle.params, lambda: self.channels, self.banner)
        self.add(params)
        stores = (vehicle.mission, vehicle.fence.items, vehicle.rally)
        self.add(MissionProtocol(self, stores, lambda item: guided_item(vehicle, item)))
        vehicle.report, vehicle.reached, vehicle.learned = self.report_to_all, self._item_reached, params.tell
        self.add(SigningPart(self))
        self.answer("HEARTBEAT", self._heartbeat)
        self.answer("TERRAIN_DATA", lambda channel, msg, sender: vehicle.terrain.take(msg))
        self.answer("SET_MODE", self._set_mode)
        self.answer("REQUEST_DATA_STREAM", self._data_stream)
        self.answer("MISSION_SET_CURRENT", self._set_current)
        self.answer("RC_CHANNELS_OVERRIDE", self._rc_override)
        self.answer("MANUAL_CONTROL", self._manual_control)

    @property
    def prearm_ok(self) -> bool:
        return not self.vehicle.prearm_faults()

    # ---- out

    def flows(self, name: str) -> bool:
        """Until it is initialised only its heartbeat does."""
        return name == "HEARTBEAT" or self.vehicle.boot.has("initialised")

    def greet(self, channel: Channel) -> None:
        """Start the streams of the port's MAV1_, MAV2_ or MAV3_ parameters."""
        prefix = RATE_PREFIX.get(channel.link, "MAV1_")
        for param, group in RATE_PARAMS.items():
            rate = self.vehicle.params[f"{prefix}{param}"]
            if rate > 0:
                channel.streams.set_group(group, rate, self.vehicle.now)

    def say(self, severity: int, text: str) -> None:
        """A STATUSTEXT on every channel, in numbered pieces where it is long, and into the log."""
        self.storage.flight_log.say(severity, text)
        pieces = [text[start : start + PIECE] for start in range(0, max(len(text), 1), PIECE)]
        number = 0
        if len(pieces) > 1:
            self._text_id = number = self._text_id % 65535 + 1
        for channel in self.channels:
            for index, piece in enumerate(pieces):
                channel.send("STATUSTEXT", severity=severity, text=piece, id=number, chunk_seq=index)

    def say_prearm(self) -> None:
        for fault in self.vehicle.prearm_faults():
            self.say(CRITICAL, f"PreArm: {fault}")

    def _item_reached(self, seq: int) -> None:
        """Of several items in one tick only the last is told, as ArduPilot does."""
        self._reached = seq

    def tick(self) -> None:
        super().tick()
        if self._reached is not None:
            for channel in self.channels:
                channel.send("MISSION_ITEM_REACHED", seq=self._reached)
            self._reached = None

    def banner(self, channel: Channel) -> None:
        vehicle = self.vehicle
        texts = [f"{vehicle.FIRMWARE} V4.7.0-dev ({GIT_HASH})", f"{self.uid:032x}"]
        if vehicle.FRAME:
            texts.append(f"Frame: {vehicle.FRAME}")
        for text in texts:
            channel.send("STATUSTEXT", severity=INFO, text=text)

    # ---- in

    def asked_period(self, microseconds: float) -> float:
        """Whole milliseconds, up to a minute."""
        return min(max(int(microseconds / 1000.0), 1), 60000) / 1000.0 if microseconds > 0 else 0.0

    def takes(self, command: Command) -> bool:
        """Not a first or second parameter that is no number."""
        return (math.isfinite(command.p1) and math.isfinite(command.p2)) or command.number in _NAN_ALLOWED

    def _heartbeat(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        self.vehicle.gcs.heard(sender[0])

    def _from_gcs(self, sender: Sender) -> bool:
        """Whether the pilot's sticks may come from there; such words count as the ground station's heartbeat."""
        self.vehicle.gcs.heard(sender[0])
        return sender[0] == int(self.vehicle.params["MAV_GCS_SYSID"])

    def _rc_override(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        if self._from_gcs(sender):
            self.vehicle.rc.override(msg)

    def _manual_control(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        if msg["target"] == self.sysid and self._from_gcs(sender):
            self.vehicle.rc.manual(msg)

    def _set_current(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        """The number asked for comes back, even where the mission holds another: clients take that for an answer."""
        if self.vehicle.mission.set_current(msg["seq"]):
            fields = self.fields("MISSION_CURRENT") or {}
            channel.send("MISSION_CURRENT", **{**fields, "seq": msg["seq"]})

    def _set_mode(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        if msg["base_mode"] & 1:
            self.vehicle.set_mode(msg["custom_mode"])

    def _data_stream(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        rate = float(msg["req_message_rate"]) if msg["start_stop"] == 1 else 0.0
        channel.streams.set_group(msg["req_stream_id"], rate, self.vehicle.now)


ArduNode = MavNode[ArduVehicle]
