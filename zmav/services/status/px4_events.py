"""PX4's events in words: their file is fetched while disarmed, and the health and arming checks among them are kept.

https://mavlink.io/en/services/events.html. A report of the checks is a summary, an event for each check that fails, and
another summary; PX4 sends one when something has changed, or when it is asked for.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

from zmav.autopilots import Autopilot
from zmav.errors import Refused, Stale, TimedOut, VehicleError, ZmavError
from zmav.mavlink import Frame
from zmav.mavlink.event import (
    APPENDS_CHECKS,
    CHECK_GROUPS,
    MOST_PACKED,
    SUMMARY,
    Event,
    EventWords,
    Worded,
    read_event,
    whole,
)
from zmav.services.companion import Companion
from zmav.services.files.files import Files
from zmav.services.orders.command import Commander
from zmav.services.status.events import SEVERITIES

EVERY = 1.0
AGAIN, ATTEMPTS = 30.0, 3
"""s until the file is asked for again where no answer came, and how often"""
ASK_EVERY, ASKS = 5.0, 3
"""s between requests for a report of the checks, and how many while none comes"""
ERROR = 3
"""the mildest log level of a check that stands against something; those beyond it warn"""
EVERY_MODE = 0xFFFFFFFF
MOST_CHECKS, MOST_SAID = 64, 5


class Checks:
    """The last whole report of an autopilot's health and arming checks."""

    def __init__(self) -> None:
        self.known = False
        """a report has come, and nothing was lost since"""
        self._chunks: dict[int, tuple[int, list[Worded]]] = {}
        self._coming: tuple[int, int, list[Worded]] | None = None
        self._told: set[tuple[int, int, bytes]] = set()

    def lost(self) -> None:
        """Some events did not come: the report under way is not whole, and one may have been missed."""
        self.known, self._coming = False, None

    def hear(self, worded: Worded) -> bool:
        """Take in an event of the groups of checks; True: a check that did not fail before."""
        values = worded.values
        if worded.type == SUMMARY:
            if worded.group == "arming_check" and len(values) >= 5:
                self._coming = whole(values[0]), whole(values[3]), []
            elif worded.group == "health" and self._coming and values and whole(values[0]) == self._coming[0]:
                self._chunks[self._coming[0]] = self._coming[1:]
                self._told = {_key(each) for _, failing in self._chunks.values() for each in failing}
                self.known, self._coming = True, None
            return False
        if self._coming and values and len(self._coming[2]) < MOST_CHECKS:
            self._coming[2].append(worded)
        new = _key(worded) not in self._told
        if len(self._told) < MOST_CHECKS:
            self._told.add(_key(worded))
        return new

    def against(self, mode: int | None) -> list[str]:
        """What stands against arming in the mode of that bit (None: in any), the gravest alone; empty: nothing."""
        if mode is not None and self._chunks and all(can_arm & mode for can_arm, _ in self._chunks.values()):
            return []
        failing = [check for _, checks in self._chunks.values() for check in checks]
        found = [check for check in failing if mode is None or whole(check.values[0]) & mode]
        # A check that stands against nothing, and only informs, is told for every mode.
        grave = [check for check in found if check.event.level <= ERROR]
        grave = grave or [check for check in found if check.values[0] != EVERY_MODE] or found
        return list(dict.fromkeys(check.text for check in grave))[:MOST_SAID]


class EventText(NamedTuple):
    """What an EVENT comes to."""

    text: str
    name: str = ""
    reason: bool = True
    """it may be why an order is refused"""


