"""A vehicle that an ArduPilot flies through its JSON interface: the UDP socket, and whose packets are taken."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from typing import Any

from zmav.errors import BadMessage
from zmav.hil.json_fdm import PORT, PORT_STEP, JsonFdm
from zmav.hil.plant import Plant
from zmav.hil.vehicle import LOOPBACK, Served

READ_BYTES = 2048
READS_PER_TURN = 16
TAKEN_S = 0.5  # of wall time: for so long after a packet nobody else's are taken


def json_port(instance: int) -> int:
    """Where ArduPilot's instance (``-I``) looks for the physics."""
    return PORT + PORT_STEP * instance


class JsonVehicle(Served):
    """Answers one ArduPilot at ``port`` of loopback (UDP; port 0: any free one).

    The first that sends servo packets is answered; another, once that one has been silent for :data:`TAKEN_S`.
    """

    autopilot, transport, scheme = "ardupilot", "udp", "json"
    feels = frozenset({"motor", "battery", "rangefinder", "pitot"})  # the other sensors are its own simulation's

    def __init__(self, name: str, sysid: int, plant: Plant, say: Callable[[str], None], port: int) -> None:
        super().__init__(name, sysid, plant, say, port)
        self.protocol = JsonFdm(plant)
        self.strangers = 0
        self._peer: Any = None

    def _opened(self) -> socket.socket:
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            opened.bind((LOOPBACK, self.port))
        except OSError:
            opened.close()
            raise
        return opened

    # ---- the stack's side

    def _ready(self) -> None:
        assert self._socket is not None
        for _ in range(READS_PER_TURN):
            try:
                data, sender = self._socket.recvfrom(READ_BYTES)
            except (BlockingIOError, InterruptedError):
                return
            except OSError:
                continue  # the stack's port is closed at present
            self._take(data, sender)

    def _take(self, data: bytes, sender: Any) -> None:
        if sender != self._peer and time.monotonic() - self._heard < TAKEN_S:
            self.strangers += 1
            return
        restarts = self.protocol.restarts
        try:
            answer = self.protocol.take(data)
        except BadMessage as error:
            self.bad += 1
            if self.bad == 1:
                self.say(f"{self.name}: {error.message}")
            return
        self._peer = sender
        self.heard()
        if self.protocol.restarts != restarts:
            self.say(f"{self.name}: the flight stack has started again; the vehicle is back at its start")
            self.restarted()
        if answer is not None:
            self._send(answer)
            return
        self.proceed()

    @property
    def waits(self) -> bool:
        return self.protocol.wanted_s > 0.0

    def proceed(self) -> None:
        wanted = self.protocol.wanted_s
        if wanted and self.granted(wanted):
            self._send(self.protocol.answer())

    def _send(self, answer: bytes) -> None:
        if self._socket is None:
            return
        try:
            self._socket.sendto(answer, self._peer)
        except OSError:
            return  # lost, as datagrams are: the stack asks again
