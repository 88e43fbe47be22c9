"""All sensors of a fleet. What changes slowly is stepped for all vehicles together; a vehicle's readings are worked out
when somebody asks for them, and are the same no matter who asks.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from zmav.rotation import to_body
from zmav.sim.arrays import Array
from zmav.sim.dynamics.airframe import GRAVITY
from zmav.sim.dynamics.body import Body
from zmav.sim.geo import Position
from zmav.sim.sensors import atmosphere
from zmav.sim.sensors.magnetic import earth_field
from zmav.sim.sensors.noise import Noise, NoiseRows, Wander
from zmav.sim.sensors.readings import GpsFix, Readings, Vector
from zmav.sim.sensors.troubles import Troubles

SLOW_PERIOD_S = 0.2  # of what wanders and drifts
SATELLITES, SATELLITES_LOST = 10, 3
HDOP, VDOP = 1.21, 2.0
RANGE_MIN_M, RANGE_MAX_M = 0.1, 12.0
RANGE_MOUNT_M = 0.12  # of the rangefinder above the feet
FULL_SCALE = 16.0 * GRAVITY  # of the accelerometers
BOARD_WARMER_C = 17.0  # than the air
_WHITE = 24  # numbers a reading takes


class _Epoch(NamedTuple):
    """What the receivers measured at one time, (3, N) each."""

    time_s: float
    pos: Array
    vel: Array


class SensorSuite:
    """The sensors of ``body``. ``place``: where the world's origin is.

    ``throttle`` (N,) is what makes the accelerometers vibrate; the fleet sets it. :meth:`tick` moves time on: at each
    tick :meth:`readings` gives new noise.
    """

    def __init__(self, body: Body, place: Position, seed: tuple[int, ...], noise: Noise) -> None:
        self._body = body
        self._place = place
        self.noise = noise
        n = body.n
        self.time_s = 0.0
        self.troubles = Troubles(n)
        self.throttle: Array = np.zeros(n)
        self.field = earth_field(place.lat_deg, place.lon_deg)
        self._ticks = 0
        self._slow_in = SLOW_PERIOD_S
        self._gps_in = 0.0
        self._row: tuple[int, Array] = (-1, np.zeros((_WHITE, n)))
        self._white = NoiseRows(seed, "white", n, _WHITE)
        self._gps_white = NoiseRows(seed, "gps", n, 6)
        self._back: Array = np.full(n, -math.inf)  # when a lost receiver had its signals again
        self._epochs: deque[_Epoch] = deque()
        self._gps_count = 0
        level = noise.gps_wander_m
        self.wanders = level > 0.0
        self._gps = Wander(
            NoiseRows(seed, "gps wander", n, 3),
            np.array([level, level, noise.gps_wander_down_m]),
            np.full(3, noise.gps_wander_s),
            SLOW_PERIOD_S,
        )
        # Biases: gyroscopes, accelerometers, height of the barometer.
        self._drift = Wander(
            NoiseRows(seed, "drift", n, 7),
            np.array([noise.gyro_drift] * 3 + [noise.accel_drift] * 3 + [noise.baro_drift_m]),
            np.array([noise.imu_drift_s] * 6 + [noise.baro_drift_s]),
            SLOW_PERIOD_S,
        )
        fixed = NoiseRows(seed, "turn-on", n, 12).row(0)
        self._turn_on = fixed[:6] * np.array([[noise.gyro_turn_on]] * 3 + [[noise.accel_turn_on]] * 3)
        self._hard_iron = fixed[6:9] * noise.mag_hard_iron
        self._soft_iron = 1.0 + fixed[9:12] * noise.mag_soft_iron
        self._noisy = noise.name != "none"
        self.troubles.told.append(self._trouble)
        self._lost = [False] * n
        self.clipped: Array = np.zeros(n)  # how often the accelerometers reached their limit
        self._clips = False

    # ---- time

    def tick(self, dt: float) -> bool:
        """Move on by ``dt`` seconds; True where the slow errors have other values."""
        self._ticks += 1
        self.time_s += dt
        slow = False
        if self._clips:
            self.clipped += self.troubles.clipping * dt
        if self.wanders or self._noisy:
            self._slow_in -= dt
            if self._slow_in <= 1e-9:
                self._slow_in += SLOW_PERIOD_S
                self._gps.step()
                self._drift.step()
                slow = True
        if self.noise.gps_period_s > 0.0:
            self._gps_in -= dt
            if self._gps_in <= 1e-9:
                self._gps_in += self.noise.gps_period_s
                self._measure()
        return slow

    def _measure(self) -> None:
        """The receivers take a solution; it comes out ``gps_delay_s`` later."""
        noise = self.noise
        row = self._gps_white.row(self._gps_count)
        self._gps_count += 1
        pos = self._body.pos + self.gps_error + row[:3] * noise.gps_white_m
        vel = self._body.vel + row[3:] * noise.gps_speed_mps
        self._epochs.append(_Epoch(self.time_s, pos, vel))
        while len(self._epochs) > 1 and self._epochs[1].time_s <= self.time_s - noise.gps_delay_s + 1e-6:
            self._epochs.popleft()

    def _latest(self) -> _Epoch:
        """The last solution that has come out by now."""
        for epoch in reversed(self._epochs):
            if epoch.time_s <= self.time_s - self.noise.gps_delay_s + 1e-6:
                return epoch
        return self._epochs[0]

    def _trouble(self, index: int) -> None:
        lost = bool(self.troubles.gps_lost[index])
        if self._lost[index] and not lost:
            self._back[index] = self.time_s + self.noise.gps_acquire_s
        self._lost[index] = lost
        self._clips = bool(self.troubles.clipping.any())

    # ---- what is slow

    @property
    def gps_error(self) -> Array:
        """(3, N) m NED: what a receiver is off by, but for white noise and troubles."""
        return self._gps.value

    @property
    def baro_drift(self) -> Array:
        """(N,) m: how much too high the barometers read, but for white noise and troubles."""
        drift: Array = self._drift.value[6]
        return drift

    def has_fix(self, index: int) -> bool:
        return not self.troubles.gps_lost[index] and self.time_s >= self._back[index] - 1e-9

    # ---- readings

    def readings(self, index: int) -> Readings:
        """One vehicle's sensors now."""
        body, noise, troubles = self._body, self.noise, self.troubles
        white = self._whites(index)
        slow = self._drift.value[:, index].tolist()
        fixed = self._turn_on[:, index].tolist()
        q = body.q[:, index].tolist()
        height = self._place.alt_amsl_m - float(body.pos[2, index])
        rate = body.rate[:, index].tolist()
        gyro = [rate[i] + fixed[i] + slow[i] + noise.gyro_white * white[i] for i in range(3)]
        accel = self._acceleration(index, q, [fixed[3 + i] + slow[3 + i] for i in range(3)], white[3:9])
        shift = float(troubles.baro_shift[index]) + slow[6] + noise.baro_white_m * white[12]
        hpa = atmosphere.pressure_hpa(height + shift)
        flow = to_body(q, (body.vel[:, index] - body.wind[:, index]).tolist())[0]
        flow = 0.0 if troubles.pitot_lost[index] else flow
        dynamic = atmosphere.dynamic_pressure_hpa(flow, atmosphere.density(height)) + noise.pitot_white_hpa * white[13]
        return Readings(
            gyro=(gyro[0], gyro[1], gyro[2]),
            accel=accel,
            mag=self._magnetic(index, q, white[9:12]),
            pressure_hpa=hpa,
            pressure_alt_m=atmosphere.altitude_m(hpa),
            diff_pressure_hpa=dynamic,
            airspeed_mps=atmosphere.indicated_airspeed(dynamic),
            temperature_c=atmosphere.temperature_c(height) + BOARD_WARMER_C,
            range_m=self.distance(index, RANGE_MIN_M, RANGE_MAX_M, RANGE_MOUNT_M),
            gps=self.fix(index),
        )

    def _whites(self, index: int) -> list[float]:
        """This tick's numbers for one vehicle; drawn for all when the first one asks."""
        if not self._noisy and not self.troubles.any[index]:
            return [0.0] * _WHITE
        if self._row[0] != self._ticks:
            self._row = (self._ticks, self._white.row(self._ticks))
        numbers: list[float] = self._row[1][:, index].tolist()
        return numbers

    def _acceleration(self, index: int, q: list[float], bias: list[float], white: list[float]) -> Vector:
        """Specific force; as much as the accelerometers can show."""
        north, east, down = self._body.accel[:, index].tolist()
        shake = self.vibration(index)
        force = to_body(q, (north, east, down - GRAVITY))
        parts = [force[i] + bias[i] + self.noise.accel_white * white[i] + shake * white[3 + i] for i in range(3)]
        x, y, z = (min(max(part, -FULL_SCALE), FULL_SCALE) for part in parts)
        return x, y, z

    def vibration(self, index: int) -> float:
        """Root mean square of what shakes the accelerometers of one vehicle, m/s^2."""
        return self.noise.vibration * float(self.throttle[index]) + float(self.troubles.vibration[index])

    def _magnetic(self, index: int, q: list[float], white: list[float]) -> Vector:
        if self.troubles.compass_lost[index]:
            return 0.0, 0.0, 0.0
        angle = float(self.troubles.compass_turn[index])
        north, east, down = self.field
        if angle:
            # The field as it would be seen with the nose turned on: turned the other way about the vertical.
            c, s = math.cos(angle), math.sin(angle)
            north, east = north * c + east * s, east * c - north * s
        field = to_body(q, (north, east, down))
        hard, soft = self._hard_iron[:, index].tolist(), self._soft_iron[:, index].tolist()
        x, y, z = (field[i] * soft[i] + hard[i] + self.noise.mag_white * white[i] for i in range(3))
        return x, y, z

    def distance(self, index: int, nearest: float, farthest: float, mount: float) -> float:
        """What a downward rangefinder ``mount`` m above the feet measures along the body's down axis, m; NaN for what
        is not within its limits.
        """
        _, across, along, _ = self._body.q[:, index].tolist()
        toward = 1.0 - 2.0 * (across * across + along * along)  # how upright it is
        if toward < 1e-3 or self.troubles.range_lost[index]:
            return math.nan
        true = max(-float(self._body.pos[2, index]), 0.0) / toward + mount
        spread = self.noise.range_white_m + self.noise.range_share * true
        read = true + float(self.troubles.range_shift[index]) + spread * self._whites(index)[14]
        return read if nearest <= read <= farthest else math.nan

    def fix(self, index: int) -> GpsFix:
        """The latest solution of one receiver; without one, the fix type says so and the place is the last known."""
        troubles, noise = self.troubles, self.noise
        if self._epochs:
            time_s, where, speed = self._latest()
            pos, vel = where[:, index].tolist(), speed[:, index].tolist()
        else:
            time_s = self.time_s
            pos, vel = (self._body.pos[:, index] + self.gps_error[:, index]).tolist(), self._body.vel[:, index].tolist()
        shift = troubles.gps_shift[:, index].tolist()
        good = self.has_fix(index)
        eph = max(noise.gps_wander_m, 0.3)
        return GpsFix(
            time_s=time_s,
            fix_type=3 if good else 1,
            satellites=SATELLITES if good else SATELLITES_LOST,
            north=pos[0] + shift[0],
            east=pos[1] + shift[1],
            down=pos[2] + shift[2],
            vn=vel[0],
            ve=vel[1],
            vd=vel[2],
            hdop=HDOP,
            vdop=VDOP,
            eph_m=eph,
            epv_m=max(noise.gps_wander_down_m, 0.3),
        )