class EventTexts:
    """Passes EVENTs (410) on, in words once their file has come. Lives on the event loop."""

    def __init__(self, companion: Companion, commander: Commander, files: Files) -> None:
        self._identity, self._do, self._events, self._files = companion.identity, commander, companion.events, files
        self.words: EventWords | None = None
        self.checks = Checks()
        self._of: tuple[Any, ...] | None = None
        """the autopilot whose words they are, or that has none"""
        self._sure = False
        """it was not silent since: it has the firmware that it had"""
        self._attempts, self._again = 0, 0.0
        self._asks, self._asked = 0, 0.0
        self._task: asyncio.Task[None] | None = None
        self._sequences: dict[tuple[int, int], int] = {}

    def start(self) -> None:
        self._task = asyncio.get_running_loop().create_task(self._work())

    async def close(self) -> None:
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait({self._task})

    def against_arming(self) -> list[str]:
        """What the last report has against arming in the present mode; empty: nothing, or none came."""
        heartbeat = self._identity.heartbeat
        if self.words is None or heartbeat is None:
            return []
        return self.checks.against(self.words.mode_bit(heartbeat["custom_mode"]))

    # What is heard.

    def numbered(self, frame: Frame) -> None:
        """Pass on an EVENT, each once."""
        event, source = read_event(frame), (frame.sysid, frame.compid)
        before = self._sequences.get(source)
        if event is None or before == event.sequence:
            return  # none, or sent again for somebody else who missed it
        self._sequences[source] = event.sequence
        missed = (event.sequence - before - 1) & 0xFFFF if before is not None else 0
        missed = missed if missed < 0x8000 else 0
        said = self._text(event, missed)
        if said is None or not event.for_people:
            return
        if said.reason:
            self._events.remember(said.text)
        detail: dict[str, Any] = {"component": frame.compid, "id": event.id, "sequence": event.sequence}
        detail |= ({"missed": missed} if missed else {}) | ({"name": said.name} if said.name else {})
        self._events.emit("numbered", SEVERITIES[event.level], said.text, **detail, arguments=event.arguments.hex())

    def _text(self, event: Event, missed: int) -> EventText | None:
        """What to say of it, given how many before it were lost; None: nothing."""
        if missed:
            self.checks.lost()
        worded = self.words.of(event) if self.words else None
        if worded is None:
            return EventText(str(event))
        if worded.group in CHECK_GROUPS:
            new = self.checks.hear(worded)
            return EventText(worded.text, worded.name, reason=False) if new else None
        text = worded.text
        if worded.type == APPENDS_CHECKS and self.words and worded.values:
            reasons = self.checks.against(self.words.mode_bit(whole(worded.values[0])))
            text = ": ".join([text.rstrip(": "), *(["; ".join(reasons)] if reasons else [])])
        return EventText(text, worded.name)

    # What is asked for.

    async def _work(self) -> None:
        while True:
            try:
                await self._step()
            except Exception as e:  # what a damaged file brings must not end this
                self._events.emit("fault", "error", f"words of events: {e!r}", limit="event words")
                self._again = time.monotonic() + AGAIN
            await asyncio.sleep(EVERY)

    async def _step(self) -> None:
        who = self._identity
        of = who.source, who.uid, who.firmware
        if not who.connected or who.autopilot is None or not who.autopilot.events_file or of[1:] == (None, None):
            self._attempts, self._sure = 0, False
            return
        now = time.monotonic()
        if self._of not in (None, of):
            self.words, self.checks, self._of = None, Checks(), None
        if self._of is None or not self._sure:
            if not who.armed and (now >= self._again or not self._attempts):  # the line is the flight's
                await self._fetch(who.autopilot, of)
        elif self.words and not self.checks.known and not who.armed and now - self._asked > ASK_EVERY:
            await self._ask(who.autopilot)

    async def _fetch(self, autopilot: Autopilot, of: tuple[Any, ...]) -> None:
        self.words, self.checks = None, Checks()
        self._attempts, self._asks = self._attempts + 1, 0
        try:
            data = await self._files.small(autopilot.events_file, MOST_PACKED, lambda news: None)
            self.words = await asyncio.to_thread(EventWords.unpack, data)
        except ZmavError as e:
            self._again = time.monotonic() + AGAIN
            if isinstance(e, TimedOut | Stale) and self._attempts < ATTEMPTS:
                return
            text = f"{autopilot.name}'s events come by number, without words: {e.message}"
            self._events.emit("autopilot", "notice", text, path=autopilot.events_file)
        self._of, self._sure = of, True

    async def _ask(self, autopilot: Autopilot) -> None:
        """Have it report its checks: it did so before we were here, or some of it was lost."""
        self._asked = time.monotonic()
        if autopilot.report_checks is None or self._asks >= ASKS:
            return
        self._asks += 1
        with contextlib.suppress(VehicleError):
            await self._do.command(autopilot.report_checks)


def with_reasons(refusal: Refused, checks: Sequence[str]) -> Refused:
    """The refusal with what stands against arming, as far as it does not say so itself."""
    more = [check for check in checks if check not in refusal.message]
    if not more:
        return refusal
    reasons = [*refusal.detail.get("reasons", ()), *more]
    return Refused(f"{refusal.message}: {'; '.join(more)}", **{**refusal.detail, "reasons": reasons})


def _key(check: Worded) -> tuple[int, int, bytes]:
    return check.event.id, check.event.level, check.event.arguments
