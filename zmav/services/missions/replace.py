"""One plan put in the place of another, or the other one put back.

ArduPilot overwrites items as they arrive, so a transfer that ends in the middle leaves a mixture of two plans. Hence
the old plan is kept until the new one is known to be there, and is restored where it is not.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from zmav.errors import Refused, VehicleError, ZmavError
from zmav.services.missions.items import HOME, WORDS, Items, Raw, same
from zmav.services.missions.transfer import Download, Step, Transfer
from zmav.services.status.events import Events
from zmav.wire import MissionKind

Phase = Callable[[str], Step]
"""Gives what is told how far a part of the work is"""


class Replaced(NamedTuple):
    """What is on the autopilot ``now``, and ``how`` that is known; ``notes``: parameters not kept as they were sent."""

    now: Download
    notes: list[str]
    how: str


class NotReplaced(Exception):
    """The new plan is not in force: ``error`` says why and what is; ``now`` is what is there, where that is known."""

    def __init__(self, error: VehicleError, now: Download | None) -> None:
        super().__init__(error.message)
        self.error, self.now = error, now


class Replacer:
    """Replaces plans of one kind by ``transfer``. ``exact``: the autopilot keeps every parameter as it was sent."""

    def __init__(
        self, transfer: Transfer, items: Items, kind: MissionKind, events: Events, phase: Phase, exact: bool
    ) -> None:
        self._transfer, self._items, self._kind = transfer, items, kind
        self._events, self._phase, self._exact = events, phase, exact

    async def replace(self, old: Download, new: Sequence[Raw]) -> Replaced:
        """Put ``new`` (without home) where ``old`` (as it was downloaded) is; raises :class:`NotReplaced`."""
        full = self._with_home(old, new)
        since = time.monotonic()
        try:
            return await self._put(full, "uploading")
        except VehicleError as e:
            return await self._recover(self._explained(e, full, since), old, full)

    async def restore(self, old: Download, full: Sequence[Raw]) -> tuple[Download, str]:
        """After a failure: read what is there, and put ``old`` back where it is neither plan. What is there now, and
        which that is: ``new``, ``old`` or ``restored``; raises :class:`VehicleError`.
        """
        now = await self._transfer.download(self._phase("reading what is there"))
        if same(self._items, self._kind, now.items, full, self._exact):
            return now, "new"
        if same(self._items, self._kind, now.items, old.items, self._exact):
            return now, "old"
        return (await self._put(old.items, "restoring")).now, "restored"

    # How it is done.

    def _with_home(self, old: Download, new: Sequence[Raw]) -> list[Raw]:
        if not new or not self._items.offset(self._kind):
            return list(new)
        return [old.items[0] if old.items else HOME, *new]

    async def _put(self, full: Sequence[Raw], phase: str) -> Replaced:
        """Send it and make sure that it is there; nothing, or home alone, is put by clearing."""
        if len(full) <= self._items.offset(self._kind):
            await self._transfer.clear()
        else:
            ended = await self._transfer.upload(full, self._phase(phase))
            if ended.sure and ended.id is not None:
                return Replaced(Download(list(full), ended.id), [], "opaque id")
        found = await self._transfer.download(self._phase("reading back"))
        return Replaced(found, self._compare(full, found.items), "read back")

    def _compare(self, sent: Sequence[Raw], kept: Sequence[Raw]) -> list[str]:
        """The parameters kept otherwise; raises :class:`Refused` where it is not the plan that was sent."""
        start = self._items.offset(self._kind)
        if max(len(sent) - start, 0) != max(len(kept) - start, 0):
            counts = f"{max(len(kept) - start, 0)} items instead of {max(len(sent) - start, 0)}"
            raise Refused(f"the autopilot took the {WORDS[self._kind]}, but keeps {counts}")
        wrong, notes = [], []
        for i, (one, other) in enumerate(zip(sent[start:], kept[start:], strict=True)):
            place, params = self._items.differences(self._kind, one, other)
            wrong += [f"item {i}: {each}" for each in place + (params if self._exact else [])]
            notes += [f"item {i}: {each}" for each in params]
        if wrong:
            raise Refused(f"the autopilot took the {WORDS[self._kind]}, but keeps it otherwise: {_few(wrong)}")
        return notes

    def _explained(self, error: VehicleError, full: Sequence[Raw], since: float) -> VehicleError:
        """A refusal in words: the item as its sender counts, its command, and what the autopilot said."""
        # What was sent a second time to learn which item it is was refused with the same words.
        seq, reasons = error.detail.get("seq"), list(dict.fromkeys(self._events.texts_since(since)))
        if "result" not in error.detail:
            return error
        item = seq - self._items.offset(self._kind) if seq is not None else None
        what = f"the {WORDS[self._kind]}" if seq is None else "home" if item == -1 else f"item {item}"
        command = f" ({self._items.name(full[seq])})" if seq is not None else ""
        why = f" ({'; '.join(reasons)})" if reasons else ""
        result = error.detail["result"]
        text = f"the autopilot refused {what}{command}: {result}{why}"
        return type(error)(text, result=result, item=item, reasons=reasons)

    async def _recover(self, error: VehicleError, old: Download, full: Sequence[Raw]) -> Replaced:
        words, count = WORDS[self._kind], max(len(old.items) - self._items.offset(self._kind), 0)
        now: Download | None
        try:
            now, which = await self.restore(old, full)
        except ZmavError as e:
            what = "not known, maybe a mixture of old and new; it is put right once the autopilot answers again"
            raise NotReplaced(self._said(error, f"in force: {what} ({e.message})", "unknown"), None) from error
        if which == "new":
            return Replaced(now, [], "read back")
        kept = "untouched" if which == "old" else "restored"
        told = self._said(error, f"in force: the old {words} ({count} items), {kept}", "old")
        raise NotReplaced(told, now) from error

    def _said(self, error: VehicleError, more: str, in_force: str) -> VehicleError:
        detail: dict[str, Any] = {**error.detail, "plan": self._kind, "in_force": in_force}
        return type(error)(f"{error.message}; {more}", **detail)


def _few(words: Sequence[str]) -> str:
    return "; ".join(words[:5]) + (f"; and {len(words) - 5} more" if len(words) > 5 else "")
