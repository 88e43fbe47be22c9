"""What may differ between a recording and its counterpart, and why; anything else is a fault of the simulator."""

from __future__ import annotations

from fnmatch import fnmatchcase

from tests.sim.yardstick.compare import Difference

_ESC = "the real simulation's speed controllers report one picture for ever; these follow their motors"
_WARM = "the real board warms up; this one is warm"
_LEARNT = "what the real one learns and saves by itself"
_DCM = "before its EKF the real rover takes the place where it stands for the height of the sea, and home for that"
_ROVER = "the real simulation's rover rolls without resistance, and draws its current accordingly"
_GUST = "the real simulation's plane stands in an air that stirs a little"
_CLIMB = "the real plane, lighter on its wings, has climbed and turned further when GUIDED comes"
_UNREAD = "nobody on the link reads it"
_TERRAIN = "the estimate of the ground below wanders"

# (recording, kind and what, phase) -> reason; all three are patterns.
EXPLAINED: tuple[tuple[str, str, str, str], ...] = (
    ("*", "message TERRAIN_REQUEST", "*", "the simulated ground is a plane, and nobody is asked for it"),
    ("*", "message TERRAIN_REPORT", "*", _UNREAD),
    ("*", "message SIMSTATE", "*", _UNREAD),
    ("plane", "message AOA_SSA", "*", _UNREAD),
    ("px4*", "message OPEN_DRONE_ID_*", "*", _UNREAD),
    ("px4*", "message TIME_ESTIMATE_TO_TARGET", "*", _UNREAD),
    ("*", "message PARAM_VALUE", "*", _LEARNT),
    ("*", "value PARAM_VALUE.*", "*", _LEARNT),
    ("*", "constant ESC_TELEMETRY_1_TO_4.*", "*", _ESC),
    ("*", "rate ESC_TELEMETRY_1_TO_4", "boot", "real speed controllers are heard 6 s after boot"),
    ("*", "constant *.temperature", "*", _WARM),
    ("*", "value *.yaw", "boot", "a compass that settles"),
    ("*", "value NAV_CONTROLLER_OUTPUT.nav_bearing", "boot", "a compass that settles"),
    ("*", "rate LOCAL_POSITION_NED", "standing", "how long it stood with a position before it was armed"),
    ("*", "value GPS_RAW_INT.cog", "*", "without motion it is noise"),
    ("copter", "words EKF# IMU# MAG# in-flight yaw alignment complete", "*", "the compass has no errors to learn"),
    ("*", "words RC#: SaveWaypoint *", "*", "what an auxiliary switch does is not simulated"),
    ("rover", "words INS: alloc *", "*", "there is no memory to speak of"),
    ("rover", "* *.alt*", "*", _DCM),
    ("rover", "constant GLOBAL_POSITION_INT.relative_alt", "*", _DCM),
    ("rover", "constant LOCAL_POSITION_NED.z", "*", _DCM),
    ("rover", "constant VFR_HUD.climb", "*", "the real one's barometer is all that knows its height"),
    ("rover", "constant NAV_CONTROLLER_OUTPUT.xtrack_error", "*", "it starts each leg from where it stands"),
    ("rover", "value *.current_*", "*", _ROVER),
    ("rover", "value RC_CHANNELS_SCALED.*", "*", _ROVER),
    ("rover", "value VFR_HUD.throttle", "*", _ROVER),
    ("plane", "words EKF# IMU# is using GPS", "*", "a second, older estimator that only the real one runs beside"),
    ("plane", "constant *.voltage*", "*", "the real simulation's voltage sags; this battery is an ideal source"),
    ("plane", "* WIND*", "*", _GUST),
    ("plane", "value *airspeed", "*", _GUST),
    ("plane", "value VFR_HUD.groundspeed", "boot", _GUST),
    ("plane", "* SERVO_OUTPUT_RAW*", "boot", "the real outputs are tried one after the other, quickly, as it boots"),
    ("plane", "value *", "climbing", _CLIMB),
    ("px4", "message COMMAND_LONG", "*", "PX4 steers a gimbal that is not there when it begins to land"),
    ("px4*", "constant ALTITUDE.altitude_terrain", "*", _TERRAIN),
    ("px4*", "constant ALTITUDE.bottom_clearance", "*", _TERRAIN),
    ("px4*", "constant ESTIMATOR_STATUS.hagl_ratio", "*", _TERRAIN),
    ("px4", "constant SYS_STATUS.load", "*", "there is no computer to load"),
    ("px4", "constant VFR_HUD.heading", "*", "the real nose wanders about north"),
    ("px4", "value ODOMETRY.reset_counter", "*", "this estimate is not reset"),
    ("px4_ground", "rate VFR_HUD", "landing", "the recording ends on the way down"),
    ("px4_ground", "words [[]logger] *", "*", "the real one names its logs by the date"),
    ("px4_ground", "constant HOME_POSITION.?", "*", "the real one had flown before, and was armed elsewhere"),
    ("px4_ground", "constant LINK_NODE_STATUS.messages_lost", "*", "three autopilots on one port are taken for losses"),
    ("px4_ground", "value LOCAL_POSITION_NED.?", "landing", "the real one had flown before, and was armed elsewhere"),
)


def reason_for(recording: str, row: Difference) -> str | None:
    """Why it may be so; None: nobody knows."""
    what = f"{row.kind} {row.what}"
    for names, rows, phases, reason in EXPLAINED:
        if fnmatchcase(recording, names) and fnmatchcase(what, rows) and fnmatchcase(row.phase, phases):
            return reason
    return None
