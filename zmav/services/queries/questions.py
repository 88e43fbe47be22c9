"""The lane of questions: what is answered, and moves nothing.

Every reader may ask, as often as the network carries it. So questions have a thread of their own, which uses a share of
one core; they wait in a queue for each channel, whose oldest gives way; and an answer of many parts is given in slices,
with other channels' questions between them. The event loop, which has orders, leases, setpoints and the watchdog, waits
for none of it. Zenoh does not say who asks: what is bounded is a channel, and channels take turns.
"""

from __future__ import annotations

import collections
import contextlib
import functools
import logging
import threading
import time
from collections.abc import Callable, Container, Iterator
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import zenoh

from zmav import keys
from zmav.bus import Bus
from zmav.errors import BadInput, Refused, ZmavError
from zmav.ratelimit import RateLimit
from zmav.services.queries.intake import Intake
from zmav.services.queries.proven import Answers, attached
from zmav.trust.gate import Prove

log = logging.getLogger(__name__)
MOST = 32
"""questions of one channel that wait"""
SLICE = 0.002
"""s of work for one question before another's turn"""
SHARE, CREDIT = 0.25, 0.05
"""of one core, for all questions together; s of work that are done at once after a pause"""
PENDING = 8
"""questions of one channel whose answer something else is to bring: the autopilot, the event loop"""

TOLD_S = 0.1
"""s between two words that questions were dropped: a flood costs no more of them"""
LARGEST = 65_536
"""bytes of a question; orders that a viewer may give are among them"""
ENDING = 1.0
"""s that its thread may take to end, where it speaks to who does not read"""


class Reply(NamedTuple):
    key: str
    data: bytes
    encoding: zenoh.Encoding = keys.JSON
    attachment: bytes | None = None
    introduce: bool = True
    """with our certificate, where it is signed"""


Steps = Iterator["Reply | Future[Any]"]
"""an answer's parts, and between them what is to be waited for; raises :class:`~zmav.errors.ZmavError`"""
Answer = Callable[[zenoh.Query], Steps]


@dataclass
class _Question:
    query: zenoh.Query
    at: float
    """monotonic seconds"""
    steps: Steps | None = None
    """once it was begun"""


@dataclass
class Channel:
    """One kind of questions: those that wait, and who answers them."""

    answer: Answer
    admit: Prove
    signed: bool
    """a member believes no other answer; of many parts none is signed: somebody looks around"""
    waiting: collections.deque[_Question] = field(default_factory=collections.deque)
    begun: collections.deque[_Question] = field(default_factory=collections.deque)
    """that go on: these give way to nobody"""
    pending: int = 0
    """that something else is to bring the answer to"""
    parameters: Container[str] = ()
    """of a selector, that are read"""


class QuestionsDropped(NamedTuple):
    """They come faster than they can be answered. Told from any thread, once in :data:`TOLD_S` s."""


