"""An autopilot that is only a link: says what an armed PX4 that hovers would say, 250 times a second, moves the pilot's
sticks, and notes to the microsecond when what comes back.

The vehicle's agent hears it as any PX4 1.13 hexarotor. What the pilot does goes out as RC_CHANNELS, and at once after
that the attitude that begins a controller's cycle, or at a random moment between two of them.
"""

from __future__ import annotations

import contextlib
import random
import socket
import threading
import time
from collections import deque
from types import TracebackType
from typing import Any, NamedTuple

from tests.bench.controllers.processes import SWITCH
from zmav.mavlink import Packer, Splitter, decode, load_dialect

CYCLE = 0.004
RC_EVERY, BEAT_EVERY, PLACE_EVERY = 5, 125, 50
"""cycles between two RC_CHANNELS (50 Hz), HEARTBEATs and GLOBAL_POSITION_INTs"""
MID, STEPS = 1500, 200
"""µs of a stick in the middle, and how far it moves to either side, one from frame to frame: over 8 s no two
frames are alike"""
LOW, HIGH = 1000, 2000
ARMED, CUSTOM = 0x80, 0x01
HOLD, OFFBOARD = 4 << 16 | 3 << 24, 6 << 16
TAKES_TORQUE = 0x400
KEPT = 100_000
HOME = {"lat": -353632610, "lon": 1491652300, "alt": 594090, "relative_alt": 10000}
FLOWN = ("SET_ATTITUDE_TARGET", "SET_ACTUATOR_CONTROL_TARGET", "SET_POSITION_TARGET_LOCAL_NED")


class Stick(NamedTuple):
    """The roll stick as something shows it."""

    at: float
    """monotonic s"""
    pwm: int
    """µs"""


