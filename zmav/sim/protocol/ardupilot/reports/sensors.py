"""What sensors measure and outputs are given."""

from __future__ import annotations

import math

from zmav.sim.dynamics.airframe import GRAVITY
from zmav.sim.protocol import reports
from zmav.sim.protocol.ardupilot.node import ArduNode
from zmav.sim.protocol.base import Fields
from zmav.sim.protocol.reports import axes, boot_ms, boot_us, e7, int16
from zmav.sim.sensors.readings import Readings
from zmav.sim.sensors.suite import RANGE_MAX_M, RANGE_MIN_M

MOST_RPM = 10_000.0
_RTK = 6  # GPS_FIX_TYPE: what SITL's receiver claims
_DOWNWARD = 25  # MAV_SENSOR_ROTATION_PITCH_270
RECEIVED = 8  # channels of the receiver


def gps_raw_int(node: ArduNode) -> Fields:
    fix = node.seat.fix() if node.vehicle.boot.has("gps") else None
    if fix is None:
        return {"eph": 65535, "epv": 65535}
    return {
        **reports.gps_raw_int(node, fix),
        "fix_type": _RTK if fix.fix_type >= 3 else fix.fix_type,
        "eph": round(fix.hdop * 100),
        "epv": round(fix.vdop * 100),
        "h_acc": round(fix.eph_m * 1000),
        "v_acc": round(fix.epv_m * 1000),
    }


def imu(node: ArduNode) -> Fields:
    seen = node.seat.readings()
    to_mg = 1000.0 / GRAVITY
    return {
        **axes("{}acc", (int16(part * to_mg) for part in seen.accel)),
        **axes("{}gyro", (int16(part * 1000.0) for part in seen.gyro)),
        "temperature": 3200,
        **compass(seen),
    }


def compass(seen: Readings) -> Fields:
    """Milligauss."""
    return axes("{}mag", (int16(1000.0 * part) for part in seen.mag))


def scaled_pressure(node: ArduNode) -> Fields:
    seen = node.seat.readings()
    return {
        "time_boot_ms": boot_ms(node),
        "press_abs": seen.pressure_hpa,
        "press_diff": _pitot(node, seen),
        "temperature": 3100,
    }


def _pitot(node: ArduNode, seen: Readings) -> float:
    """Of the tube, where there is one."""
    params = node.vehicle.params
    return seen.diff_pressure_hpa if "ARSPD_TYPE" in params and params["ARSPD_TYPE"] > 0 else 0.0


def rangefinder(node: ArduNode) -> Fields | None:
    """The downward one, where RNGFND1_TYPE names any; 0 m without an echo."""
    if node.vehicle.params["RNGFND1_TYPE"] <= 0:
        return None
    metres = node.seat.readings().range_m
    return {"distance": 0.0 if math.isnan(metres) else metres, "voltage": 0.0}


def distance_sensor(node: ArduNode) -> Fields | None:
    if node.vehicle.params["RNGFND1_TYPE"] <= 0:
        return None
    metres = node.seat.readings().range_m
    return {
        "time_boot_ms": boot_ms(node),
        "min_distance": round(RANGE_MIN_M * 100),
        "max_distance": round(RANGE_MAX_M * 100),
        "current_distance": 0 if math.isnan(metres) else round(metres * 100),
        "orientation": _DOWNWARD,
    }


def terrain_report(node: ArduNode) -> Fields | None:
    """The flat ground, as one who has no terrain data says it."""
    vehicle = node.vehicle
    if not vehicle.boot.has("gps"):
        return {"spacing": 100, "pending": 56}
    here = vehicle.position
    return {"lat": e7(here.lat_deg), "lon": e7(here.lon_deg), "current_height": here.alt_amsl_m, "pending": 504}


def esc_telemetry(node: ArduNode) -> Fields:
    turning = [round(MOST_RPM * speed) for speed in node.seat.rotor_speeds()[:4]]
    volts = round(node.vehicle.voltage * 100)
    amps = min(round(node.vehicle.sense.current_a * 100 / node.vehicle.MOTORS), 65535)
    return {
        "temperature": [32] * 4,
        "voltage": [volts] * 4,
        "current": [amps] * 4,
        "totalcurrent": [round(node.vehicle.consumed_mah / 4)] * 4,
        "rpm": turning,
        "count": [int(node.vehicle.uptime * 400) % 65536] * 4,
    }


def vibration(node: ArduNode) -> Fields:
    level = (0.02 if not node.vehicle.landed else 0.003) + node.seat.vibration
    axes = {f"vibration_{axis}": level for axis in "xyz"}
    clipped = int(node.seat.clipped)
    return {"time_usec": boot_us(node), **axes, "clipping_0": clipped, "clipping_1": clipped}


def rc_channels(node: ArduNode) -> Fields:
    pwm = node.vehicle.rc.pwm
    fields: Fields = {f"chan{i}_raw": value % 65536 for i, value in enumerate(pwm, start=1)}
    return {"time_boot_ms": boot_ms(node), "chancount": RECEIVED, "rssi": 255, **fields}


def servo_output_raw(node: ArduNode) -> Fields:
    """The motors on the first outputs, what DO_SET_SERVO set on the others; 0 where there is no signal."""
    outputs = [round(1000 + 1000 * u) for u in node.seat.outputs()]
    outputs += node.vehicle.servos[len(outputs) :]
    return {"time_usec": boot_us(node), **{f"servo{i}_raw": pwm for i, pwm in enumerate(outputs, start=1)}}


def centred_pulse(node: ArduNode, channel: int, value: float) -> int:
    """Of an output that goes from -1 to 1 about its trim, us."""
    params = node.vehicle.params
    low, middle, high = (params[f"SERVO{channel}_{part}"] for part in ("MIN", "TRIM", "MAX"))
    if params[f"SERVO{channel}_REVERSED"]:
        value = -value
    return round(middle + value * (high - middle if value > 0 else middle - low))


def wind(node: ArduNode) -> Fields | None:
    vehicle = node.vehicle
    if not vehicle.position_ok:
        return None
    north, east, down = node.seat.wind
    # Where it comes from.
    return {
        "direction": math.degrees(math.atan2(-east, -north)),
        "speed": math.hypot(north, east),
        "speed_z": down,
    }
