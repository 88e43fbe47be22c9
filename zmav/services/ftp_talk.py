"""A conversation with an autopilot's file server: requests, their answers, and what to do when one of them is lost."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import NamedTuple

from zmav.errors import TimedOut
from zmav.mavlink.ftp import Op, Packet, pack, unpack
from zmav.services.mailbox import Mailbox
from zmav.services.port import Port

MESSAGE = "FILE_TRANSFER_PROTOCOL"
GIVE_UP = 15.0
"""s without any answer; with 20 % of the frames lost each way that is one request in ten million"""
SHORTEST, LONGEST = 0.25, 2.5
"""s to wait for an answer before asking again; between them, what the link has shown"""
IN_FLIGHT = 4
"""requests sent ahead of their answers: ArduPilot queues five and drops the rest"""
AFTER_BURST = 1024
"""sequence numbers left out after a burst: servers count on while they burst, and take a request one behind their last
answer for a repetition of the request before"""


class Job(NamedTuple):
    """A part of a file to read (no data) or to write."""

    offset: int
    size: int
    data: bytes = b""


@dataclass
class Flight:
    """A job that has been sent, and not been answered yet."""

    job: Job
    sent: float = 0.0
    seqs: tuple[int, ...] = ()


class Talk:
    """Speaks with the file server of ``target`` while the ``with`` lasts. Lives on the event loop.

    ``session``: the number we ask with until the server names its own. ArduPilot lets the client choose, and closes by
    ResetSessions only the session of that number, so ours is not a ground station's.
    """

    def __init__(self, port: Port, target: tuple[int, int], session: int) -> None:
        self._port, self._target = port, target
        self.session = session
        self._seq = 0
        self._rto = 1.0
        self._trip: float | None = None
        self._mail = Mailbox(port, target, MESSAGE)

    def __enter__(self) -> Talk:
        self._mail.__enter__()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._mail.__exit__(kind, error, tb)

    @property
    def patience(self) -> float:
        """s after which an answer is taken for lost."""
        return self._rto

    async def receive(self, timeout: float) -> Packet | None:
        """The next packet that is for us; None when none came within ``timeout`` seconds."""
        until = time.monotonic() + timeout
        while (frame := await self._mail.get(until - time.monotonic())) is not None:
            payload = frame.payload
            to = payload[1:3].ljust(2, b"\0")
            if (to[0], to[1]) in ((0, 0), self._port.address):
                return unpack(payload[3:])
        return None

    # Out.

    def send(
        self, op: Op, data: bytes = b"", *, offset: int = 0, size: int | None = None, seq: int | None = None
    ) -> int:
        """Send a request; gives its sequence number, the next one unless it is a repetition."""
        if seq is None:
            self._seq = seq = (self._seq + 1) & 0xFFFF
        packet = Packet(seq, self.session, op, len(data) if size is None else size, offset=offset, data=data)
        system, component = self._target
        self._port.send(MESSAGE, target_system=system, target_component=component, payload=pack(packet))
        return seq

    def skip(self, last: int, count: int) -> None:
        """Go on with sequence numbers ``count`` behind ``last``."""
        self._seq = (last + count) & 0xFFFF

    async def ask(
        self, op: Op, data: bytes = b"", *, offset: int = 0, size: int | None = None, give_up: float = GIVE_UP
    ) -> Packet:
        """One request and its answer, ACK or NAK; asked again with the same sequence number until it is answered.

        Raises :class:`TimedOut` after ``give_up`` seconds.
        """
        began = time.monotonic()
        seq, tries = self.send(op, data, offset=offset, size=size), 1
        sent = began
        while (now := time.monotonic()) < began + give_up:
            answer = await self.receive(min(sent + self._rto, began + give_up) - now)
            if answer is None:
                self._rto = min(self._rto * 1.5, LONGEST)
                tries, sent = tries + 1, time.monotonic()
                self.send(op, data, offset=offset, size=size, seq=seq)
            elif (answer.seq - 1) & 0xFFFF == seq:
                if answer.req_opcode == op:
                    self._learn(sent, tries)
                    return answer
                # The server takes it for a repetition of a request before: say it with another number.
                seq, sent = self.send(op, data, offset=offset, size=size), time.monotonic()
        words = f"no answer to {op.name} within {give_up:.0f} s: the link is bad, or this autopilot has no MAVFTP"
        raise TimedOut(words, vehicle=self._port.name)

    async def pipeline(self, op: Op, jobs: Iterator[Job], done: Callable[[Job, Packet], None]) -> None:
        """Requests for all ``jobs``, several in flight; ``done(job, answer)`` for each. Raises :class:`TimedOut`, and
        what ``done`` raises.
        """
        flying: list[Flight] = []
        by_seq: dict[int, Flight] = {}
        heard = time.monotonic()
        while True:
            while len(flying) < IN_FLIGHT and (job := next(jobs, None)) is not None:
                flying.append(Flight(job))
                self._launch(op, flying[-1], by_seq)
            if not flying:
                return
            oldest = min(flying, key=lambda flight: flight.sent)
            answer = await self.receive(oldest.sent + self._rto - time.monotonic())
            if answer is None:
                if time.monotonic() - heard > GIVE_UP:
                    raise TimedOut(f"no answer to {op.name} within {GIVE_UP:.0f} s", vehicle=self._port.name)
                self._rto = min(self._rto * 1.5, LONGEST)
                self._launch(op, oldest, by_seq)
                continue
            flight = by_seq.get((answer.seq - 1) & 0xFFFF)
            if flight is None or answer.req_opcode != op:
                continue
            heard = time.monotonic()
            self._learn(flight.sent, len(flight.seqs))
            flying.remove(flight)
            for seq in flight.seqs:
                by_seq.pop(seq, None)
            done(flight.job, answer)

    def _launch(self, op: Op, flight: Flight, by_seq: dict[int, Flight]) -> None:
        """Send it, again with a number of its own: its place in the file says what it is."""
        offset, size, data = flight.job
        seq = self.send(op, data, offset=offset, size=size)
        flight.seqs, flight.sent = (*flight.seqs, seq), time.monotonic()
        by_seq[seq] = flight

    def _learn(self, sent: float, tries: int) -> None:
        """How long an answer takes on this link; one to a repeated request does not tell."""
        if tries > 1:
            return
        took = time.monotonic() - sent
        self._trip = took if self._trip is None else 0.8 * self._trip + 0.2 * took
        self._rto = min(max(2.0 * self._trip + 0.1, SHORTEST), LONGEST)
