"""A vehicle that a PX4 flies through its simulator interface: a TCP server, and lock step with anyone who connects."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable

from zmav.errors import BadMessage
from zmav.hil.plant import Plant
from zmav.hil.stream import FAULTS, HilStream
from zmav.hil.vehicle import LOOPBACK, Served
from zmav.mavlink.dialect import Dialect
from zmav.mavlink.frames import Splitter
from zmav.sim.endpoints.base import ByteLine

PORT = 4560
SEND_BYTES = 32 * 1024  # readings that wait longer are worth nothing
ROOM = 4096  # bytes that a step's messages may take
NUDGE_S = 1.0  # of wall time without controls, after which one more reading is sent


def px4_port(instance: int) -> int:
    """Where PX4's instance (``-i``) connects to its simulator."""
    return PORT + instance


class Px4Vehicle(Served):
    """Serves one PX4 at ``port`` of loopback (TCP; port 0: any free one).

    Until the first HIL_ACTUATOR_CONTROLS time goes on with the world's, which gives PX4 the clock to boot by. From then
    on, where its lock-step flag is set, each reading waits for the controls that follow the one before: those stamped
    with its time, which PX4 counts from the first reading that it got. A PX4 that stops answering is left out of the
    world's time and gets one reading a second, lest both wait for ever.
    A further connection takes the place of the one before: PX4 has started again, and the vehicle is put back.
    """

    autopilot, transport, scheme = "px4", "tcp", "px4"
    feels = FAULTS

    def __init__(
        self,
        name: str,
        sysid: int,
        plant: Plant,
        say: Callable[[str], None],
        dialect: Dialect,
        epoch_us: int,
        port: int,
    ) -> None:
        super().__init__(name, sysid, plant, say, port)
        self.stream = HilStream(plant, dialect, sysid, epoch_us)
        self.stalls = 0
        self._dialect = dialect
        self.splitter = Splitter(dialect)
        self.line: ByteLine | None = None
        self._awaiting = False  # controls that answer the last reading
        self._begun_us = 0  # the time of the first reading; 0: there was none yet
        self._sent = 0.0  # wall time of the last reading

    def _opened(self) -> socket.socket:
        return socket.create_server((LOOPBACK, self.port), backlog=4)

    def close(self) -> None:
        if self.line is not None:
            self.line.close()
            self.line = None
        super().close()

    @property
    def armed(self) -> bool:
        return self.connected and self.stream.armed

    # ---- the connection

    def _ready(self) -> None:
        assert self._socket is not None and self._selector is not None
        try:
            connection, _ = self._socket.accept()
        except OSError:
            return  # it left before it was let in
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BYTES)
        if self.line is not None:
            self.line.close()
        self.line = ByteLine(connection.detach(), self._selector, self._hear, self._leave)
        self.splitter = Splitter(self._dialect)
        if self.stream.plant.time_s > 0.0:
            self.plant.reset()
        self.stream.restart()
        self._awaiting = False
        self._begun_us = 0
        self.connected = False
        self.heard()
        self.say(f"{self.name}: a flight stack has connected")

    def _leave(self, why: str) -> None:
        self.line = None
        self.connected = False
        self.stream.restart()
        self.plant.drive([0.0] * len(self.plant.values))
        self.say(f"{self.name}: the flight stack has left ({why})")

    def _hear(self, data: bytes) -> None:
        before = self.stream.controls
        for frame in self.splitter.feed(data):
            if not frame.verified:
                continue
            try:
                self.stream.take(frame)
            except BadMessage:
                self.bad += 1
                continue
            self.heard()
        if self.stream.controls != before and self._answered():
            self._awaiting = False
            self.proceed()
        self.flush()

    def _answered(self) -> bool:
        """The controls heard last are no late answer to a reading before the last: what PX4 was sent while it did not
        answer would else stand between each reading and its controls for ever.
        """
        stamp = self.stream.answered_us
        return stamp == 0 or stamp >= self.stream.time_us - self._begun_us

    # ---- time

    @property
    def waits(self) -> bool:
        return not self._awaiting

    def behind(self) -> bool:
        return self.stream.lockstep and super().behind()

    def proceed(self) -> None:
        while self.line is not None and not self._awaiting and self.granted(self.stream.interval_s):
            if self.line.room() < ROOM:
                return
            self._step()

    def grant(self, now: float) -> None:
        super().grant(now)
        if self._awaiting and time.monotonic() - self._sent > NUDGE_S:
            self.stalls += 1
            if self.stalls == 1:
                self.say(f"{self.name}: the flight stack has stopped answering")
            if self.line is not None and self.line.room() >= ROOM:
                self._step()

    def _step(self) -> None:
        assert self.line is not None
        self.line.put(self.stream.step())
        self._begun_us = self._begun_us or self.stream.time_us
        self.line.flush()
        self._sent = time.monotonic()
        self._awaiting = self.stream.lockstep

    def flush(self) -> None:
        if self.line is not None:
            self.line.flush()
