"""``do/{verb}`` and ``swarm/{verb}``: queries that make something happen, once each however often they are sent.

An order with an id is answered within its ``wait`` with status "running" while it lasts; the caller asks again with the
same id, so that a lost answer costs one retry and no second takeoff. Of an order that is large, the id alone is sent
again (:class:`zmav.wire.Again`).
"""

from __future__ import annotations

import asyncio
import collections
import hashlib
import logging
import time
from collections.abc import Awaitable, Callable, Coroutine, Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple

import zenoh

from zmav import keys, wire
from zmav.errors import BadInput, Forbidden, Refused, ZmavError
from zmav.services.queries.intake import Intake
from zmav.services.queries.outcomes import Outcomes
from zmav.services.queries.proven import Answers, attached
from zmav.services.queries.questions import Questions, Reply, Steps, refuse_parameters
from zmav.trust.gate import Origin, Prove, anybody
from zmav.verbs import VERBS, Access, Verb
from zmav.waiting import in_thread, on_loop
from zmav.wire.orders import UNKNOWN

logger = logging.getLogger(__name__)
MOST_KEPT = 1000
"""finished orders whose outcome is kept, and proofs of who gave one"""
MOST_WAITING = 256
"""orders that have come and were not looked at yet, but for those that make it safe"""
MOST_URGENT = 256
"""and of those that do: all of them are proven"""
MOST_LOOKING = 4
"""orders under way of one member that a viewer may give, too"""
MOST_BYTES = 4_000_000
"""of an order: a mission of 15,000 items"""
MOST_ID = 64
"""characters of an id"""

Report = Callable[[dict[str, Any]], None]
Handler = Callable[[Any, Report], Awaitable[dict[str, Any]]]
Guarded = Callable[[Any, Report, "Origin | None"], Awaitable[dict[str, Any]]]
"""is told who asks, too, where that is proven"""
Permit = Callable[[Verb, Guarded], Guarded]
"""the handler of a verb, behind what decides whether such an order may be carried out now"""


def proof_is_enough(verb: Verb, handler: Guarded) -> Guarded:
    """For orders that need no more than the proof of who gives them: none of them moves a vehicle by itself."""
    return handler


class ProvenOrder(NamedTuple):
    """An order as it came, and who gives it."""

    query: zenoh.Query
    key: str
    payload: bytes
    origin: Origin | None
    repeated: Forbidden | None = None
    """its very proof has come before, and this is why it is refused where it is not known any more"""


@dataclass
class Operation:
    verb: str
    payload: bytes
    """its digest: what was put may be large"""
    origin: Origin | None
    task: asyncio.Task[dict[str, Any]]
    started: float = field(default_factory=time.monotonic)
    ended: float | None = None
    progress: dict[str, Any] = field(default_factory=dict)

    @property
    def took(self) -> float:
        """s since it was first heard, to its end where that has come."""
        return (self.ended or time.monotonic()) - self.started

    def end(self, task: asyncio.Task[dict[str, Any]]) -> None:
        self.ended = time.monotonic()
        error = None if task.cancelled() else task.exception()
        if error is not None and not isinstance(error, ZmavError):
            logger.error("%s failed by a defect", self.verb, exc_info=error)  # where: who asked is told the words only


