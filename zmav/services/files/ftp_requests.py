"""A conversation with an autopilot's file server: requests, their answers, and what to do when one of them is lost."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from zmav.errors import TimedOut
from zmav.mavlink.ftp import Op, Packet, pack, unpack
from zmav.services.link.port import Inbox, Port, RoundTrip

MESSAGE = "FILE_TRANSFER_PROTOCOL"
GIVE_UP = 15.0
"""s without any answer; with 20 % of the frames lost each way that is one request in ten million"""
SHORTEST, LONGEST = 0.25, 2.5
"""s to wait for an answer before asking again; between them, what the link has shown"""
IN_FLIGHT = 5
"""requests sent ahead of their answers: ArduPilot queues five that come at once and drops the rest"""
AFTER_BURST = 1024
"""sequence numbers left out after a burst: servers count on while they burst, and take a request one behind their last
answer for a repetition of the request before"""


class Job(NamedTuple):
    """A part of a file to read (no data) or to write."""

    offset: int
    size: int
    data: bytes = b""


@dataclass
class PendingJob:
    """A job that has been sent, and not been answered yet."""

    job: Job
    sent: float = 0.0
    seqs: dict[int, float] = field(default_factory=dict)
    """its sequence numbers, and when each was sent"""


class Talk:
    """Speaks with the file server of ``target`` while the ``with`` lasts. Lives on the event loop.

    ``session``: the number we ask with until the server names its own. ArduPilot lets the client choose, and closes by
    ResetSessions only the session of that number, so ours is not a ground station's. ``seq``: the last sequence number
    of the conversation before: a server takes a request with the number it answered last for a repetition of that.
    ``most``: seconds without a packet for us after which nothing more is waited for.
    """

    def __init__(self, port: Port, target: tuple[int, int], session: int, seq: int = 0, most: float = math.inf) -> None:
        self._port, self._target, self._most = port, target, most
        self._heard = time.monotonic()
        self.session = session
        self.seq = seq
        self._trip = RoundTrip(1.0, SHORTEST, LONGEST)
        self._mail = Inbox(port, target, MESSAGE)

    def __enter__(self) -> Talk:
        self._mail.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._mail.__exit__()

    @property
    def patience(self) -> float:
        """s after which an answer is taken for lost."""
        return self._trip.timeout

    async def receive(self, timeout: float) -> Packet | None:
        """The next packet that is for us; None when none came within ``timeout`` seconds.

        Raises :class:`TimedOut` when none has come for ``most`` seconds.
        """
        until = min(time.monotonic() + timeout, self._heard + self._most)
        while (frame := await self._mail.frame(until - time.monotonic())) is not None:
            payload = frame.payload
            to = payload[1:3].ljust(2, b"\0")
            if (to[0], to[1]) in ((0, 0), self._port.address):
                self._heard = time.monotonic()
                return unpack(payload[3:])
        if time.monotonic() >= self._heard + self._most:
            raise TimedOut(f"no answer to file requests within {self._most:g} s", vehicle=self._port.name)
        return None

    # Out.

    def send(
        self, op: Op, data: bytes = b"", *, offset: int = 0, size: int | None = None, seq: int | None = None
    ) -> int:
        """Send a request; gives its sequence number, the next one unless it is a repetition."""
        if seq is None:
            self.seq = seq = (self.seq + 1) & 0xFFFF
        packet = Packet(seq, self.session, op, len(data) if size is None else size, offset=offset, data=data)
        system, component = self._target
        self._port.send(MESSAGE, target_system=system, target_component=component, payload=pack(packet))
        return seq

    def skip(self, last: int, count: int) -> None:
        """Go on with sequence numbers ``count`` behind ``last``."""
        self.seq = (last + count) & 0xFFFF

    async def ask(
        self, op: Op, data: bytes = b"", *, offset: int = 0, size: int | None = None, give_up: float = GIVE_UP
    ) -> Packet:
        """One request and its answer, ACK or NAK; asked again with the same sequence number until it is answered.

        Raises :class:`TimedOut` after ``give_up`` seconds.
        """
        began = sent = time.monotonic()
        seq, wait, again = self.send(op, data, offset=offset, size=size), self.patience, False
        while (now := time.monotonic()) < began + give_up:
            answer = await self.receive(min(sent + wait, began + give_up) - now)
            if answer is None:
                wait, sent, again = min(wait * 1.5, LONGEST), time.monotonic(), True
                self.send(op, data, offset=offset, size=size, seq=seq)
            elif (answer.seq - 1) & 0xFFFF == seq:
                if answer.req_opcode == op:
                    if not again:  # else nobody knows which request was answered
                        self.learn(time.monotonic() - sent)
                    return answer
                # The server takes it for a repetition of a request before: say it with another number.
                seq, sent = self.send(op, data, offset=offset, size=size), time.monotonic()
        words = f"no answer to {op.name} within {give_up:.0f} s: the link is bad, or this autopilot has no MAVFTP"
        raise TimedOut(words, vehicle=self._port.name)

    async def pipeline(self, op: Op, jobs: Iterator[Job], done: Callable[[Job, Packet], None]) -> None:
        """Requests for all ``jobs``, several in flight; ``done(job, answer)`` for each. Raises :class:`TimedOut`, and
        what ``done`` raises.
        """
        flying: list[PendingJob] = []
        by_seq: dict[int, PendingJob] = {}
        heard = time.monotonic()
        while True:
            while len(flying) < IN_FLIGHT and (job := next(jobs, None)) is not None:
                flying.append(PendingJob(job))
                self._launch(op, flying[-1], by_seq)
            if not flying:
                return
            oldest = min(flying, key=lambda flight: flight.sent)
            answer = await self.receive(oldest.sent + self.patience - time.monotonic())
            if answer is None:
                if time.monotonic() - heard > GIVE_UP:
                    raise TimedOut(f"no answer to {op.name} within {GIVE_UP:.0f} s", vehicle=self._port.name)
                self._launch(op, oldest, by_seq)
                continue
            flight = by_seq.get((answer.seq - 1) & 0xFFFF)
            if flight is None or answer.req_opcode != op:
                continue
            heard = time.monotonic()
            self.learn(heard - flight.seqs[answer.seq - 1 & 0xFFFF])
            flying.remove(flight)
            for seq in flight.seqs:
                by_seq.pop(seq, None)
            done(flight.job, answer)

    def _launch(self, op: Op, flight: PendingJob, by_seq: dict[int, PendingJob]) -> None:
        """Send it, again with a number of its own: its place in the file says what it is."""
        offset, size, data = flight.job
        seq = self.send(op, data, offset=offset, size=size)
        flight.sent = flight.seqs[seq] = time.monotonic()
        by_seq[seq] = flight

    def learn(self, took: float) -> None:
        """How long an answer took on this link."""
        self._trip.sample(took)
