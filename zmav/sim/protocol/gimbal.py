"""A gimbal on servos and the gimbal manager before it, as ArduCopter 4.7 (MNT1_TYPE 1) and PX4 1.16 (MNT_MODE_IN 4,
MNT_MODE_OUT 0) answered in software in the loop: it turns at once, and as far as its ranges go.

Protocol: https://mavlink.io/en/services/gimbal_v2.html
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from zmav import rotation
from zmav.mavlink.results import CommandResult
from zmav.sim.protocol.channel import Channel, Command, Sender
from zmav.sim.protocol.corrections import Carrier

RETRACT, NEUTRAL, LOCK = 1, 2, 16
YAW_FLAGS = 256 | 512 | 1024
"""GIMBAL_MANAGER_CAP_FLAGS of the yaw axis"""
LEVEL = 4 | 8
BODY_FRAME = 32
"""GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME, which ArduPilot says and PX4 does not, though both tell it so"""
NOBODY = (0, 0)
TOLD_S = 1.0
"""s of PX4 between two looks at who controls it"""
OTHER = (255, 190)
"""a ground station's, for the fault"""
ARDUPILOT_CAPS, PX4_CAPS = 206819, 132530
MOUNT_TYPE, MODE_IN = "MNT1_TYPE", "MNT_MODE_IN"
PITCH_DEG, YAW_DEG = (-90.0, 20.0), (-160.0, 160.0)
PX4_PITCH_DEG, PX4_YAW_DEG = (-90.0, 90.0), (-360.0, 360.0)


class SimGimbal:
    """One vehicle's; there is one where the parameters said so when it started. ``silent`` and ``turns`` are faults:
    it does not answer, and (False) it has no yaw axis.
    """

    def __init__(self, node: Carrier) -> None:
        self._node = node
        self._px4 = MODE_IN in node.brain.params
        self.silent, self.turns = False, True
        self.restart()

    def restart(self) -> None:
        params = self._node.brain.params
        self._fitted = params[MODE_IN] >= 0 if self._px4 else params.get(MOUNT_TYPE) != 0
        self.control: tuple[int, int] = NOBODY
        """system and component that control it"""
        self._told, self._told_at = NOBODY, -TOLD_S
        self._pitch = self._yaw = 0.0
        self._flags = LEVEL

    @property
    def there(self) -> bool:
        return self._fitted and not self.silent

    @property
    def angles(self) -> tuple[float, float]:
        """Pitch from the horizon and yaw from the nose, rad, as far as they go."""
        reach = (PX4_PITCH_DEG, PX4_YAW_DEG) if self._px4 else (PITCH_DEG, YAW_DEG)
        yaw = self._yaw - self._node.brain.sense.yaw if self._flags & LOCK else self._yaw
        pitch, yaw = (
            min(max(angle, math.radians(low)), math.radians(high))
            for angle, (low, high) in zip((self._pitch, rotation.wrap(yaw)), reach, strict=True)
        )
        return pitch, yaw if self.turns else 0.0

    # What it is told.

    def configure(self, command: Command) -> int:
        """DO_GIMBAL_MANAGER_CONFIGURE: -1 leaves it, -2 is who asks (PX4: itself), -3 gives it back."""
        if not self.there:
            return self._absent
        system, component = round(command.p1), round(command.p2)
        if not (-3 <= system <= 255 and -3 <= component <= 255):
            return CommandResult.FAILED
        if system >= 0:
            self.control = system, max(component, 0)
        elif system == -2:
            self.control = (self._node.sysid, 1) if self._px4 else command.sender
        elif system == -3 and self.control == command.sender:
            self.control = NOBODY
        return CommandResult.ACCEPTED

    def pitch_yaw(self, command: Command) -> int:
        """DO_GIMBAL_MANAGER_PITCHYAW. PX4 takes it from who has control, ArduPilot from everybody."""
        if not self.there:
            return self._absent
        if self._px4 and command.sender != self.control:
            return CommandResult.DENIED
        flags = int(command.x)
        if not flags & (RETRACT | NEUTRAL) and not (math.isfinite(command.p1) and math.isfinite(command.p2)):
            return CommandResult.FAILED
        self._turn(math.radians(command.p1), math.radians(command.p2), flags)
        return CommandResult.ACCEPTED

    def set_attitude(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        """GIMBAL_MANAGER_SET_ATTITUDE."""
        if self.there and (not self._px4 or sender == self.control) and all(map(math.isfinite, msg["q"])):
            _, pitch, yaw = rotation.euler(msg["q"])
            self._turn(pitch, yaw, msg["flags"])

    def _turn(self, pitch: float, yaw: float, flags: int) -> None:
        back = bool(flags & (RETRACT | NEUTRAL))
        self._pitch, self._yaw = (0.0, 0.0) if back else (pitch, yaw)
        self._flags = flags & (NEUTRAL | LOCK | LEVEL) if self._px4 else LEVEL | (flags & (NEUTRAL | LOCK))
        self._flags &= ~LOCK if back else ~0

    @property
    def _absent(self) -> int:
        return CommandResult.UNSUPPORTED if self._px4 else CommandResult.FAILED

    # What it tells.

    def information(self) -> dict[str, Any] | None:
        if not self.there:
            return None
        caps = (PX4_CAPS if self._px4 else ARDUPILOT_CAPS) & (~0 if self.turns else ~YAW_FLAGS)
        if self._px4:  # in degrees, against the protocol
            (low, high), (left, right) = PX4_PITCH_DEG, PX4_YAW_DEG
        else:
            (low, high), (left, right) = (tuple(map(math.radians, each)) for each in (PITCH_DEG, YAW_DEG))
        ranges = {"pitch_min": low, "pitch_max": high, "yaw_min": left, "yaw_max": right}
        return {"cap_flags": caps, "gimbal_device_id": 1, **ranges}

    def status(self) -> dict[str, Any] | None:
        now = self._node.brain.now
        if not self._px4 or not 0.0 <= now - self._told_at < TOLD_S:
            self._told, self._told_at = self.control, now
        system, component = self._told
        fields = {"flags": self._flags, "gimbal_device_id": 1}
        return {**fields, "primary_control_sysid": system, "primary_control_compid": component} if self.there else None

    def attitude(self) -> dict[str, Any] | None:
        if not self.there:
            return None
        pitch, yaw = self.angles
        flags = self._flags if self._px4 else self._flags | BODY_FRAME
        return {"flags": flags, "q": list(rotation.from_euler(0.0, pitch, yaw)), "gimbal_device_id": 1}


HANDLERS: Mapping[int, Any] = {
    1000: lambda node, c: node.gimbal.pitch_yaw(c),
    1001: lambda node, c: node.gimbal.configure(c),
}
REPORTS: Mapping[str, Any] = {
    "GIMBAL_MANAGER_INFORMATION": lambda node: node.gimbal.information(),
    "GIMBAL_MANAGER_STATUS": lambda node: node.gimbal.status(),
    "GIMBAL_DEVICE_ATTITUDE_STATUS": lambda node: node.gimbal.attitude(),
}