class Operations:
    """Orders by their ids: each is done once however often it comes, and its outcome is kept for a while after its end.
    Lives on the event loop.
    """

    memory = 60.0
    """seconds a finished order's outcome is kept for a caller who asks again"""
    most_kept, most_ids = MOST_KEPT, 10_000
    """finished orders whose outcome is kept, and ids of older ones: those are not done again either"""

    def __init__(self) -> None:
        self._operations: dict[str, Operation] = {}
        self._ended: collections.OrderedDict[str, float] = collections.OrderedDict()
        """when the orders ended whose outcome is kept no more"""

    @property
    def under_way(self) -> list[Operation]:
        """Those that have not ended."""
        return [operation for operation in self._operations.values() if not operation.task.done()]

    def __iter__(self) -> Iterator[Operation]:
        """Those that are under way, and those whose outcome is kept."""
        return iter(tuple(self._operations.values()))

    def knows(self, name: str) -> bool:
        """The order of that id is under way, or its outcome is kept."""
        return name != "" and name in self._operations

    def once(
        self,
        verb: str,
        name: str,
        payload: bytes,
        origin: Origin | None,
        begin: Callable[[Report], Coroutine[Any, Any, dict[str, Any]]],
    ) -> Operation:
        """The order of the id ``name`` (empty: it has none), begun where it comes for the first time.

        Raises :class:`BadInput` for an id of another order and for one too long, :class:`Refused` for one that ended
        long ago.
        """
        self._forget()
        if len(name) > MOST_ID:
            text = f"an id has at most {MOST_ID} characters"
            raise BadInput(text, field="id", value=name[:MOST_ID], expected=text)
        if name in self._ended:
            ago = time.monotonic() - self._ended[name]
            raise Refused(
                f"{verb} ended {ago:.0f} s ago, and is not done again: give it again, with another id", verb=verb
            )
        known, digest = self._operations.get(name) if name else None, hashlib.sha256(payload).digest()
        if known is not None:
            if (known.verb, known.payload, known.origin) != (verb, digest, origin):
                raise BadInput(f"id {name!r} was used for another order ({known.verb})", field="id", value=name)
            return known
        progress: dict[str, Any] = {}

        def report(news: dict[str, Any]) -> None:
            progress.update(news)

        task = asyncio.get_running_loop().create_task(begin(report))
        operation = Operation(verb, digest, origin, task, progress=progress)
        task.add_done_callback(operation.end)
        self._operations[name or f"#{id(task)}"] = operation
        return operation

    def find(self, verb: str, name: str, origin: Origin | None) -> Operation:
        """The order of that id; :class:`Refused` where none of that giver has come, or it is long over."""
        known = self._operations.get(name)
        if known is None or (known.verb, known.origin) != (verb, origin):
            raise Refused(f"no order {verb} has come with that id: send all of it", reason=UNKNOWN, verb=verb)
        return known

    def _forget(self) -> None:
        old = time.monotonic() - self.memory
        ended = [(name, op.ended) for name, op in self._operations.items() if op.ended is not None]
        beyond = len(ended) - self.most_kept
        for number, (name, at) in enumerate(ended):
            if at <= old or number < beyond:
                del self._operations[name]
                if not name.startswith("#"):
                    self._ended[name] = at
        while len(self._ended) > self.most_ids:
            self._ended.popitem(last=False)