class FakeAutopilot:
    """On a free UDP port of its own, speaking to ``port`` where the vehicle's agent listens. Use it with ``with``.

    ``full_rate``: rad/s of a full roll stick, by which a rate is turned back into the stick.
    """

    def __init__(self, port: int, full_rate: float, seed: int = 0) -> None:
        self._dialect = load_dialect()
        self._to, self._full = ("127.0.0.1", port), full_rate
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._packer = Packer(self._dialect, 1, 1)
        self._ids = {self._dialect.message(name).id: name for name in (*FLOWN, "COMMAND_LONG", "TIMESYNC")}
        self._chance = random.Random(seed)
        self._closing = threading.Event()
        self._threads = [threading.Thread(target=run, daemon=True) for run in (self._speak, self._hear)]
        self.mode = HOLD
        """custom mode that it is in"""
        self.at_once = True
        """the attitude follows at once; False: the sticks move at a random moment of the cycle"""
        self.switch = self.full_yaw = False
        """the pilot's switch, and his yaw stick, from the next RC_CHANNELS on"""
        self.sent: deque[Stick] = deque(maxlen=KEPT)
        """RC_CHANNELS that went out"""
        self.came: deque[Stick] = deque(maxlen=KEPT)
        """setpoints that came, with the stick that they were made from"""
        self.modes: deque[tuple[float, int]] = deque(maxlen=1000)
        """monotonic s and custom mode of each DO_SET_MODE"""
        self.moved = 0.0
        """monotonic s at which the switch or the yaw stick first went out as it is"""
        self._said = (False, False)

    def __enter__(self) -> FakeAutopilot:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._closing.set()
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)  # wakes who waits for a datagram, though it is not connected
        for thread in self._threads:
            thread.join(2.0)
        self._socket.close()

    # What it says.

    def _speak(self) -> None:
        begun, cycle, roll = time.monotonic(), 0, MID
        while not self._closing.is_set():
            ms = cycle * 4
            beats = self._beats(cycle, ms)
            place, attitude = self._state(ms)
            moves, at_once = cycle % RC_EVERY == 0, self.at_once
            _until(begun + cycle * CYCLE)
            self._send(place)
            if moves:
                roll = roll + 1 if roll < MID + STEPS else MID - STEPS
            if moves and at_once:
                self._send_radio(ms, roll)
            self._send(attitude)
            for beat in beats:
                self._send(beat)
            if moves and not at_once:
                _until(begun + (cycle + self._chance.random()) * CYCLE)
                self._send_radio(ms, roll)
            cycle += 1

    def _send_radio(self, ms: int, roll: int) -> None:
        before, self._said = self._said, (self.switch, self.full_yaw)
        frame = self._radio(ms, roll)
        now = time.monotonic()
        if self._said != before:
            self.moved = now
        self.sent.append(Stick(now, roll))
        self._send(frame)

    def _send(self, frame: bytes) -> None:
        with contextlib.suppress(OSError):  # nobody listens yet
            self._socket.sendto(frame, self._to)

    def _radio(self, ms: int, roll: int) -> bytes:
        moved = {1: roll, 4: HIGH if self._said[1] else MID, SWITCH: HIGH if self._said[0] else LOW}
        channels = {f"chan{number}_raw": moved.get(number, MID) for number in range(1, 9)}
        return self._packer.pack("RC_CHANNELS", time_boot_ms=ms, chancount=8, rssi=100, **channels)

    def _state(self, ms: int) -> tuple[bytes, bytes]:
        place = self._packer.pack("LOCAL_POSITION_NED", time_boot_ms=ms, z=-10.0)
        return place, self._packer.pack("ATTITUDE_QUATERNION", time_boot_ms=ms, q1=1.0)

    def _beats(self, cycle: int, ms: int) -> list[bytes]:
        pack, said = self._packer.pack, []
        if cycle % BEAT_EVERY == 0:
            said = [
                self._heartbeat(),
                pack("EXTENDED_SYS_STATE", landed_state=2),
                pack("SYS_STATUS", voltage_battery=16000, battery_remaining=90),
                pack("GPS_RAW_INT", fix_type=3, satellites_visible=12, lat=HOME["lat"], lon=HOME["lon"]),
            ]
        if cycle % PLACE_EVERY == 0:
            said.append(pack("GLOBAL_POSITION_INT", time_boot_ms=ms, **HOME))
            said.append(pack("ATTITUDE_TARGET", time_boot_ms=ms, q=(1.0, 0.0, 0.0, 0.0), thrust=0.5))
        return said

    def _heartbeat(self) -> bytes:
        fields = {"type": 13, "autopilot": 12, "base_mode": ARMED | CUSTOM, "system_status": 4, "mavlink_version": 3}
        return self._packer.pack("HEARTBEAT", custom_mode=self.mode, **fields)

    # What it hears.

    def _hear(self) -> None:
        splitter = Splitter(self._dialect)
        while not self._closing.is_set():
            try:
                data = self._socket.recv(2048)
            except ConnectionError:
                continue
            except OSError:
                return
            now = time.monotonic()
            for frame in splitter.feed(data):
                name = self._ids.get(frame.msgid)
                if name is not None:
                    self._take(name, decode(frame, self._dialect), now)

    def _take(self, name: str, fields: dict[str, Any], now: float) -> None:
        if name in FLOWN:
            rate = fields.get("body_roll_rate", 0.0)
            self.came.append(Stick(now, stick_of(rate, self._full)))
        elif name == "TIMESYNC":
            if fields["tc1"] == 0:
                self._send(self._packer.pack("TIMESYNC", tc1=time.monotonic_ns(), ts1=fields["ts1"]))
        else:
            self._obey(fields, now)

    def _obey(self, command: dict[str, Any], now: float) -> None:
        number = int(command["command"])
        if number == 176:  # MAV_CMD_DO_SET_MODE
            self.mode = int(command["param2"]) << 16 | int(command["param3"]) << 24
            self.modes.append((now, self.mode))
        self._send(self._packer.pack("COMMAND_ACK", command=number, target_system=1, target_component=191))
        if number == 176:
            self._send(self._heartbeat())
        elif number == 512 and int(command["param1"]) == 148:  # MAV_CMD_REQUEST_MESSAGE: AUTOPILOT_VERSION
            version = {"uid": 1, "flight_sw_version": 0x010D00FF, "capabilities": TAKES_TORQUE | 0x2000}
            self._send(self._packer.pack("AUTOPILOT_VERSION", **version))


def stick_of(rate: float, full: float) -> int:
    """µs of the roll stick that a rate was made from."""
    return round(MID + 500.0 * rate / full)


def _until(moment: float) -> None:
    left = moment - time.monotonic()
    if left > 0.0:
        time.sleep(left)
