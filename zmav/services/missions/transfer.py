"""The mission protocol's transactions over the local link: upload, download, clear.

https://mavlink.io/en/services/mission.html. Every message is repeated until its answer comes; how long to wait for one
follows what answers took before. Only what is meant for us counts: a ground station may be at it on the same link.

A plan takes a round trip an item, and to wake the event loop for each would take longer than the autopilot does. So a
transaction is a generator, which goes on in the link's thread: it yields until when (monotonic seconds) it waits, and
is sent what was heard. Only where nothing came in time the event loop sends it None.
"""

from __future__ import annotations

import asyncio
import struct
import threading
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

from zmav.errors import Refused, TimedOut, Unsupported, VehicleError
from zmav.mavlink import Frame, decode
from zmav.mavlink.results import MissionResult
from zmav.services.link.port import Port, RoundTrip, is_ours, listening
from zmav.services.missions.items import KINDS, WORDS, Raw, raw_from
from zmav.wire import MissionKind

COMPLAINTS = 3
"""ACKs saying no that end a transaction in which nothing of ours was looked at yet: the first may be a late one"""
UPLOAD = ("MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK")
DOWNLOAD = ("MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_ACK")
CLEAR = ("MISSION_ACK",)
OPAQUE_ID = {"MISSION_COUNT": (5, 3), "MISSION_ACK": (4, 1), "MISSION_CURRENT": (6, 3)}
"""Where the ids of the plans lie in the payload, and how many of them: not every dialect knows these late fields"""

T = TypeVar("T")
Step = Callable[[int, int], None]
"""Told how many items of how many are through, in the link's thread"""
Heard = tuple[str, Mapping[str, Any]]
"""A message's name and fields"""
Waits = Generator[float, "Heard | None", T]
"""A transaction"""

COUNT = -1
"""stands before item 0: the answer to MISSION_COUNT is the request for that"""
NO_COMPLAINT = (MissionResult.ACCEPTED, MissionResult.INVALID_SEQUENCE)
OF_ALL = (MissionResult.DENIED, MissionResult.OPERATION_CANCELLED)
"""what refuses the transaction, and not an item of it"""


class _Sent:
    """What of a plan was sent, by item (COUNT: how many there are), and the last item of the plan that was ``asked``
    for: a request for one before it may come late, or twice.
    """

    def __init__(self) -> None:
        self._items: dict[int, tuple[float, int]] = {}
        self.asked = COUNT

    def note(self, seq: int) -> None:
        self._items[seq] = time.monotonic(), self.times(seq)[1] + 1

    def times(self, seq: int) -> tuple[float, int]:
        """When it was last sent, and how often."""
        return self._items.get(seq, (0.0, 0))

    @property
    def last(self) -> int:
        """The last item of the plan that was sent."""
        return max(self._items)

    def all(self, count: int) -> bool:
        """All ``count`` items were sent."""
        return len(self._items) == count + 1

    def whole(self, count: int) -> bool:
        """All ``count`` items were sent, and the last one was asked for: so those before it were not lost."""
        return self.asked == count - 1 and self.all(count)


@dataclass(frozen=True)
class TransferTimes:
    """How long to wait, in seconds."""

    reply: float = 0.7
    """for an answer, before it is known how long one takes"""
    shortest: float = 0.2
    longest: float = 1.5
    attempts: int = 15
    """times that one thing is said before the link is given up"""
    again: float = 1.0
    """before an autopilot that is busy with another's transaction is asked again"""
    busy: float = 12.0
    """for it to be done with that: a transaction nobody goes on with ends after eight seconds"""
    file: float = 3.0
    """for any answer of its file server, before items are asked for one by one"""


class Ended(NamedTuple):
    """How an upload ended: ``sure`` is False where only reading back can tell."""

    id: int | None
    sure: bool


class Download(NamedTuple):
    """A plan as it is on the autopilot, home included."""

    items: list[Raw]
    id: int | None


class Busy(Exception):
    """The autopilot is in another's transaction."""


class _OneOfMany(Exception):
    """One of several items under way was refused, from ``first`` on: which, only sending those one by one tells."""

    def __init__(self, first: int) -> None:
        super().__init__()
        self.first = first