class Questions:
    """One program's lane. Thread-safe; answers are worked out in its own thread.

    ``admit`` raises :class:`~zmav.errors.Forbidden` for a question that is not to be answered. ``counts``: those that
    were ``dropped`` for newer ones, or ``given_up`` by who asked. ``bus`` is told of :class:`QuestionsDropped`.
    """

    given_up = 2.0
    """s: the one who asked has given up, or asked again; what zmav's clients wait for an answer"""

    def __init__(self, session: zenoh.Session, answers: Answers, admit: Prove, bus: Bus | None = None) -> None:
        self.bus = bus or Bus()
        self._session, self._answering, self._admit = session, answers, admit
        self.counts: collections.Counter[str] = collections.Counter()
        self._channels: collections.deque[Channel] = collections.deque()
        self._intakes: list[Intake] = []
        self._news, self._closed = threading.Condition(), threading.Event()
        self._telling: RateLimit[None] = RateLimit(TOLD_S, 1)
        self._credit, self._paid = CREDIT, time.monotonic()
        self._thread: threading.Thread | None = None

    def declare(self, key: str, answer: Answer, admit: Prove | None = None, parameters: Container[str] = ()) -> None:
        """Answer what is asked on ``key``; ``admit``: instead of the lane's own. ``parameters`` are those read."""
        channel = self.channel(answer, admit, signed=bool(keys.answerers(key.replace("*", "x"))))
        channel.parameters = parameters
        take = functools.partial(self.put, channel)
        self._intakes.append(Intake(self._session.declare_queryable, key, take, MOST))

    def channel(self, answer: Answer, admit: Prove | None = None, *, signed: bool = False) -> Channel:
        """A channel whose questions come by :meth:`put`."""
        channel = Channel(answer, admit or self._admit, signed)
        with self._news:
            self._channels.append(channel)
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="questions", daemon=True)
                self._thread.start()
        return channel

    def put(self, channel: Channel, query: zenoh.Query) -> None:
        """Have it answered, in its turn."""
        if self._fits(query, channel.parameters) and self._wait(channel, _Question(query, time.monotonic())):
            with self._news:
                self.counts["dropped"] += 1
            if self._telling.take(None) is not None:
                self.bus.tell(QuestionsDropped())

    def refuse(self, channel: Channel, query: zenoh.Query, error: ZmavError) -> None:
        """Answer in words why not, in its turn."""
        self._wait(channel, _Question(query, time.monotonic(), _refusing(error)))

    def _wait(self, channel: Channel, question: _Question) -> bool:
        """It has its turn when those before have had theirs; whether the oldest gave way to it."""
        with self._news:
            oldest = channel.waiting.popleft() if len(channel.waiting) >= MOST else None
            channel.waiting.append(question)
            self._news.notify()
        if oldest is not None:
            _end(oldest)
        return oldest is not None

    def _fits(self, query: zenoh.Query, parameters: Container[str]) -> bool:
        """What is too large, or has parameters that nobody reads, is refused in words, before it waits."""
        size = 0 if query.payload is None else len(query.payload)
        try:
            if size > LARGEST:
                text = f"{size} bytes are too much for a question; at most {LARGEST} are read"
                raise BadInput(text, field="payload", value=size, expected=f"at most {LARGEST} bytes")
            refuse_parameters(query, parameters)
        except BadInput as e:
            with contextlib.suppress(zenoh.ZError), query:  # who asked may be gone
                self._answering.refuse(query, e)
            return False
        return True

    @property
    def waiting(self) -> int:
        """Questions that have come and are not begun."""
        return sum(len(channel.waiting) for channel in self._channels)

    def close(self) -> None:
        """Answer no more."""
        self._closed.set()
        for intake in self._intakes:
            intake.close()
        with self._news:
            left = [question for channel in self._channels for question in (*channel.begun, *channel.waiting)]
            self._channels.clear()
            self._news.notify()
        for question in left:
            _end(question)
        if self._thread is not None:
            self._thread.join(ENDING)

    # In the lane's thread.

    def _run(self) -> None:
        while (turn := self._next()) is not None:
            began = time.thread_time()
            try:
                self._serve(*turn)
            except zenoh.ZError:  # who asked is gone, or the session is closed
                _end(turn[1])
            except Exception:  # the others are answered nevertheless
                log.exception("a question was not answered")
                _end(turn[1])
            self._pay(time.thread_time() - began)

    def _next(self) -> tuple[Channel, _Question] | None:
        with self._news:
            while not self._closed.is_set():
                for _ in range(len(self._channels)):
                    channel = self._channels[0]
                    self._channels.rotate(-1)
                    if found := channel.begun or channel.waiting:
                        return channel, found.popleft()
                self._news.wait()
        return None

    def _pay(self, work: float) -> None:
        """Rest for as long as the work was more than the lane's share."""
        now = time.monotonic()
        self._credit = min(self._credit + (now - self._paid) * SHARE, CREDIT) - work
        self._paid = now
        if self._credit < 0.0:
            self._closed.wait(-self._credit / SHARE)

    def _serve(self, channel: Channel, question: _Question) -> None:
        query = question.query
        try:
            if question.steps is None:
                if time.monotonic() - question.at > self.given_up:
                    self.counts["given_up"] += 1
                    _end(question)
                    return
                channel.admit(str(query.key_expr), query.payload.to_bytes() if query.payload else b"", attached(query))
                question.steps = channel.answer(query)
            if self._go_on(channel, question, question.steps):
                return
        except ZmavError as e:
            self._answering.refuse(query, e)
        except zenoh.ZError:
            raise
        except Exception as e:  # the next one is answered nevertheless
            self._answering.refuse(query, ZmavError(f"no answer: {e!r}"))
        _end(question)

    def _go_on(self, channel: Channel, question: _Question, steps: Steps) -> bool:
        """Give as much of the answer as a slice holds; whether there is more to come."""
        until = time.thread_time() + SLICE
        for step in steps:
            if isinstance(step, Future):
                self._wait_for(step, channel, question)
                return True
            if channel.signed and "*" not in str(question.query.key_expr):
                self._answering.give(question.query, step.key, step.data, introduce=step.introduce)
            else:
                question.query.reply(step.key, step.data, encoding=step.encoding, attachment=step.attachment)
            if time.thread_time() > until:
                self._put_back(channel, question)
                return True
        return False

    def _wait_for(self, result: Future[Any], channel: Channel, question: _Question) -> None:
        with self._news:
            if channel.pending >= PENDING:
                result.cancel()
                raise Refused(f"{PENDING} questions wait for their answers already: ask again", reason="busy")
            channel.pending += 1

        def done(_: Future[Any]) -> None:
            with self._news:
                channel.pending -= 1
            self._put_back(channel, question)

        result.add_done_callback(done)

    def _put_back(self, channel: Channel, question: _Question) -> None:
        """It goes on when its channel's turn comes again."""
        with self._news:
            if not self._closed.is_set():
                channel.begun.append(question)
                self._news.notify()
                return
        _end(question)


def refuse_parameters(query: zenoh.Query, known: Container[str] = ()) -> None:
    """Raise :class:`BadInput` for a parameter of the selector (``?name=value``) that nobody reads; those that begin
    with an underscore are Zenoh's own.
    """
    if query.parameters.is_empty():
        return
    for name, _, value in (pair.partition("=") for pair in str(query.parameters).split(";")):
        if name not in known and not name.startswith("_"):
            text = f"the selector's parameter {name!r} is not read: give what you want as JSON in the query's payload"
            raise BadInput(text, field=name, value=value, expected="a payload")


def _refusing(error: ZmavError) -> Steps:
    raise error
    yield


def _end(question: _Question) -> None:
    with contextlib.suppress(zenoh.ZError, ValueError, RuntimeError):  # ended already or just now, or its asker is gone
        question.query.drop()
