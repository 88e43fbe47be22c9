"""Outputs beside the motors: free servo channels, relays, a gimbal and a camera trigger.

A gimbal is there where MNT1_TYPE, a camera where CAM1_TYPE was not 0 at the last boot, as in ArduPilot:
https://ardupilot.org/copter/docs/common-camera-gimbals.html, .../common-cameras-and-gimbals.html
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from zmav.geo import wrap_degrees
from zmav.sim.autopilots.items import Item
from zmav.sim.control.setpoints import Vector

if TYPE_CHECKING:
    from zmav.sim.autopilots.ardupilot.vehicle import ArduVehicle

OUTPUTS = 16
RELAYS = 6
FREE_FUNCTIONS = frozenset((0, 1, 22, 23, 28, *range(51, 67)))  # SERVOn_FUNCTION that DO_SET_SERVO may set
INFO = 6
RETRACT, NEUTRAL, TARGETING, RC_TARGETING, GPS_POINT = 0, 1, 2, 3, 4  # MAV_MOUNT_MODE
_RETRACTED, _NEUTRAL, _YAW_LOCK = 1, 2, 16  # GIMBAL_MANAGER_FLAGS
PITCH_RANGE = (-90.0, 20.0)  # degrees


class Camera:
    """A camera that is told to shoot; :attr:`pictures` counts."""

    def __init__(self, vehicle: ArduVehicle) -> None:
        self._vehicle = vehicle
        self.present = False
        self.pictures = 0
        self.shot_at = 0.0
        self.shot_place: Vector = (0.0, 0.0, 0.0)
        self.spacing_m = 0.0
        self._left = 0  # pictures of a series, -1 for ever
        self._period = 0.0
        self._last: tuple[float, float] | None = None

    def shoot(self) -> bool:
        """Take one picture; False without a camera."""
        if not self.present:
            return False
        s = self._vehicle.sense
        self.pictures += 1
        self.shot_at, self.shot_place = self._vehicle.now, (s.north, s.east, s.down)
        self._last = (s.north, s.east)
        self._vehicle.report("CAMERA_FEEDBACK")
        return True

    def series(self, period: float, count: int) -> bool:
        """A picture every so many seconds; ``count`` 0: until stopped."""
        if not self.present:
            return False
        self._period, self._left = max(period, 0.0), count or -1
        return True

    def stop(self) -> None:
        self._left = 0

    def update(self) -> None:
        if self._left:
            if self._vehicle.now - self.shot_at > self._period and self.shoot():
                self._left -= self._left > 0
            return
        if self.spacing_m <= 0.0:
            self._last = None
            return
        s = self._vehicle.sense
        if self._last is None:
            self._last = (s.north, s.east)
        elif math.hypot(s.north - self._last[0], s.east - self._last[1]) >= self.spacing_m:
            self.shoot()


class Gimbal:
    """A mount with pitch and yaw, degrees; ``yaw`` about the nose, or about north where ``locked``."""

    def __init__(self, vehicle: ArduVehicle) -> None:
        self._vehicle = vehicle
        self.present = False
        self.mode = RC_TARGETING
        self.roll = self.pitch = self.yaw = 0.0
        self.locked = False
        self.pitch_rate = self.yaw_rate = 0.0
        self.target: Vector | None = None

    def aim(self, roll: float, pitch: float, yaw: float, *, locked: bool) -> bool:
        if not self.present:
            return False
        self.mode, self.target, self.locked = TARGETING, None, locked
        self.pitch_rate = self.yaw_rate = 0.0
        self.roll, self.pitch, self.yaw = roll, _within(pitch), wrap_degrees(yaw)
        return True

    def slew(self, pitch_rate: float, yaw_rate: float, *, locked: bool) -> bool:
        if not self.present:
            return False
        self.mode, self.target, self.locked = TARGETING, None, locked
        self.pitch_rate, self.yaw_rate = pitch_rate, yaw_rate
        return True

    def point(self, place: Vector | None) -> None:
        """Keep it on a point of the world's NED; None: as the pilot says again."""
        self.target = place
        self.mode = RC_TARGETING if place is None else GPS_POINT

    def rest(self, mode: int) -> bool:
        """Retracted or neutral: straight ahead."""
        self.mode, self.target = mode, None
        self.roll = self.pitch = self.yaw = self.pitch_rate = self.yaw_rate = 0.0
        return self.present

    def update(self, dt: float) -> None:
        if self.target is not None:
            s, t = self._vehicle.sense, self.target
            north, east, down = t[0] - s.north, t[1] - s.east, t[2] - s.down
            self.pitch = _within(-math.degrees(math.atan2(down, math.hypot(north, east))))
            self.yaw, self.locked = math.degrees(math.atan2(east, north)), True
        elif self.pitch_rate or self.yaw_rate:
            self.pitch = _within(self.pitch + self.pitch_rate * dt)
            self.yaw = wrap_degrees(self.yaw + self.yaw_rate * dt)

    @property
    def yaw_ahead(self) -> float:
        """Degrees right of the nose."""
        return wrap_degrees(self.yaw - math.degrees(self._vehicle.sense.yaw)) if self.locked else self.yaw


