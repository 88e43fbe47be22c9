"""What a vehicle's sensors give at one moment, as plain numbers."""

from __future__ import annotations

from typing import NamedTuple

Vector = tuple[float, float, float]


class GpsFix(NamedTuple):
    """The receiver's latest solution, as late as it comes: ``time_s`` is when it was true."""

    time_s: float
    """simulated seconds"""
    fix_type: int
    """GPS_FIX_TYPE: 1 none, 3 three-dimensional"""
    satellites: int
    north: float
    """m NED of the world, with the receiver's error"""
    east: float
    down: float
    vn: float
    """m/s NED"""
    ve: float
    vd: float
    hdop: float
    vdop: float
    eph_m: float
    """accuracy that the receiver claims, horizontal and vertical, m"""
    epv_m: float


class Readings(NamedTuple):
    """One vehicle's sensors now; body axes forward-right-down."""

    gyro: Vector
    """rad/s"""
    accel: Vector
    """specific force, m/s^2: (0, 0, -9.81) at rest"""
    mag: Vector
    """gauss"""
    pressure_hpa: float
    """absolute"""
    pressure_alt_m: float
    """AMSL height of the standard atmosphere at that pressure"""
    diff_pressure_hpa: float
    """of the pitot tube"""
    airspeed_mps: float
    """that the pitot tube makes of it; 0 without one"""
    temperature_c: float
    range_m: float
    """of the downward rangefinder, along the body's down axis; NaN where nothing is in its range"""
    gps: GpsFix
