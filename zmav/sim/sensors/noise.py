"""How good the sensors are, by name, and random numbers that do not depend on who asks for them.

The errors are those of IEEE Std 952-1997, annex C, as small autopilots have them: white noise (a density times the
root of the bandwidth), a turn-on bias, and bias instability taken as a first-order Gauss-Markov process.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np

from zmav.errors import BadConfig
from zmav.sim.arrays import Array

_DEG = math.pi / 180.0
_G = 9.80665


class Noise(msgspec.Struct, frozen=True, kw_only=True):
    """Standard deviations and times of every sensor's errors; a zero leaves an error out.

    ``gps_period_s`` 0: a solution whenever somebody asks. A ``_wander`` goes about with a correlation time of
    ``gps_wander_s``.
    """

    name: str
    gps_period_s: float = 0.0
    gps_delay_s: float = 0.0
    gps_wander_m: float = 0.0  # horizontal, per axis
    gps_wander_down_m: float = 0.0
    gps_wander_s: float = 60.0
    gps_white_m: float = 0.0
    gps_speed_mps: float = 0.0
    gps_acquire_s: float = 0.0  # until there is a solution again after a loss
    gyro_white: float = 0.0  # rad/s, of one reading
    gyro_turn_on: float = 0.0  # rad/s
    gyro_drift: float = 0.0  # bias instability, rad/s
    accel_white: float = 0.0  # m/s^2, of one reading
    accel_turn_on: float = 0.0
    accel_drift: float = 0.0
    imu_drift_s: float = 100.0
    vibration: float = 0.0  # m/s^2, with the motors at full throttle
    baro_white_m: float = 0.0
    baro_drift_m: float = 0.0
    baro_drift_s: float = 300.0
    mag_white: float = 0.0  # gauss
    mag_hard_iron: float = 0.0  # gauss, what calibration left over
    mag_soft_iron: float = 0.0  # as a share of the field
    range_white_m: float = 0.0
    range_share: float = 0.0  # of the distance
    pitot_white_hpa: float = 0.0
    believed_speed_mps: float = 0.0  # of the estimator's velocity
    believed_tilt: float = 0.0  # rad, of its roll and pitch
    believed_yaw: float = 0.0  # rad


NONE = Noise(name="none")
TYPICAL = Noise(
    name="typical",
    # A single-frequency receiver (u-blox NEO-M8 data sheet: 2.5 m CEP, 0.05 m/s, 1 s to reacquire), most of whose
    # position error is ionosphere and multipath that change over a minute.
    gps_period_s=0.2,
    gps_delay_s=0.2,
    gps_wander_m=1.2,
    gps_wander_down_m=2.0,
    gps_white_m=0.15,
    gps_speed_mps=0.05,
    gps_acquire_s=1.0,
    # A consumer MEMS unit (InvenSense MPU-6000 data sheet: 0.005 deg/s and 400 ug per root hertz) behind an 80 Hz
    # filter. Biases are what is left over after calibration.
    gyro_white=0.005 * _DEG * math.sqrt(80.0),
    gyro_turn_on=0.05 * _DEG,
    gyro_drift=0.01 * _DEG,
    accel_white=400e-6 * _G * math.sqrt(80.0),
    accel_turn_on=0.03,
    accel_drift=0.005,
    vibration=3.0,
    # TE MS5611 data sheet: 0.012 hPa at the finest setting; weather and warming drift by some decimetres in minutes.
    baro_white_m=0.1,
    baro_drift_m=0.3,
    # Honeywell HMC5883L data sheet: 2 mgauss.
    mag_white=0.002,
    mag_hard_iron=0.008,
    mag_soft_iron=0.01,
    # Benewake TFmini Plus data sheet: 5 cm to 6 m, 1 % beyond.
    range_white_m=0.02,
    range_share=0.003,
    # Sensirion SDP3x class: 0.1 Pa, with the tube's turbulence some pascals.
    pitot_white_hpa=0.02,
    believed_speed_mps=0.05,
    believed_tilt=0.2 * _DEG,
    believed_yaw=1.0 * _DEG,
)
RTK = msgspec.structs.replace(
    TYPICAL,
    name="rtk",
    # A two-frequency receiver with corrections (u-blox ZED-F9P data sheet: 0.01 m + 1 ppm CEP, 0.05 m/s), ambiguities
    # fixed: what wanders is the multipath of the carrier.
    gps_wander_m=0.015,
    gps_wander_down_m=0.03,
    gps_white_m=0.01,
    believed_speed_mps=0.03,
)
PROFILES = {profile.name: profile for profile in (NONE, TYPICAL, RTK)}


def noise_profile(name: str) -> Noise:
    """The profile of that name; :class:`BadConfig` names those there are."""
    if name not in PROFILES:
        expected = " or ".join(PROFILES)
        raise BadConfig.wrong("noise", name, expected, f"no noise {name!r}")
    return PROFILES[name]


class NoiseRows:
    """Standard normal numbers by count: row ``k`` is always the same, whatever was drawn before.

    Drawn from Philox, a counter-based generator (Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC11),
    vehicle by vehicle, so that a further one changes nothing for those before it.
    """

    def __init__(self, seed: tuple[int, ...], purpose: str, vehicles: int, width: int) -> None:
        entropy = np.random.SeedSequence([*seed, *purpose.encode("ascii")])
        self._key = entropy.generate_state(2, np.uint64)
        self._shape = (vehicles, width)

    def row(self, count: int) -> Array:
        """(width, N) numbers."""
        bits = np.random.Philox(key=self._key, counter=[0, 0, count, 0])
        return np.random.Generator(bits).standard_normal(self._shape).T


class Wander:
    """A first-order Gauss-Markov process per row and vehicle, stepped at a fixed period.

    Source: Brown and Hwang, "Introduction to Random Signals and Applied Kalman Filtering", section 3.6.
    """

    def __init__(self, rows: NoiseRows, sigma: Array, correlation_s: Array, period_s: float) -> None:
        self._rows = rows
        self._keep = np.exp(-period_s / correlation_s)[:, None]
        self._kick = (sigma * np.sqrt(1.0 - np.exp(-2.0 * period_s / correlation_s)))[:, None]
        self._count = 0
        self.value: Array = rows.row(0) * sigma[:, None]

    def step(self) -> None:
        self._count += 1
        self.value = self.value * self._keep + self._rows.row(self._count) * self._kick
