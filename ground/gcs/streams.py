"""Telemetry by demand: what the clients need, wanted of the vehicles by liveliness tokens, and no longer than they are
there.

A client that asks for more (REQUEST_DATA_STREAM, MAV_CMD_SET_MESSAGE_INTERVAL) gets it; of several the fastest decides.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Mapping, Sequence, Set

import zenoh

from ground.gcs.client import Client
from ground.gcs.kinds import Place
from zmav import keys
from zmav.mavlink import Dialect, Frame, decode
from zmav.vehicle.rates import MAX_HZ, want_key

SET_MESSAGE_INTERVAL = 511
REQUEST_DATA_STREAM = "REQUEST_DATA_STREAM"
MOST = 4096
"""messages of vehicles that may be asked for: each costs every router a little memory"""
COMMANDS = ("COMMAND_LONG", "COMMAND_INT")
LEAST_HZ, MOST_STREAM_HZ = 0.01, 50.0
EVERY = ("*",)
"""vehicles, where nobody chose"""

GCS: Mapping[str, float] = {
    "ATTITUDE": 4.0,
    "GLOBAL_POSITION_INT": 4.0,
    "VFR_HUD": 4.0,
    "NAV_CONTROLLER_OUTPUT": 2.0,
    "GPS_RAW_INT": 2.0,
    "RC_CHANNELS": 2.0,
    "SYS_STATUS": 2.0,
    "BATTERY_STATUS": 1.0,
    "MISSION_CURRENT": 1.0,
    "POSITION_TARGET_GLOBAL_INT": 1.0,
    "SYSTEM_TIME": 1.0,
    "EXTENDED_SYS_STATE": 1.0,
    "VIBRATION": 1.0,
    "SERVO_OUTPUT_RAW": 1.0,
    "HOME_POSITION": 0.2,
}
"""Hz. Only what ArduPilot and PX4 both send: an autopilot that is asked for what it lacks says so, each time"""
STREAMS: Mapping[int, tuple[str, ...]] = {
    0: (
        *GCS,
        "EKF_STATUS_REPORT",
        "RAW_IMU",
        "SCALED_PRESSURE",
        "LOCAL_POSITION_NED",
        "POWER_STATUS",
        "MEMINFO",
        "AHRS",
    ),
    1: ("RAW_IMU", "SCALED_IMU2", "SCALED_IMU3", "SCALED_PRESSURE", "SCALED_PRESSURE2", "SCALED_PRESSURE3"),
    2: (
        "SYS_STATUS",
        "POWER_STATUS",
        "MEMINFO",
        "MISSION_CURRENT",
        "GPS_RAW_INT",
        "GPS2_RAW",
        "NAV_CONTROLLER_OUTPUT",
        "FENCE_STATUS",
        "POSITION_TARGET_GLOBAL_INT",
    ),
    3: ("SERVO_OUTPUT_RAW", "RC_CHANNELS"),
    4: ("ATTITUDE_TARGET", "POSITION_TARGET_LOCAL_NED"),
    6: ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED"),
    10: ("ATTITUDE", "AHRS2"),
    11: ("VFR_HUD",),
    12: (
        "AHRS",
        "SYSTEM_TIME",
        "WIND",
        "RANGEFINDER",
        "DISTANCE_SENSOR",
        "BATTERY_STATUS",
        "EKF_STATUS_REPORT",
        "VIBRATION",
    ),
}
"""messages by MAV_DATA_STREAM, with those that ArduPilot sends in each
(https://ardupilot.org/dev/docs/mavlink-requesting-data.html); older stations ask by these. 0: all"""
Want = tuple[str, str, str]
"""fleet, vehicle (a pattern perhaps) and message"""


class Streams:
    """Thread-safe. ``standard`` are rates in Hz by message, of all vehicles that the patterns name."""

    def __init__(
        self,
        session: zenoh.Session,
        dialect: Dialect,
        fleet: str,
        vehicles: Sequence[str],
        standard: Mapping[str, float],
    ) -> None:
        self._session, self._dialect = session, dialect
        self._fleet, self._vehicles, self._standard = fleet, vehicles, standard
        self._asked: dict[Want, dict[Client, float]] = {}
        self._tokens: dict[Want, tuple[float, zenoh.LivelinessToken]] = {}
        self._base: list[zenoh.LivelinessToken] = []
        self._lock = threading.Lock()

    def close(self) -> None:
        with self._lock:
            self._asked.clear()
            for token in (*self._base, *(token for _, token in self._tokens.values())):
                _undeclare(token)
            self._base.clear()
            self._tokens.clear()

    def refresh(self, there: Set[Client]) -> None:
        """Want the standard messages while anybody is there, and nothing on behalf of who is not."""
        with self._lock:
            if there and not self._base:
                self._base = [
                    self._declare((self._fleet, vehicle, name), hz)
                    for vehicle in self._vehicles
                    for name, hz in self._standard.items()
                    if name in self._dialect.by_name
                ]
            elif not there and self._base:
                for token in self._base:
                    _undeclare(token)
                self._base = []
            left = [(want, client) for want, asked in self._asked.items() for client in asked if client not in there]
            for want, client in left:
                self._set(want, client, 0.0)

    def wish_of(self, frame: Frame) -> Mapping[str, float] | None:
        """The messages that a frame asks for, with their rates in Hz (0: no more); empty: nothing that can be; None: it
        asks for none at a rate.
        """
        name = self._dialect.name_of(frame.msgid)
        if name != REQUEST_DATA_STREAM and name not in COMMANDS:
            return None
        fields = decode(frame, self._dialect)
        if name == REQUEST_DATA_STREAM:
            hz = min(float(fields["req_message_rate"]), MOST_STREAM_HZ) if fields["start_stop"] else 0.0
            return dict.fromkeys(STREAMS.get(fields["req_stream_id"], ()), hz)
        if fields["command"] != SET_MESSAGE_INTERVAL:
            return None
        number, period_us = fields["param1"], fields["param2"]
        hz = 0.0 if period_us <= 0.0 else 1e6 / period_us
        possible = 0.0 <= number <= 0xFFFFFF and (hz == 0.0 or LEAST_HZ <= hz <= MAX_HZ)
        return {self._dialect.name_of(int(number)): hz} if possible else {}

    def ask(self, client: Client, wish: Mapping[str, float], place: Place | None) -> bool:
        """Want what a client wishes, of a vehicle or (None) of all; False: it is too much."""
        seen = client.options.vehicles if client.options.vehicles != EVERY else self._vehicles
        places = [place] if place is not None else [(self._fleet, vehicle) for vehicle in seen]
        with self._lock:
            for fleet, vehicle in places:
                for name, hz in wish.items():
                    want = (fleet, vehicle, name)
                    if hz and want not in self._asked and len(self._asked) >= MOST:
                        return False
                    # What is wanted of all vehicles anyway needs no word of its own.
                    self._set(want, client, hz if hz > self._standard.get(name, 0.0) else 0.0)
        return True

    def _set(self, want: Want, client: Client, hz: float) -> None:
        """What one client wants from now on; 0: nothing."""
        asked = self._asked.setdefault(want, {})
        if hz:
            asked[client] = hz
        else:
            asked.pop(client, None)
        most = max(asked.values(), default=0.0)
        before = self._tokens.get(want)
        if most and (before is None or before[0] != most):
            self._tokens[want] = most, self._declare(want, most)
        elif not most:
            self._tokens.pop(want, None)
        if before is not None and self._tokens.get(want) is not before:
            _undeclare(before[1])
        if not asked:
            del self._asked[want]

    def _declare(self, want: Want, hz: float) -> zenoh.LivelinessToken:
        fleet, vehicle, name = want
        key = keys.expression(f"{vehicle}/mav/rx/*/*/{name}", fleet)
        return self._session.liveliness().declare_token(want_key(key, hz, "gcs"))


def _undeclare(token: zenoh.LivelinessToken) -> None:
    with contextlib.suppress(zenoh.ZError):  # the session is closed, and took it along
        token.undeclare()
