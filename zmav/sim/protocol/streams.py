"""Message intervals and the older data streams, per channel.

SET_MESSAGE_INTERVAL: https://mavlink.io/en/messages/common.html#MAV_CMD_SET_MESSAGE_INTERVAL
REQUEST_DATA_STREAM, with ArduPilot's groups: https://ardupilot.org/dev/docs/mavlink-requesting-data.html
"""

from __future__ import annotations

import math

HEARTBEAT_PERIOD_S = 1.0
RAW_CONTROLLER = 4  # MAV_DATA_STREAM: who asks for all does not get it

# MAV_DATA_STREAM -> what ArduPilot sends in it, of what is simulated.
GROUPS: dict[int, tuple[str, ...]] = {
    1: ("RAW_IMU", "SCALED_IMU2", "SCALED_IMU3", "SCALED_PRESSURE", "SCALED_PRESSURE2", "AIRSPEED"),
    2: (
        "SYS_STATUS",
        "POWER_STATUS",
        "MEMINFO",
        "NAV_CONTROLLER_OUTPUT",
        "MISSION_CURRENT",
        "GPS_RAW_INT",
        "POSITION_TARGET_GLOBAL_INT",
        "FENCE_STATUS",
    ),
    3: ("SERVO_OUTPUT_RAW", "RC_CHANNELS"),
    4: ("RC_CHANNELS_SCALED",),
    6: ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED"),
    10: ("ATTITUDE", "AHRS2", "ESC_TELEMETRY_1_TO_4"),
    11: ("VFR_HUD",),
    12: (
        "AHRS",
        "SYSTEM_TIME",
        "WIND",
        "BATTERY_STATUS",
        "EKF_STATUS_REPORT",
        "VIBRATION",
    ),
}
# How the parameter that holds a group's default rate ends, Hz; before it stands the port's RATE_PREFIX.
RATE_PARAMS = {
    "RAW_SENS": 1,
    "EXT_STAT": 2,
    "RC_CHAN": 3,
    "RAW_CTRL": 4,
    "POSITION": 6,
    "EXTRA1": 10,
    "EXTRA2": 11,
    "EXTRA3": 12,
}
RATE_PREFIX = {"serial1": "MAV2_", "serial2": "MAV3_"}  # any other link is the first port's: MAV1_


class Streams:
    """What one channel is sent, and when it is next due (seconds on the simulation's clock)."""

    def __init__(self, now: float) -> None:
        self.least = 0.0
        """s that lie between two of a message at least, whatever was asked for"""
        self._period: dict[str, float] = {}
        self._due: dict[str, float] = {}
        self.next_due = now
        self.fastest = math.inf
        """the shortest period, s"""
        self.set_period("HEARTBEAT", HEARTBEAT_PERIOD_S, now)

    def set_period(self, name: str, period: float, now: float) -> None:
        """Send ``name`` every ``period`` seconds; 0 or less: not at all."""
        if period <= 0.0:
            self._period.pop(name, None)
            self._due.pop(name, None)
            self.fastest = min(self._period.values(), default=math.inf)
            return
        self._period[name] = period
        self._due[name] = now
        self.next_due = min(self.next_due, now)
        self.fastest = min(self._period.values())

    def set_group(self, group: int, rate_hz: float, now: float) -> None:
        """ArduPilot's REQUEST_DATA_STREAM: a whole group (0: every one) at a rate; 0 stops it."""
        for number, names in GROUPS.items():
            if group == number or (group == 0 and number != RAW_CONTROLLER):
                for name in names:
                    self.set_period(name, 1.0 / rate_hz if rate_hz > 0.0 else 0.0, now)

    def period(self, name: str) -> float | None:
        return self._period.get(name)

    def due(self, now: float) -> list[str]:
        """Names to send now. Their next times keep the rate on average, whatever the step of the clock."""
        ready = []
        for name, when in self._due.items():
            if now >= when - 1e-9:
                ready.append(name)
                period = max(self._period[name], self.least)
                following = when + period
                # After a pause there is nothing to catch up with.
                self._due[name] = following if following > now - period else now + period
        self.next_due = min(self._due.values(), default=math.inf) - 1e-9
        return ready
