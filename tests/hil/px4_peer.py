"""A protocol peer for PX4's simulator interface: it connects as PX4 does, flies by HIL_SENSOR and HIL_GPS alone
with the controller of :mod:`tests.hil.hover`, and answers each reading with HIL_ACTUATOR_CONTROLS. No PX4 is in it.

Frames are made and read by pymavlink, so that both ends do not share one's errors.
"""

from __future__ import annotations

import contextlib
import math
import socket
import threading
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from tests.hil.hover import CROSS, Observer, steer
from zmav.sim.sensors.magnetic import earth_field

ARMED, LOCKSTEP = 129, 1
ALL_MAG = 0x1C0


class Px4Peer:
    """Speaks PX4's side of the messages over ``send``; :meth:`take` bytes as they come. It stays disarmed until it has
    a position, and ``arm`` is set. ``target``: north, east, down about where it started.
    """

    def __init__(self, send: Any, *, lockstep: bool = True) -> None:
        self.send = send
        self.mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self.mav.robust_parsing = True
        self.flags = LOCKSTEP if lockstep else 0
        self.target = (0.0, 0.0, -5.0)
        self.arm = True
        self.mute = False
        self.heard: dict[str, list[Any]] = {}
        self.counts: dict[str, int] = {}
        self._observer: Observer | None = None
        self._origin: tuple[float, float] | None = None
        self._last_us = self._first_us = 0
        self._mag = (0.0, 0.0, 0.0)
        self._first_fix: tuple[float, float] | None = None

    def hello(self) -> None:
        """What PX4 says when it has connected."""
        self.say(self.mav.heartbeat_encode(0, 12, 0, 0, 0))
        self.say(self.mav.command_long_encode(0, 0, 511, 0, 115, 5000, 0, 0, 0, 0, 0))

    def say(self, message: Any) -> None:
        self.send(message.pack(self.mav))

    def take(self, data: bytes) -> None:
        for message in self.mav.parse_buffer(data) or []:
            name = message.get_type()
            self.counts[name] = self.counts.get(name, 0) + 1
            kept = self.heard.setdefault(name, [])
            kept.append(message)
            del kept[:-50]
            if name == "HIL_GPS":
                self._gps(message)
            elif name == "HIL_SENSOR":
                self._sensor(message)

    def _gps(self, m: Any) -> None:
        lat, lon = m.lat / 1e7, m.lon / 1e7
        if self._origin is None:
            self._origin = (lat, lon)
            north, east, _ = earth_field(lat, lon)
            self._observer = Observer(math.atan2(east, north))
        assert self._observer is not None
        if m.fix_type < 3:
            return
        scale = 111_318.845
        place = (
            (lat - self._origin[0]) * scale,
            (lon - self._origin[1]) * scale * math.cos(math.radians(lat)),
            0.0,
        )
        self._observer.gps(place, (m.vn / 100.0, m.ve / 100.0, m.vd / 100.0))

    def _sensor(self, m: Any) -> None:
        if m.fields_updated & ALL_MAG:
            self._mag = (m.xmag, m.ymag, m.zmag)
        observer = self._observer
        controls = [0.0] * 16
        mode = ARMED & ~128
        if observer is not None:
            dt = (m.time_usec - self._last_us) * 1e-6 if self._last_us else 0.004
            observer.imu((m.xgyro, m.ygyro, m.zgyro), (m.xacc, m.yacc, m.zacc), self._mag, m.pressure_alt, dt)
            if self.arm and observer.state is not None:
                controls[:4] = steer(CROSS, observer.state, self.target, 0.5)
                mode = ARMED
        self._last_us = m.time_usec
        self._first_us = self._first_us or m.time_usec
        if not self.mute:
            # PX4's time begins with its first reading.
            stamp = m.time_usec - self._first_us
            self.say(self.mav.hil_actuator_controls_encode(stamp, controls, mode, self.flags))


class TcpPeer(Px4Peer):
    """That peer on a TCP connection, in a thread of its own."""

    def __init__(self, port: int, **options: Any) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=30.0)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        super().__init__(self.out, **options)
        self._thread = threading.Thread(target=self._run, name="px4-peer", daemon=True)

    def out(self, data: bytes) -> None:
        try:
            self.socket.sendall(data)
        except OSError:
            return  # the simulator has gone: the reader ends by itself

    def start(self) -> None:
        self.hello()
        self._thread.start()

    def _run(self) -> None:
        while True:
            try:
                data = self.socket.recv(65536)
            except OSError:
                return
            if not data:
                return
            self.take(data)

    def close(self) -> None:
        with contextlib.suppress(OSError):  # closed at the other end
            self.socket.shutdown(socket.SHUT_RDWR)
        self.socket.close()
        if self._thread.is_alive():
            self._thread.join(10.0)
