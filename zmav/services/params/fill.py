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

QUIET = 1.5
"""s of silence after which a stream is over"""
WINDOW = 10
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
                    await self._stream(inbox)
                    await self._gaps(inbox)
            except Moved:
                continue
            if not params.whole:
                raise self._late(f"{len(params.missing)} of {params.count} parameters do not come")
            params.end()
            return
        raise self._late("the number or the order of the parameters changes all the time")

    async def _stream(self, inbox: Inbox) -> None:
        """Ask for the list and take in what comes until its last index, or until it falls silent."""
        asked, timeout, deadline, began, came = 0, self._talk.list_timeout, 0.0, 0.0, False
        while True:
            now = time.monotonic()
            if not came and now >= deadline:
                self._ask_list(asked)
                began, asked, deadline, timeout = now, asked + 1, now + timeout, 1.5 * timeout
            answer = await inbox.get(deadline - now)
            self._check()
            if isinstance(answer, ParamValue) and answer.index != NO_INDEX:
                if not came and asked == 1:
                    self._talk.pace.sample(time.monotonic() - began)
                came, deadline = True, time.monotonic() + QUIET
                if self._at_the_end(answer):
                    return
            elif answer is None and came:
                return

    def _ask_list(self, asked: int) -> None:
        if asked >= self._talk.list_tries:
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
            if index in self._params.missing and tries[index] < self._talk.index_tries:
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