class Orders:
    """The table of verbs and the orders under way. Lives on the event loop.

    ``prove`` says who an order is from, and raises :class:`~zmav.errors.Forbidden` for one that is not to be looked at.
    ``permit`` is put before each handler. ``channel`` and ``verbs``: which orders these are; those of a vehicle unless
    said otherwise. An order of more than ``most`` bytes is not read. ``parts``: what else stands in the channel's keys.
    """

    def __init__(
        self,
        session: zenoh.Session,
        fleet: str,
        name: str,
        prove: Prove,
        answers: Answers,
        permit: Permit,
        channel: keys.Channel = keys.DO,
        verbs: Mapping[str, Verb] = VERBS,
        most: int = MOST_BYTES,
        parts: Mapping[str, str] = MappingProxyType({}),
        questions: Questions | None = None,
    ) -> None:
        self._session, self._fleet, self._name = session, fleet, name
        self._channel, self._known, self._most = channel, verbs, most
        self._parts = dict(parts)
        self._prove, self._permit = prove, permit
        self._own = questions is None
        self._questions = questions or Questions(session, answers, anybody)
        self._verbs: dict[str, tuple[type[wire.Order], Guarded]] = {}
        self.operations = Operations()
        self._proofs: collections.OrderedDict[bytes, Origin] = collections.OrderedDict()
        """digests of the last orders and their proofs; of the intake's thread"""
        self._outcomes = Outcomes(answers)
        self._answers: set[asyncio.Task[None]] = set()
        self._intake: Intake | None = None
        self._urgent, self._waiting = collections.deque[ProvenOrder](), collections.deque[ProvenOrder]()
        """that have come and were not looked at yet: those that make it safe, and others"""
        self._closed = False

    def add(self, verb: str, handler: Guarded) -> None:
        """Who does the work of a verb of the table."""
        known = self._known[verb]
        self._verbs[verb] = (known.args, self._permit(known, handler))

    def start(self) -> None:
        key = self._channel.key(self._fleet, self._name, **self._parts, verb="*")
        loop = asyncio.get_running_loop()
        lane = self._questions.channel(lambda query: self._look(query, loop), anybody, signed=True)
        refusals, wake = self._questions.channel(lambda query: iter(()), anybody), on_loop(loop, self._next)

        def sort(query: zenoh.Query) -> None:
            asked = str(query.key_expr)
            verb = self._known.get(_verb(asked))
            if self._closed or "*" in asked:
                query.drop()  # somebody looks around with a wildcard: that is no order
                return
            if verb is not None and self._only_looks(verb.name):
                self._questions.put(lane, query)
                return
            urgent = verb is not None and verb.access is Access.OPEN
            try:
                if not urgent:  # what makes it safe is done, whatever stands beside it
                    refuse_parameters(query)
                order = self._proven(query, asked)
            except ZmavError as e:  # said in the lane: who asked may not read
                self._questions.refuse(refusals, query, e)
                return
            line, most = (self._urgent, MOST_URGENT) if urgent else (self._waiting, MOST_WAITING)
            if len(line) < most:  # else it is asked again, as any order is that gets no answer
                line.append(order)
                wake()

        self._intake = Intake(self._session.declare_queryable, key, sort, MOST_WAITING)

    @property
    def under_way(self) -> int:
        """Orders that have not ended."""
        return len(self.operations.under_way)

    async def close(self) -> None:
        """End what is under way, and say so to the one who asked."""
        self._closed = True
        if self._intake is not None:
            self._intake.close()
        if self._own:
            self._questions.close()
        tasks = [operation.task for operation in self.operations.under_way]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, *self._answers, return_exceptions=True)
        await in_thread(self._outcomes.close)

    def _proven(self, query: zenoh.Query, asked: str) -> ProvenOrder:
        """An order and who gives it. On the intake's thread, so that no flood reaches the event loop."""
        size = 0 if query.payload is None else len(query.payload)
        if size > self._most:
            text = f"{size} bytes are too much for an order; at most {self._most} are read"
            raise BadInput(text, field="payload", value=size, expected=f"at most {self._most} bytes")
        payload, proof = query.payload.to_bytes() if query.payload else b"", attached(query)
        digest = hashlib.sha256(b"\0".join((asked.encode(), proof or b"", payload))).digest()
        try:
            origin = self._prove(asked, payload, proof)
        except Forbidden as e:
            # A relay may bring a copy before the order itself arrives: its giver is to hear what became of it.
            known = self._proofs.get(digest)
            if known is None or e.detail.get("reason") != "replayed":
                raise
            return ProvenOrder(query, asked, payload, known, repeated=e)
        if origin is not None:
            self._proofs[digest] = origin
            if len(self._proofs) > MOST_KEPT:
                self._proofs.popitem(last=False)
        return ProvenOrder(query, asked, payload, origin)

    def _next(self) -> None:
        self._accept((self._urgent or self._waiting).popleft())

    def _look(self, query: zenoh.Query, loop: asyncio.AbstractEventLoop) -> Steps:
        """An order that a viewer may give, in the lane of questions: so many at a time, and proven on its thread."""
        asked, payload = str(query.key_expr), query.payload.to_bytes() if query.payload else b""
        origin = self._prove(asked, payload, attached(query))
        yield (outcome := asyncio.run_coroutine_threadsafe(self._outcome(_verb(asked), payload, origin), loop))
        yield Reply(asked, wire.encode(outcome.result()))

    def _accept(self, order: ProvenOrder) -> None:
        if self._closed:
            order.query.drop()
            return
        answer = asyncio.get_running_loop().create_task(self._answer(order))
        self._answers.add(answer)
        answer.add_done_callback(self._answers.discard)

    async def _answer(self, order: ProvenOrder) -> None:
        outcome: wire.Outcome | ZmavError
        try:
            outcome = await self._outcome(_verb(order.key), order.payload, order.origin, order.repeated)
        except ZmavError as e:
            outcome = e
        self._outcomes.tell(order.origin.name if order.origin else "", order.query, order.key, outcome)

    async def _outcome(
        self, verb: str, payload: bytes, origin: Origin | None, repeated: Forbidden | None = None
    ) -> wire.Outcome:
        if verb not in self._verbs:
            known = ", ".join(sorted(self._verbs))
            raise BadInput(f"no order {verb!r}; there are {known}", field="verb", value=verb, expected=known)
        arguments, handler = self._verbs[verb]
        if len(payload) > self._most:
            text = f"{verb}: {len(payload)} bytes are too much for an order; at most {self._most} are read"
            raise BadInput(text, field="payload", value=len(payload), expected=f"at most {self._most} bytes")
        try:
            args = wire.decode(payload, arguments, what := f"{self._channel.name}/{verb}")
        except BadInput as e:
            try:
                question = wire.decode(payload, wire.Again, what)
            except BadInput:
                raise e from None
            return await _outcome_of(self.operations.find(verb, question.again, origin), question.wait)
        wire.refuse_repeated(payload, what)
        if repeated is not None and not self.operations.knows(args.id):
            raise repeated

        def begin(report: Report) -> Coroutine[Any, Any, dict[str, Any]]:
            if self._only_looks(verb):
                self._check_looking(verb, origin)
            return _run(handler, args, report, origin)

        operation = self.operations.once(verb, args.id, payload, origin, begin)
        return await _outcome_of(operation, args.wait if args.id else None)

    def _only_looks(self, verb: str) -> bool:
        """A viewer may give it."""
        return not {keys.VIEWER, keys.ANYONE}.isdisjoint(self._known[verb].writers)

    def _check_looking(self, verb: str, origin: Origin | None) -> None:
        looking = [op for op in self.operations.under_way if op.origin == origin and self._only_looks(op.verb)]
        if len(looking) >= MOST_LOOKING:
            text = f"{MOST_LOOKING} orders of yours are under way that only look: wait for one of them"
            raise Refused(text, reason="busy", verb=verb)


def _verb(key: str) -> str:
    return key.rpartition("/")[2]


async def _run(handler: Guarded, args: wire.Order, report: Report, origin: Origin | None) -> dict[str, Any]:
    return await handler(args, report, origin)


async def _outcome_of(operation: Operation, wait: float | None) -> wire.Outcome:
    """Its outcome within so many seconds, 5 at most; None: however long it takes."""
    await asyncio.wait({operation.task}, timeout=None if wait is None else min(max(wait, 0.0), 5.0))
    done = operation.task.done()
    result = _result(operation) if done else operation.progress
    return wire.Outcome(verb=operation.verb, status="done" if done else "running", took=operation.took, result=result)


def _result(operation: Operation) -> dict[str, Any]:
    if operation.task.cancelled():
        raise Refused(f"{operation.verb} was superseded by a later order or by the pilot", verb=operation.verb)
    error = operation.task.exception()
    if error is None:
        return operation.task.result()
    if isinstance(error, ZmavError):
        raise error
    raise ZmavError(f"{operation.verb} failed inside the agent: {error!r}") from error
