"""Reading the whole set: PARAM_REQUEST_LIST, then what is missing by its index, a few at a time.

How fast the link is shows in what arrives. While anything does, nothing is asked for twice; a question counts as lost
by the round trips measured on this link; and with ten questions open at most (370 bytes of answers) neither a
57,600-baud radio nor the commands beside us have to wait. https://mavlink.io/en/services/parameter.html
"""

from __future__ import annotations

import collections
import time

from zmav.errors import LinkDown, TimedOut
from zmav.services.link.identity import HEARTBEAT_TIMEOUT
from zmav.services.params.requests import Inbox, ParamTalk
from zmav.services.params.values import NO_INDEX, ParamValue

LISTS = 3
LIST_TRIES = 6
LIST_TIMEOUT = 1.0
"""s for the first answer to PARAM_REQUEST_LIST; half as long again each time"""
QUIET = (0.5, 3.0)
"""s: bounds of how long a stream is silent before it is over"""
WINDOW = 10
INDEX_TRIES = 25
SILENCE = 15.0
"""s without any PARAM_VALUE after which a reading is given up"""
RESTARTS = 4
"""times the autopilot may change its count or order before a reading is given up"""


class Moved(Exception):
    """The count or the order of the parameters changed: begin again."""


class ParamFill:
    """One reading of all parameters into ``talk.params``. Lives on the event loop; run it once."""

    def __init__(self, talk: ParamTalk, name: str) -> None:
        self._talk, self._params, self._name = talk, talk.params, name
        self._restarts = 0

    async def run(self) -> None:
        """Raises :class:`TimedOut` naming how far it came, :class:`Stale` when the autopilot falls silent."""
        params = self._params
        for _ in range(RESTARTS + 1):
            params.begin()
            self._restarts = params.restarts
            try:
                with self._talk.hearing() as inbox:
                    await self._streams(inbox)
                    await self._gaps(inbox)
            except Moved:
                continue
            if not params.whole:
                raise self._late(f"{len(params.missing)} of {params.count} parameters do not come")
            params.end()
            return
        raise self._late("the number or the order of the parameters changes all the time")

    async def _streams(self, inbox: Inbox) -> None:
        """The list, and the list again where it is so fast, and so much was lost, that single questions take longer."""
        for _ in range(LISTS):
            took = await self._stream(inbox)
            one_by_one = 1.5 * len(self._params.missing) * self._talk.pace.timeout / WINDOW
            if one_by_one <= took + self._talk.pace.timeout:
                return

    async def _stream(self, inbox: Inbox) -> float:
        """Ask for the list and take in what comes until its last index, or until it falls silent; seconds it took."""
        arrivals, asked, timeout, deadline, began = Arrivals(), 0, LIST_TIMEOUT, 0.0, 0.0
        while True:
            now = time.monotonic()
            if not arrivals.count and now >= deadline:
                self._ask_list(asked)
                began, asked, deadline, timeout = now, asked + 1, now + timeout, 1.5 * timeout
            answer = await inbox.get((arrivals.over_at if arrivals.count else deadline) - now)
            self._check()
            if isinstance(answer, ParamValue) and answer.index != NO_INDEX:
                if not arrivals.count and asked == 1:
                    self._talk.pace.sample(time.monotonic() - began)
                arrivals.add()
                if self._at_the_end(answer):
                    return time.monotonic() - began
            elif answer is None and arrivals.count:
                return time.monotonic() - began

    def _ask_list(self, asked: int) -> None:
        if asked >= LIST_TRIES:
            raise self._late(f"no PARAM_VALUE after {asked} times PARAM_REQUEST_LIST")
        if not self._talk.send("PARAM_REQUEST_LIST") and not asked:
            raise LinkDown(f"{self._name}: nothing can be sent on the link", vehicle=self._name)

    def _at_the_end(self, heard: ParamValue) -> bool:
        """The last of the stream; with most still missing it was the answer to somebody's question."""
        missing = len(self._params.missing)
        return not missing or (heard.index == heard.count - 1 and 2 * missing < heard.count)

    async def _gaps(self, inbox: Inbox) -> None:
        """Ask for each missing index until it comes, or PARAM_ERROR says why it does not."""
        pace, waiting = self._talk.pace, collections.deque(sorted(self._params.missing))
        asked: dict[int, float] = {}
        tries: collections.Counter[int] = collections.Counter()
        last = time.monotonic()
        while True:
            now = time.monotonic()
            lost = [index for index, at in asked.items() if now - at >= pace.timeout]
            if lost and last < min(asked[index] for index in lost):
                pace.late()
            for index in lost:
                del asked[index]
                waiting.append(index)
            self._ask(waiting, asked, tries)
            if not asked:
                return
            answer = await inbox.get(min(asked.values()) + pace.timeout - time.monotonic())
            self._check()
            if answer is None or answer.index not in asked:
                if time.monotonic() - last > SILENCE:
                    raise self._late(f"silent, with {len(self._params.missing)} of {self._params.count} missing")
                continue
            at = asked.pop(answer.index)
            last = time.monotonic()
            if isinstance(answer, ParamValue) and tries[answer.index] == 1:
                pace.sample(last - at)

    def _ask(self, waiting: collections.deque[int], asked: dict[int, float], tries: collections.Counter[int]) -> None:
        """Put questions until the window is full."""
        while waiting and len(asked) < WINDOW:
            index = waiting.popleft()
            if index in self._params.missing and tries[index] < INDEX_TRIES:
                tries[index] += 1
                asked[index] = time.monotonic()
                self._talk.send("PARAM_REQUEST_READ", param_index=index)

    def _check(self) -> None:
        self._talk.check(heard_within=HEARTBEAT_TIMEOUT)
        if self._params.restarts != self._restarts:
            raise Moved

    def _late(self, why: str) -> TimedOut:
        params = self._params
        return TimedOut(f"{self._name}: {why}", vehicle=self._name, count=params.count, received=params.received)


class Arrivals:
    """When the next of a stream is overdue, by the pace of those before."""

    def __init__(self) -> None:
        self.count = 0
        self._last = self._gap = 0.0

    def add(self) -> None:
        now = time.monotonic()
        if self.count:
            self._gap += (now - self._last - self._gap) / min(self.count, 16)
        self._last = now
        self.count += 1

    @property
    def over_at(self) -> float:
        """Monotonic seconds."""
        least, most = QUIET
        return self._last + min(max(8 * self._gap, least), most)
