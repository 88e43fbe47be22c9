"""Setting many parameters, a few at a time; one that fails does not stop the others."""

from __future__ import annotations

import collections

from zmav import wire
from zmav.errors import ZmavError
from zmav.mavlink import paramvalue
from zmav.services.orders.orders import Report
from zmav.services.params.requests import ParamTalk
from zmav.services.params.values import is_name
from zmav.waiting import together

AT_ONCE = 4


class ParamLoader:
    """Lives on the event loop."""

    def __init__(self, talk: ParamTalk) -> None:
        self._talk = talk
        self.under_way = 0
        """loads that have not ended"""

    async def load(self, values: dict[str, float | int], report: Report) -> wire.ParamLoaded:
        """The known ones first: to enable a group brings those of the others that were hidden so far."""
        done = wire.ParamLoaded(set=[], unchanged=[], failed={})
        entries = self._talk.params.entries
        known = [name for name in values if name in entries]
        self.under_way += 1
        try:
            for names in (known, [name for name in values if name not in entries]):
                waiting = collections.deque(names)
                await together(*(self._work(waiting, values, done, report) for _ in range(AT_ONCE)))
        finally:
            self.under_way -= 1
        return done

    async def _work(
        self, waiting: collections.deque[str], values: dict[str, float | int], done: wire.ParamLoaded, report: Report
    ) -> None:
        while waiting:
            name = waiting.popleft()
            try:
                changed = await self._one(name, values[name])
            except ZmavError as e:
                done.failed[name] = e.message
            else:
                (done.set if changed else done.unchanged).append(name)
            report({"done": len(done.set) + len(done.unchanged) + len(done.failed), "of": len(values)})

    async def _one(self, name: str, value: float | int) -> bool:
        """Set it; False where it has that value already."""
        talk = self._talk
        entry = talk.params.entries.get(name) or (await talk.read(name) if is_name(name) else None)
        if entry is None:
            raise ZmavError("there is no such parameter, or it does not come")
        wanted = paramvalue.raw_of(name, value, entry.kind, talk.encoding)
        if talk.params.complete and talk.params.entries.get(name) == (wanted, entry.kind):
            return False
        await talk.write(name, value, entry.kind)
        return True
