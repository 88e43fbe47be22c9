"""What one kind of ArduPilot vehicle does differently, as data.

Modes and numbers are those of the firmware's ``mode.h`` files, the levels those of its ``GCS_MAVLink_*.cpp``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from zmav.autopilots import convert
from zmav.autopilots.base import Convert, Level, Need

_OWN_GCS = Need(
    ("MAV_GCS_SYSID", "SYSID_MYGCS"),
    lambda value, sysid: sysid,
    True,
    "ArduPilot takes sticks and RC overrides only from its ground station's system id, and we speak with the vehicle's",
)
"""We do not speak with the ground station's id instead: every override would then hide that it is lost"""
OVERRIDES: Mapping[Level, tuple[Need, ...]] = {"manual": (_OWN_GCS,), "rc": (_OWN_GCS,)}
THRUST_AS_THRUST = Need(
    ("GUID_OPTIONS",),
    lambda value, sysid: value | 8,
    False,
    "ArduCopter takes the thrust of an attitude for a climb rate (0.5 keeps the height, 1 climbs at WPNAV_SPEED_UP)",
)
MODES_BY_LEVEL: Mapping[Level, str | None] = {"manual": None, "rc": None, "servo": None}
_EVERYWHERE: Mapping[Level, Convert | str] = {
    "rc": convert.rc_override_16,
    "servo": convert.servos,
    "torque": "ArduPilot takes no torques over MAVLink: send rates and a thrust",
}


@dataclass(frozen=True)
class Rules:
    """What one kind of vehicle does differently; a None is something that it cannot do."""

    modes: str
    hold: str
    land: str | None
    takeoff_mode: str | None
    takeoff_command: bool
    loiter: str
    levels: Mapping[Level, Convert | str]
    needs: Mapping[Level, tuple[Need, ...]] = field(default_factory=lambda: OVERRIDES)
    circles: bool = False
    """it is given points to circle about by command, and takes no stream of them"""
    keepalive_hz: float = 4.0
    unarmable: tuple[str, ...] = ()
    """modes in which it refuses to be armed, or sets off by itself as soon as it is"""


COPTER = Rules(
    modes="STABILIZE:0 ACRO:1 ALT_HOLD:2 AUTO:3 GUIDED:4 LOITER:5 RTL:6 CIRCLE:7 LAND:9 DRIFT:11 SPORT:13 FLIP:14 "
    "AUTOTUNE:15 POSHOLD:16 BRAKE:17 THROW:18 AVOID_ADSB:19 GUIDED_NOGPS:20 SMART_RTL:21 FLOWHOLD:22 FOLLOW:23 "
    "ZIGZAG:24 SYSTEMID:25 AUTOROTATE:26 AUTO_RTL:27 TURTLE:28",
    hold="GUIDED",
    land="LAND",
    takeoff_mode="GUIDED",
    takeoff_command=True,
    unarmable=(
        "AUTO",
        "LAND",
        "RTL",
        "SMART_RTL",
        "BRAKE",
        "CIRCLE",
        "AUTOTUNE",
        "FLIP",
        "AVOID_ADSB",
        "FOLLOW",
        "SYSTEMID",
        "AUTO_RTL",
    ),
    loiter="BRAKE",  # LOITER obeys a throttle stick that nobody holds, and comes down
    levels={
        "position": convert.motion,
        "trajectory": convert.position_and_velocity,
        "velocity": convert.motion,
        "acceleration": convert.motion,
        "attitude": convert.attitude_and_rates,
        "rates": convert.rates,
        "manual": convert.sticks,
        **_EVERYWHERE,
    },
    needs={**OVERRIDES, "attitude": (THRUST_AS_THRUST,), "rates": (THRUST_AS_THRUST,)},
)
ROVER = Rules(
    modes="MANUAL:0 ACRO:1 STEERING:3 HOLD:4 LOITER:5 FOLLOW:6 SIMPLE:7 DOCK:8 CIRCLE:9 AUTO:10 RTL:11 SMART_RTL:12 "
    "GUIDED:15 INITIALISING:16",
    hold="HOLD",
    land=None,
    takeoff_mode=None,
    takeoff_command=False,
    unarmable=("AUTO", "RTL", "SMART_RTL", "CIRCLE", "DOCK", "FOLLOW", "INITIALISING"),
    loiter="LOITER",
    levels={
        "position": convert.position_only,
        "trajectory": convert.position_only,
        "velocity": convert.ground_velocity,
        "acceleration": "ArduRover takes no accelerations: send a velocity",
        "attitude": convert.attitude,
        "rates": convert.rates,
        "manual": convert.sticks_both_ways,
        **_EVERYWHERE,
    },
)
PLANE = Rules(
    modes="MANUAL:0 CIRCLE:1 STABILIZE:2 TRAINING:3 ACRO:4 FBWA:5 FBWB:6 CRUISE:7 AUTOTUNE:8 AUTO:10 RTL:11 LOITER:12 "
    "TAKEOFF:13 AVOID_ADSB:14 GUIDED:15 INITIALISING:16 QSTABILIZE:17 QHOVER:18 QLOITER:19 QLAND:20 QRTL:21 "
    "QAUTOTUNE:22 QACRO:23 THERMAL:24 LOITER_ALT_QLAND:25 AUTOLAND:26",
    hold="LOITER",
    land="AUTOLAND",
    takeoff_mode="TAKEOFF",
    takeoff_command=False,
    unarmable=("AUTO", "TAKEOFF"),
    loiter="LOITER",
    levels={
        "position": convert.circle_at,
        "trajectory": "ArduPlane flies no trajectories: send positions to circle about, or attitudes",
        "velocity": "ArduPlane takes no velocities: send positions to circle about, or attitudes",
        "acceleration": "ArduPlane takes no accelerations: send positions to circle about, or attitudes",
        "attitude": convert.attitude,
        "rates": "ArduPlane takes no body rates in GUIDED (it would fly level instead): send attitudes",
        "manual": convert.sticks,
        **_EVERYWHERE,
    },
    circles=True,
)
RULES: Mapping[str, Rules] = {
    "copter": COPTER,
    "heli": COPTER,
    "rover": ROVER,
    "boat": ROVER,
    "plane": PLANE,
    "vtol": PLANE,
}