def opaque_ids(frame: Frame, name: str) -> tuple[int | None, ...]:
    """The ids of plans in the frame of MISSION_COUNT, _ACK or _CURRENT (mission, fence, rally); None: it gives none."""
    start, count = OPAQUE_ID[name]
    payload = frame.payload.ljust(start + 4 * count, b"\0")
    return tuple(value or None for value in struct.unpack_from(f"<{count}I", payload, start))


class Transfer:
    """Transactions of one kind with the autopilot at ``source``. ``window``: how many items are under way at once."""

    def __init__(
        self, port: Port, source: tuple[int, int], kind: MissionKind, times: TransferTimes, window: int = 1
    ) -> None:
        self._port, self._source, self._kind, self._times, self._window = port, source, kind, times, window
        self._trip = RoundTrip(times.reply, times.shortest, times.longest)

    # The transactions.

    async def upload(self, items: Sequence[Raw], step: Step) -> Ended:
        """Send ``items`` (home included), which the autopilot asks for one by one.

        Raises :class:`Refused` or :class:`Unsupported` with the result and the item, or :class:`TimedOut`: what the
        autopilot then holds is not known.
        """
        try:
            return await self._patiently(UPLOAD, lambda: self._upload(items, step, len(items)))
        except _OneOfMany as e:
            first = e.first
        return await self._patiently(UPLOAD, lambda: self._upload(items, step, first))

    async def download(self, step: Step) -> Download:
        """Read the whole plan; begun again where it changes meanwhile. Raises as :meth:`upload` does."""
        for _ in range(3):
            found = await self._patiently(DOWNLOAD, lambda: self._download(step))
            if found is not None:
                return found
        raise Refused(f"the {self._words} keep changing while they are read", vehicle=self._port.name)

    async def clear(self) -> None:
        """Remove every item. Raises as :meth:`upload` does."""
        await self._patiently(CLEAR, self._clear)

    # How it is done.

    async def _patiently(self, names: Sequence[str], transaction: Callable[[], Waits[T]]) -> T:
        """Begin again for a while where the autopilot is busy with somebody else."""
        deadline = time.monotonic() + self._times.busy
        while True:
            try:
                return await self._run(names, transaction())
            except Busy:
                if time.monotonic() + self._times.again > deadline:
                    text = f"the autopilot is in somebody else's transaction of {self._words}: try again later"
                    raise Refused(text, vehicle=self._port.name, result="MAV_MISSION_DENIED") from None
                await asyncio.sleep(self._times.again)

    async def _run(self, names: Sequence[str], transaction: Waits[T]) -> T:
        over, turn, until = Future[T](), threading.Lock(), 0.0
        ended = asyncio.wrap_future(over)

        def go_on(frame: Frame | None) -> None:
            nonlocal until
            try:
                heard = None if frame is None else self._heard(frame)
                if frame is None or heard is not None:
                    until = transaction.send(heard)
            except StopIteration as end:
                over.set_result(end.value)
            except Exception as e:
                over.set_exception(e)

        def take(frame: Frame) -> None:
            with turn:
                if until and not over.done():
                    go_on(frame)

        try:
            with listening(self._port, self._source, names, take):
                while not ended.done():
                    with turn:
                        if not over.done() and time.monotonic() >= until:
                            go_on(None)
                    # What comes may bring the moment nearer.
                    await asyncio.wait({ended}, timeout=min(max(until - time.monotonic(), 0.0), self._times.shortest))
                return ended.result()
        finally:
            with turn:
                over.cancel()  # what still comes goes nowhere
            if not ended.cancel() and not ended.cancelled():
                ended.exception()  # it may have come with a cancellation: then nobody else looks at it

    def _heard(self, frame: Frame) -> Heard | None:
        """A message of this transaction."""
        name, fields = self._port.dialect.name_of(frame.msgid), decode(frame, self._port.dialect)
        if not is_ours(fields, self._port) or fields["mission_type"] != KINDS[self._kind]:
            return None
        return name, {**fields, "opaque_id": opaque_ids(frame, name)[0]} if name in OPAQUE_ID else fields

    def _upload(self, items: Sequence[Raw], step: Step, alone: int) -> Waits[Ended]:
        """From item ``alone`` on each is sent when it is asked for, and none before.

        Raises :class:`_OneOfMany` where ``alone`` is behind the last item, and no second time.
        """
        count, sent, complaints = len(items), _Sent(), 0
        last, tries = -1, 1
        unsent = 0  # the first item that was not sent yet, or that is to be sent again

        def end(seq: int) -> int:
            return max(min(seq + self._window, alone), seq + 1)

        self._send_count(count, sent)
        for _ in range((count + 1) * self._times.attempts):  # an autopilot that asks for ever is given up, too
            heard = yield time.monotonic() + self._trip.timeout
            if heard is not None and heard[0] == "MISSION_ACK":
                complaints += heard[1]["type"] not in NO_COMPLAINT
                if last >= 0 or heard[1]["type"] != MissionResult.ERROR or complaints >= COMPLAINTS:
                    ended = self._judge(heard[1], sent, count)
                    if isinstance(ended, Ended):
                        return ended
                    if ended is not None and (sent.last <= sent.asked or alone < count or heard[1]["type"] in OF_ALL):
                        raise ended
                    if ended is not None:  # it is of an item behind that one, where the request for it was lost
                        yield from self._quiet(4 * self._window)
                        raise _OneOfMany(sent.asked)
            elif heard is not None and heard[1]["seq"] < count:
                seq = heard[1]["seq"]
                again = seq <= last
                if seq != last:
                    self._learn(*sent.times(seq - 1))
                    last, tries, sent.asked = seq, 0, max(sent.asked, seq)
                    step(seq, count)
                tries += 1
                if not again:
                    unsent = self._send_items(items, max(seq, unsent), end(seq), sent)
                elif time.monotonic() - sent.times(seq)[0] >= self._trip.timeout:  # else it may still be on its way
                    unsent = self._send_items(items, seq, seq + 1, sent)  # those behind it when it has come
            elif heard is None:
                if sent.whole(count) and tries >= 4:
                    return Ended(None, sure=False)  # its last word was lost, and it says no other
                if tries >= self._times.attempts:
                    break
                tries += 1
                if last < 0:
                    self._send_count(count, sent)
                else:
                    unsent = self._send_items(items, last, end(last), sent)
        what = f"item {last} of {count} (home included)" if last >= 0 else "the number of items"
        raise TimedOut(
            f"upload of the {self._words}: the autopilot does not go on after {what}", vehicle=self._port.name
        )

    def _judge(self, ack: Mapping[str, Any], sent: _Sent, count: int) -> Ended | VehicleError | None:
        """What a MISSION_ACK says of an upload: its end, a refusal of the item asked for last, or None, nothing."""
        result = ack["type"]
        if result == MissionResult.ACCEPTED:
            if sent.whole(count):
                return Ended(ack["opaque_id"], sure=True)
            # It came before the request for the last item, or that was lost. But where not even one item was gone on
            # from, though a short plan is sent by then, it may be a late one, of some transaction before.
            return Ended(None, sure=False) if sent.all(count) and sent.asked > 0 else None
        if result == MissionResult.INVALID_SEQUENCE:
            return None  # an item came twice, or before one that was lost; ArduPilot says so and goes on
        if result == MissionResult.DENIED and sent.asked < 0:
            raise Busy
        if sent.all(count) and sent.times(count - 1)[1] > 1 and result == MissionResult.ERROR:
            return Ended(None, sure=False)  # what it does not want is the repeated last item: it had the first
        return self._refusal(result, sent.asked if sent.asked >= 0 else None)

    def _quiet(self, most: int) -> Waits[None]:
        """Let what is still on its way come, ``most`` messages of it: it is no answer to the next transaction."""
        for _ in range(most):
            if (yield time.monotonic() + self._trip.timeout) is None:
                return

    def _download(self, step: Step) -> Waits[Download | None]:
        count, opaque_id = yield from self._count()
        items: dict[int, Raw] = {}
        complaints = 0
        asked: dict[int, tuple[float, int]] = {}  # by item: when it was last asked for, and how often
        while len(items) < count:
            self._ask(count, items, asked)
            heard = yield min(at for at, _ in asked.values()) + self._trip.timeout
            if heard is None:
                continue
            name, fields = heard
            if name == "MISSION_ITEM_INT" and fields["seq"] in asked:
                items[fields["seq"]] = raw_from(fields)
                self._learn(*asked.pop(fields["seq"]))
                step(len(items), count)
            elif name == "MISSION_COUNT" and fields["count"] != count:
                return None
            elif name == "MISSION_ACK" and fields["type"] == MissionResult.DENIED:
                raise Busy
            elif name == "MISSION_ACK" and fields["type"] not in NO_COMPLAINT:
                complaints += 1
                if complaints >= COMPLAINTS:
                    raise self._refusal(fields["type"], min(asked))
        self._send("MISSION_ACK", type=MissionResult.ACCEPTED)
        return Download([items[i] for i in range(count)], opaque_id)

    def _count(self) -> Waits[tuple[int, int | None]]:
        for attempt in range(1, self._times.attempts + 1):
            asked = time.monotonic()
            self._send("MISSION_REQUEST_LIST")
            while (heard := (yield asked + self._trip.timeout)) is not None:
                name, fields = heard
                if name == "MISSION_COUNT":
                    self._learn(asked, attempt)
                    return fields["count"], fields["opaque_id"]
                if name == "MISSION_ACK" and fields["type"] == MissionResult.DENIED:
                    raise Busy
                if name == "MISSION_ACK" and fields["type"] == MissionResult.UNSUPPORTED:
                    raise self._refusal(MissionResult.UNSUPPORTED, None)
        raise TimedOut(f"download of the {self._words}: the autopilot does not answer", vehicle=self._port.name)

    def _ask(self, count: int, items: Mapping[int, Raw], asked: dict[int, tuple[float, int]]) -> None:
        """Ask for the next items as far as the window goes, and again for those that are late."""
        now = time.monotonic()
        for seq, (at, tries) in asked.items():
            if now - at >= self._trip.timeout:
                if tries >= self._times.attempts:
                    text = f"download of the {self._words}: item {seq} of {count} (home included) does not come"
                    raise TimedOut(text, vehicle=self._port.name)
                asked[seq] = now, tries + 1
                self._send("MISSION_REQUEST_INT", seq=seq)
        first = len(items) + len(asked)  # they are asked for in order, and what was not asked for is not taken
        for seq in range(first, min(len(items) + self._window, count)):
            asked[seq] = now, 1
            self._send("MISSION_REQUEST_INT", seq=seq)

    def _clear(self) -> Waits[None]:
        for attempt in range(1, self._times.attempts + 1):
            asked = time.monotonic()
            self._send("MISSION_CLEAR_ALL")
            heard = yield asked + self._trip.timeout
            if heard is None:
                continue
            self._learn(asked, attempt)
            result = heard[1]["type"]
            if result == MissionResult.ACCEPTED:
                return
            if result == MissionResult.DENIED:
                raise Busy
            raise self._refusal(result, None)
        raise TimedOut(f"clearing the {self._words}: the autopilot does not answer", vehicle=self._port.name)

    # What goes out and comes in.

    @property
    def _words(self) -> str:
        return WORDS[self._kind]

    def _send(self, name: str, **fields: Any) -> None:
        system, component = self._source
        kind = KINDS[self._kind]
        self._port.send(name, target_system=system, target_component=component, mission_type=kind, **fields)

    def _send_count(self, count: int, sent: _Sent) -> None:
        sent.note(COUNT)
        self._send("MISSION_COUNT", count=count)

    def _send_items(self, items: Sequence[Raw], first: int, end: int, sent: _Sent) -> int:
        """Send those from ``first`` up to but not including ``end``, as far as there are; gives the next one."""
        end = min(end, len(items))
        for seq in range(first, end):
            sent.note(seq)
            self._send("MISSION_ITEM_INT", seq=seq, **items[seq].fields())
        return end

    def _learn(self, asked: float, tries: int) -> None:
        """Of a repeated question nobody can tell which was answered."""
        if tries == 1:
            self._trip.sample(time.monotonic() - asked)

    def _refusal(self, result: int, item: int | None) -> Refused | Unsupported:
        item = None if result in OF_ALL else item
        name = self._port.dialect.enum_name("MAV_MISSION_RESULT", result) or str(result)
        kind = Unsupported if result == MissionResult.UNSUPPORTED and item is None else Refused
        return kind(name, vehicle=self._port.name, result=name, seq=item, plan=self._kind)
