"""PX4's events in words, and the health and arming checks among them.

https://mavlink.io/en/services/events.html. A report of the checks is a summary, an event for each check that fails, and
another summary; PX4 sends one when something has changed, or when it is asked for.
"""

from __future__ import annotations

import asyncio
import contextlib
import struct
import time
from collections.abc import Sequence
from typing import Any

from zmav.autopilots.px4_events import (
    ARMING_SUMMARY,
    CHECKS,
    EVENTS,
    HEALTH_SUMMARY,
    MODE_BITS,
    WITH_CHECKS,
    event_text,
)
from zmav.errors import Refused, ZmavError
from zmav.mavlink import Frame
from zmav.mavlink.event import Event, read_event
from zmav.services.companion import Companion
from zmav.services.orders.command import Commander
from zmav.services.status.events import SEVERITIES

ASKS = 3
"""requests while none comes"""
ERROR = 3
"""the mildest log level of a check that stands against something; those beyond it warn"""
EVERY_MODE = 0xFFFFFFFF
MOST_CHECKS, MOST_REASONS = 64, 5
_SUMMARY, _CHECK, _MODE = struct.Struct("<BIII"), struct.Struct("<I"), struct.Struct("<I")
"""what the arguments begin with: chunk, components in error and in warning, modes to arm in; modes; the custom mode"""


class Checks:
    """The last whole report of an autopilot's health and arming checks."""

    def __init__(self) -> None:
        self.known = False
        """a report has come, and nothing was lost since"""
        self._chunks: dict[int, tuple[int, list[Event]]] = {}
        self._coming: tuple[int, int, list[Event]] | None = None
        self._heard: set[tuple[int, int, bytes]] = set()

    @property
    def coming(self) -> bool:
        """A report has begun and not ended: what comes now and is nothing else is a check."""
        return self._coming is not None

    def lose(self) -> None:
        """Some events did not come: the report under way is not whole, and one may have been missed."""
        self.known, self._coming = False, None

    def hear(self, event: Event) -> bool:
        """Take in a summary or a check; True: a check that did not fail before."""
        if event.id == ARMING_SUMMARY:
            chunk, _, _, can_arm = _SUMMARY.unpack_from(event.arguments)
            self._coming = chunk, can_arm, []
            return False
        if event.id == HEALTH_SUMMARY:
            if self._coming and event.arguments[0] == self._coming[0]:
                self._chunks[self._coming[0]] = self._coming[1:]
                self._heard = {_key(each) for _, failing in self._chunks.values() for each in failing}
                self.known = True
            self._coming = None
            return False
        if self._coming and len(self._coming[2]) < MOST_CHECKS:
            self._coming[2].append(event)
        new = _key(event) not in self._heard
        if len(self._heard) < MOST_CHECKS:
            self._heard.add(_key(event))
        return new

    def against(self, mode: str | None) -> list[str]:
        """What stands against arming in that mode (None or not known: in any), the gravest alone; empty: nothing."""
        bit = 1 << MODE_BITS[mode] if mode is not None and mode in MODE_BITS else None
        if bit is not None and self._chunks and all(can_arm & bit for can_arm, _ in self._chunks.values()):
            return []
        modes = [(check, _CHECK.unpack_from(check.arguments)[0]) for _, each in self._chunks.values() for check in each]
        found = [(check, of) for check, of in modes if bit is None or of & bit]
        # A check that stands against nothing, and only informs, names every mode.
        grave = [check for check, _ in found if check.level <= ERROR]
        grave = grave or [check for check, of in found if of != EVERY_MODE] or [check for check, _ in found]
        return list(dict.fromkeys(_words(check)[1] for check in grave))[:MOST_REASONS]


class EventTexts:
    """Passes EVENTs (410) on, in words where there are some for them. Lives on the event loop."""

    every = 1.0
    ask_every = 5.0
    """s between requests for a report of the checks"""

    def __init__(self, companion: Companion, commander: Commander) -> None:
        self._identity, self._do, self._events = companion.identity, commander, companion.events
        self.checks = Checks()
        self._task: asyncio.Task[None] | None = None
        self._sequences: dict[tuple[int, int], int] = {}

    def start(self) -> None:
        self._task = asyncio.get_running_loop().create_task(self._ask_for_reports())

    async def close(self) -> None:
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait({self._task})

    def against_arming(self) -> list[str]:
        """What the last report has against arming in the present mode; empty: nothing, or none came."""
        return self.checks.against(self._identity.mode)

    def numbered(self, frame: Frame) -> None:
        """Pass on an EVENT, each once."""
        event, source = read_event(frame), (frame.sysid, frame.compid)
        before = self._sequences.get(source)
        if event is None or before == event.sequence:
            return  # none, or sent again for somebody else who missed it
        self._sequences[source] = event.sequence
        missed = (event.sequence - before - 1) & 0xFFFF if before is not None else 0
        missed = missed if missed < 0x8000 else 0
        if missed:
            self.checks.lose()
        name, text = _words(event)
        if event.id in (ARMING_SUMMARY, HEALTH_SUMMARY) or self._is_check(event):
            if not self.checks.hear(event) or not event.for_people:
                return
        elif not event.for_people:
            return
        else:
            text = self._with_checks(event, text)
            self._events.remember(text)  # it may be why an order is refused
        detail: dict[str, Any] = {"component": frame.compid, "id": event.id, "sequence": event.sequence}
        detail |= ({"missed": missed} if missed else {}) | ({"name": name} if name else {})
        self._events.emit("numbered", SEVERITIES[event.level], text, **detail, arguments=event.arguments.hex())

    def _is_check(self, event: Event) -> bool:
        return event.id in CHECKS or (self.checks.coming and event.id not in EVENTS)

    def _with_checks(self, event: Event, text: str) -> str:
        autopilot = self._identity.autopilot
        if event.id not in WITH_CHECKS or autopilot is None:
            return text
        reasons = self.checks.against(autopilot.mode_name(0, _MODE.unpack_from(event.arguments)[0]))
        return f"{text}: {'; '.join(reasons)}" if reasons else text

    async def _ask_for_reports(self) -> None:
        """While none has come: it reported before we were here, or some of it was lost. Not in flight."""
        asks, asked = 0, 0.0
        while True:
            await asyncio.sleep(self.every)
            who, now = self._identity, time.monotonic()
            if not who.connected or who.autopilot is None:
                self.checks, asks = Checks(), 0  # it may come back as another
            elif self.checks.known:
                asks = 0
            elif who.armed or asks >= ASKS or now - asked < self.ask_every:
                continue
            elif who.autopilot.report_checks is not None:
                asks, asked = asks + 1, now
                with contextlib.suppress(ZmavError):
                    await self._do.command(who.autopilot.report_checks)


def with_reasons(refusal: Refused, checks: Sequence[str]) -> Refused:
    """The refusal with what stands against arming, as far as it does not say so itself."""
    more = [check for check in checks if check not in refusal.message]
    if not more:
        return refusal
    reasons = [*refusal.detail.get("reasons", ()), *more]
    return Refused(f"{refusal.message}: {'; '.join(more)}", **{**refusal.detail, "reasons": reasons})


def _words(event: Event) -> tuple[str, str]:
    """Its name and its text; without a name where there are no words for it."""
    if event.id in EVENTS:
        return EVENTS[event.id][0], event_text(event.id, event.arguments)
    return CHECKS.get(event.id) or ("", str(event))


def _key(check: Event) -> tuple[int, int, bytes]:
    return check.id, check.level, check.arguments
