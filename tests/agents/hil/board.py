"""A flight controller on a pseudo-terminal, for the bench: a PX4 in HIL as far as its line shows.

Behind it is the simulator's own PX4, on its own physics: it answers each HIL_SENSOR with HIL_ACTUATOR_CONTROLS, says in
its HEARTBEAT that it is in HIL where SYS_HITL was 1 when it started, and flies by itself, not by those readings. So it
proves the stage and the plumbing, and nothing of the loop's flight dynamics.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import threading
import tty
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from zmav.mavlink import Splitter, load_dialect
from zmav.sim import SimVehicle, VehicleSpec, World
from zmav.sim.spec import Home

HIL = 32


class Px4Board:
    """``with Px4Board(PATH, hitl=1) as board``: it beats at ``PATH`` until it is left; :meth:`unplug` takes it away.
    ``speed``: times real time that it flies by itself."""

    def __init__(self, link: Path, home: Home, *, hitl: int = 1, speed: float = 1.0, **params: float) -> None:
        self.link = link
        self._udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._udp.bind(("127.0.0.1", 0))
        self._udp.settimeout(0.05)
        port = self._udp.getsockname()[1]
        endpoints, params = (f"udp:127.0.0.1:{port}",), {"SYS_HITL": float(hitl), **params}
        spec = VehicleSpec(autopilot="px4", endpoints=endpoints, params=params)
        self.world = World([spec], home=home, speed=speed)
        self._in_hil = hitl == 1
        self._stop = threading.Event()
        self._autopilot: tuple[str, int] | None = None
        self._mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self.readings = 0
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)  # nobody may read: what waits for room is to end with the board
        link.symlink_to(os.ttyname(self._slave))
        self._threads = [threading.Thread(target=run, daemon=True) for run in (self._from_autopilot, self._from_line)]

    @property
    def vehicle(self) -> SimVehicle:
        return self.world.vehicles[0]

    def __enter__(self) -> Px4Board:
        self.world.start()
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        for thread in self._threads:
            thread.join(10.0)
        self.world.close()
        self._udp.close()
        self.unplug()

    def unplug(self) -> None:
        """The cable is pulled."""
        if self._master >= 0:
            self.link.unlink()
            os.close(self._slave)
            os.close(self._master)
            self._master = -1

    def _put(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            while data and self._master >= 0 and not self._stop.is_set():
                if select.select([], [self._master], [], 0.05)[1]:
                    data = data[os.write(self._master, data) :]

    def _from_autopilot(self) -> None:
        splitter = Splitter(load_dialect("ardupilotmega"))
        while not self._stop.is_set():
            try:
                data, self._autopilot = self._udp.recvfrom(65536)
            except TimeoutError:
                continue
            for frame in splitter.feed(data):
                self._put(self._marked(bytearray(frame.data)) if frame.msgid == 0 else frame.data)

    def _marked(self, frame: bytearray) -> bytes:
        """A HEARTBEAT with its flag as SYS_HITL was."""
        beat = self._mav.decode(frame)
        beat.base_mode = beat.base_mode | HIL if self._in_hil else beat.base_mode & ~HIL
        self._mav.seq = frame[4]
        data: bytes = beat.pack(self._mav)
        return data

    def _from_line(self) -> None:
        splitter = Splitter(load_dialect("ardupilotmega"))
        while not self._stop.is_set() and self._master >= 0:
            try:
                if not select.select([self._master], [], [], 0.05)[0]:
                    continue
                data = os.read(self._master, 65536)
            except OSError:
                self._stop.wait(0.02)
                continue
            for frame in splitter.feed(data):
                if frame.msgid == mavlink.MAVLINK_MSG_ID_HIL_SENSOR:
                    self.readings += 1
                    controls = self._mav.hil_actuator_controls_encode(self.readings * 4000, [0.0] * 16, 129, 0)
                    self._put(controls.pack(self._mav))
                elif self._autopilot is not None and frame.sysid != 0:
                    self._udp.sendto(frame.data, self._autopilot)
