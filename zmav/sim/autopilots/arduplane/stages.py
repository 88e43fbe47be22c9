"""How an ArduPlane wakes up, as measured on its SITL: seconds after boot."""

from __future__ import annotations

from zmav.sim.autopilots.ardupilot.boot import Stage

_BOTH = ("0", "1")


def _each(text: str, *filters: str) -> tuple[str, ...]:
    return tuple(f"{name} IMU{imu} {text.format(imu=imu)}" for name in filters for imu in _BOTH)


PLANE_STAGES: tuple[Stage, ...] = (
    Stage(0.0, ("Ground start",)),
    Stage(0.0, ("Skipping INS calibration",), severity=1),
    Stage(0.0, ("Calibrating barometer",)),
    Stage(0.1, ("RCInput: decoding UDP (Pulses)",), severity=7),
    Stage(1.6, ("Barometer 1 calibration complete", "Barometer 2 calibration complete")),
    Stage(1.6, ("Airspeed 1 calibration started",)),
    Stage(1.6, ("ArduPilot Ready", "AHRS: DCM active"), event="initialised"),
    Stage(1.62, ("Throttle failsafe off",), severity=4),
    Stage(3.28, ("Airspeed 1 calibrated",), event="airspeed"),
    Stage(8.93, ("GPS 1: probing for u-blox at 230400 baud", "GPS 1: detected u-blox")),
    Stage(9.38, _each("MAG0 initial yaw alignment complete", "EKF2"), event="gps"),
    Stage(10.14, _each("initialised", "EKF3"), event="ekf_started"),
    Stage(12.02, _each("tilt alignment complete", "EKF3"), event="aligned"),
    Stage(12.1, _each("MAG0 initial yaw alignment complete", "EKF3")),
    Stage(14.62, _each("tilt alignment complete", "EKF2")),
    Stage(19.34, (*_each("origin set", "EKF2"), *_each("origin set", "EKF3")), event="origin"),
    Stage(20.36, (*_each("is using GPS", "EKF3"), "AHRS: EKF3 active"), event="position"),
    Stage(22.9, event="prearm"),
)
