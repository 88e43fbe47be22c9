"""How an autopilot wakes up: what becomes ready when, as measured on ArduCopter SITL, and the same run faster."""

from __future__ import annotations

import enum

import msgspec

READY_S = 41.4  # from boot to a position, as measured


class Flag(enum.IntFlag):
    """Of EKF_STATUS_REPORT.flags (EKF_STATUS_FLAGS)."""

    ATTITUDE = 1
    VELOCITY_HORIZ = 2
    VELOCITY_VERT = 4
    POS_HORIZ_REL = 8
    POS_HORIZ_ABS = 16
    POS_VERT_ABS = 32
    CONST_POS_MODE = 128
    PRED_POS_HORIZ_REL = 256
    PRED_POS_HORIZ_ABS = 512
    UNINITIALIZED = 1024
    GPS_GLITCHING = 32768


_ALIGNED = Flag.ATTITUDE | Flag.VELOCITY_HORIZ | Flag.VELOCITY_VERT | Flag.POS_VERT_ABS


class Stage(msgspec.Struct, frozen=True):
    """Something that happens ``at`` seconds after boot (in the real autopilot's time)."""

    at: float
    text: tuple[str, ...] = ()
    severity: int = 6
    event: str = ""


STAGES: tuple[Stage, ...] = (
    Stage(0.0, ("RCInput: decoding UDP (Pulses)",), severity=7),
    Stage(0.1, ("Calibrating barometer",)),
    Stage(1.7, ("Barometer 1 calibration complete", "Barometer 2 calibration complete")),
    Stage(2.2, ("ArduPilot Ready", "AHRS: DCM active"), event="initialised"),
    Stage(4.2, ("EKF3 IMU0 initialised", "EKF3 IMU1 initialised", "AHRS: EKF3 active"), event="ekf_started"),
    Stage(5.6, ("EKF3 IMU0 tilt alignment complete", "EKF3 IMU1 tilt alignment complete"), event="aligned"),
    Stage(5.7, ("EKF3 IMU0 MAG0 initial yaw alignment complete", "EKF3 IMU1 MAG0 initial yaw alignment complete")),
    Stage(9.6, ("GPS 1: probing for u-blox at 230400 baud", "GPS 1: detected u-blox"), event="gps"),
    Stage(19.8, ("EKF3 IMU0 origin set", "EKF3 IMU1 origin set"), event="origin"),
    Stage(23.0, event="prearm"),
    Stage(READY_S, ("EKF3 IMU0 is using GPS", "EKF3 IMU1 is using GPS"), event="position"),
)


class Boot:
    """One run through ``stages``, all times scaled alike, so that a copter's position is there after ``ready_s``
    seconds.
    """

    def __init__(self, ready_s: float, stages: tuple[Stage, ...] = STAGES) -> None:
        self._stages = stages
        self._scale = ready_s / READY_S
        self._next = 0
        self.reached: set[str] = set()

    def advance(self, since_boot: float) -> list[Stage]:
        """The stages reached since the last call, in order."""
        new = []
        while self._next < len(self._stages) and since_boot >= self._stages[self._next].at * self._scale:
            new.append(self._stages[self._next])
            self.reached.add(self._stages[self._next].event)
            self._next += 1
        return new

    def has(self, event: str) -> bool:
        return event in self.reached

    @property
    def ekf_flags(self) -> Flag:
        """EKF_STATUS_REPORT.flags of this stage: 0x400, 0, 0xa7, then 0x33f with a position."""
        if self.has("position"):
            horizontal = Flag.POS_HORIZ_REL | Flag.POS_HORIZ_ABS | Flag.PRED_POS_HORIZ_REL | Flag.PRED_POS_HORIZ_ABS
            return _ALIGNED | horizontal
        if self.has("aligned"):
            return _ALIGNED | Flag.CONST_POS_MODE
        return Flag(0) if self.has("ekf_started") else Flag.UNINITIALIZED