class Payload:
    """All of these of one vehicle."""

    def __init__(self, vehicle: ArduVehicle) -> None:
        self._vehicle = vehicle
        self.servos: list[int] = [0] * OUTPUTS
        self.relays: list[bool] = [False] * RELAYS
        self.camera = Camera(vehicle)
        self.gimbal = Gimbal(vehicle)

    def power_on(self) -> None:
        params = self._vehicle.params
        self.servos = [0] * OUTPUTS
        # Only a relay that is set up has the parameter that says how it starts.
        starts = [f"RELAY{i}_DEFAULT" for i in range(1, RELAYS + 1)]
        self.relays = [name in params and params[name] == 1 for name in starts]
        self.camera, self.gimbal = Camera(self._vehicle), Gimbal(self._vehicle)
        self.camera.present = params["CAM1_TYPE"] > 0
        self.gimbal.present = params["MNT1_TYPE"] > 0

    def update(self, dt: float) -> None:
        """Ten times a second."""
        if self.camera.present:
            self.camera.update()
        if self.gimbal.present:
            self.gimbal.update(dt)

    # ---- orders

    def set_servo(self, channel: int, pwm: int) -> bool:
        """Set an output that nothing else drives; else False, with the reason said."""
        if not 1 <= channel <= OUTPUTS:
            return False
        if int(self._vehicle.params[f"SERVO{channel}_FUNCTION"]) not in FREE_FUNCTIONS:
            self._vehicle.say(INFO, f"ServoRelayEvent: Channel {channel} is already in use")
            return False
        self.servos[channel - 1] = pwm
        return True

    def has_relay(self, index: int) -> bool:
        return 0 <= index < RELAYS and self._vehicle.params[f"RELAY{index + 1}_FUNCTION"] == 1

    def set_relay(self, index: int, state: int) -> bool:
        """0: off, 1: on, anything else: the other way; False for a relay that is not set up."""
        if not self.has_relay(index):
            return False
        self.relays[index] = bool(state) if state in (0, 1) else not self.relays[index]
        return True

    def gimbal_manager(self, p: tuple[float, float, float, float], flags: int, gimbal: int) -> bool:
        """DO_GIMBAL_MANAGER_PITCHYAW: angles, or rates where they are NaN; degrees and degrees a second."""
        if gimbal not in (0, 1) or not self.gimbal.present:
            return False
        if flags & (_RETRACTED | _NEUTRAL):
            return self.gimbal.rest(RETRACT if flags & _RETRACTED else NEUTRAL)
        locked = bool(flags & _YAW_LOCK)
        if not (math.isnan(p[0]) or math.isnan(p[1])):
            return self.gimbal.aim(0.0, p[0], p[1], locked=locked)
        if not (math.isnan(p[2]) or math.isnan(p[3])):
            return self.gimbal.slew(p[2], p[3], locked=locked)
        if all(math.isnan(each) for each in p):
            self.gimbal.locked = locked
            return True
        return False

    def capture(self, interval: float, count: float) -> bool:
        """IMAGE_START_CAPTURE."""
        single = count == 1 or (interval == 0 and count == 0)
        return self.camera.shoot() if single else self.camera.series(interval, int(count))

    def perform(self, item: Item) -> bool:
        """A mission's command; False for what there is none of here."""
        p1, p2, p3, p4 = item.params
        if item.command == 181:
            return self.set_relay(int(p1), int(p2))
        if item.command == 183:
            return self.set_servo(int(p1), int(p2))
        if item.command == 203:
            return item.x == 1 and self.camera.shoot()
        if item.command == 205:
            return self.gimbal.aim(p2, p1, p3, locked=False) or True
        if item.command == 206:
            self.camera.spacing_m = p1
            return p3 != 1 or self.camera.shoot()
        if item.command == 1000:
            return self.gimbal_manager((p1, p2, p3, p4), item.x, int(item.z))
        if item.command == 2000:
            return self.capture(p2, p3)
        if item.command == 2001:
            self.camera.stop()
            return True
        return False


def _within(pitch: float) -> float:
    return min(max(pitch, PITCH_RANGE[0]), PITCH_RANGE[1])
