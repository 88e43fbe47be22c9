"""Parameters: the whole set, cached beside the autopilot and served from there; set, load, refresh.

The set is read once for each autopilot, in the background. It is read again when the autopilot was exchanged (another
address, uid or firmware), when it has restarted (nothing else tells whether a value changed meanwhile), and when it
announces another count, which is what enabling a group of parameters does. That a link was silent for a while is no
reason: the links that are silent often are just those that a reading would load. Every PARAM_VALUE renews the cache, no
matter who asked for it. https://mavlink.io/en/services/parameter.html
"""

from __future__ import annotations

import asyncio
import collections
import time
from typing import Any

import msgspec

from zmav import wire
from zmav.autopilots.base import Fields
from zmav.errors import BadInput, LinkDown, Stale, TimedOut, ZmavError
from zmav.mavlink import Frame, paramvalue
from zmav.mavlink.paramvalue import ParamEncoding
from zmav.services.companion import Companion
from zmav.services.link.heard import AutopilotMessages
from zmav.services.link.timesync import AutopilotRestarted
from zmav.services.orders.orders import Report
from zmav.services.params.fill import ParamFill
from zmav.services.params.query import ParamQueries, unknown
from zmav.services.params.requests import ParamTalk
from zmav.services.params.values import Entry, ParamSet, is_name
from zmav.waiting import together

BEGIN_AFTER = 1.0
"""s that the background reading waits for the uid, which tells whether there is anything to read"""
LINK_DOWN_RETRY = 5.0
RETRY = (30.0, 600.0)
"""s until a background reading that failed is tried again: after the first time, and at most"""
PROGRESS_EVERY = 0.2
LOADED_AT_ONCE = 4


class Params:
    """The parameters of the vehicle's autopilot. Lives on the event loop; ``tick`` is called a few times a second."""

    settle = 2.0
    """s from a change of the count to the new reading: who enables one group enables another"""

    def __init__(self, companion: Companion) -> None:
        self._port, self._identity, self._events = companion.port, companion.identity, companion.events
        self.known = ParamSet()
        self.talk = ParamTalk(companion, self.known)
        self._queries = ParamQueries(companion, self.known, self.talk, self.table, self.find)
        self._loader = ParamLoader(self.talk)
        self._who: tuple[Any, ...] | None = None
        self._told: dict[str, str | None] = {"uid": None, "firmware": None}
        self._connected_at: float | None = None
        self._reading: asyncio.Task[None] | None = None
        self._due = 0.0
        """monotonic seconds: no background reading before"""
        self._retry = RETRY[0]
        self._restarts = 0
        self._version = AutopilotMessages(companion, {"AUTOPILOT_VERSION": self._on_version})

    def start(self) -> None:
        self.talk.start()
        self._queries.start()
        self._port.bus.on(AutopilotRestarted, lambda told: self.known.doubt())
        self._version.start()

    def close(self) -> None:
        self._version.close()
        self.talk.close()
        if self._reading is not None:
            self._reading.cancel()

    # What others ask for.

    @property
    def vehicle(self) -> str:
        return self._port.name

    @property
    def fleet(self) -> str:
        return self._port.fleet

    def table(self) -> wire.ParamTable:
        """The set as it is known now."""
        autopilot = self._identity.autopilot
        return self.known.table(self.talk.encoding, autopilot.name if autopilot else "", self._identity.firmware)

    def get(self, name: str) -> wire.Param | None:
        """One parameter from the cache, its name in any case; None: not known, or not yet."""
        name = self.known.spelt(name)
        return self.known.param(name, self.talk.encoding) if name in self.known.entries else None

    def value(self, name: str) -> float | None:
        """Its value where it is known."""
        found = self.get(name)
        return None if found is None else found.value

    async def find(self, name: str) -> wire.Param:
        """One parameter, from the cache or else from the autopilot.

        Raises :class:`BadInput` with names like it where there is none, :class:`TimedOut` where that is not certain
        because not all names are known, :class:`Stale`.
        """
        name, entry = await self._entry(name)
        return wire.Param(name=name, value=self.talk.value(entry), type=entry.kind)

    async def set(self, args: wire.ParamSet, report: Report) -> dict[str, Any]:
        """Set one and read it back; raises what :meth:`ParamTalk.write` and :meth:`find` do."""
        name, entry = await self._entry(args.name)
        value = await self.talk.write(name, args.value, entry.kind)
        changed = wire.ParamChanged(name=name, value=value, before=self.talk.value(entry))
        return dict(msgspec.to_builtins(changed))

    async def load(self, args: wire.ParamLoad, report: Report) -> dict[str, Any]:
        """Set many; see :class:`zmav.wire.ParamLoaded`. Raises :class:`Stale` only where nothing was begun."""
        self.talk.check()
        if not args.values:
            raise BadInput("no values are given", field="values", value={}, expected="values by parameter name")
        result = await self._loader.load(args.values, report)
        return dict(msgspec.to_builtins(result))

    async def refresh(self, args: wire.ParamRefresh, report: Report) -> dict[str, Any]:
        """Read the whole set again; who asks while it is being read gets that reading."""
        began = time.monotonic()
        self.talk.check()
        reading = self._read()
        while not reading.done():
            report({"received": self.known.received, "count": self.known.count})
            await asyncio.wait({reading}, timeout=PROGRESS_EVERY)
        if reading.cancelled():
            raise Stale(f"{self.vehicle}: the autopilot was exchanged meanwhile", vehicle=self.vehicle)
        reading.result()
        return {"count": self.known.count, "seconds": round(time.monotonic() - began, 3)}

    # The background.

    def tick(self) -> None:
        """See who the autopilot is, and begin to read where its set is not known."""
        self._look()
        now = time.monotonic()
        if not self._identity.connected:
            self._connected_at = None
            return
        if self._connected_at is None:
            self._connected_at, self._due, self._retry = now, now, RETRY[0]
        if self.known.restarts != self._restarts:
            self._restarts, self._due = self.known.restarts, max(self._due, now + self.settle)
        known_who = self._identity.uid is not None or now - self._connected_at > BEGIN_AFTER
        idle = self._reading is None and not self._loader.under_way
        if not self.known.complete and idle and known_who and now >= self._due and self._identity.clash is None:
            self._read()

    def _look(self) -> None:
        """Drop what was known of an autopilot that is no longer there."""
        identity = self._identity
        if identity.source is None or identity.autopilot is None:
            return
        who = (identity.source, identity.autopilot.name, identity.mav_type)
        exchanged = self._who is not None and who != self._who
        for field, said in (("uid", identity.uid), ("firmware", identity.firmware)):
            exchanged |= None not in (said, self._told[field]) and said != self._told[field]
            self._told[field] = said or self._told[field]
        if self._who is None or exchanged:
            bytewise = identity.autopilot.params_bytewise
            self.talk.encoding = ParamEncoding.BYTEWISE if bytewise else ParamEncoding.C_CAST
        self._who = who
        if exchanged:
            self._told = {"uid": identity.uid, "firmware": identity.firmware}
            self._drop()

    def _drop(self) -> None:
        self.known.clear()
        self.talk.forget()
        self._due = time.monotonic()
        if self._reading is not None:
            self._reading.cancel()

    def _on_version(self, fields: Fields, frame: Frame) -> None:
        """The autopilot says itself how integers travel."""
        self._look()
        flags, said = self._port.dialect.enums["MAV_PROTOCOL_CAPABILITY"], fields["capabilities"]
        prefix = "MAV_PROTOCOL_CAPABILITY_PARAM_"
        if said & flags.get(prefix + "ENCODE_BYTEWISE", 16):
            self.talk.encoding = ParamEncoding.BYTEWISE
        elif said & (flags.get(prefix + "ENCODE_C_CAST", 1 << 17) | flags.get(prefix + "FLOAT", 2)):
            self.talk.encoding = ParamEncoding.C_CAST

    def _read(self) -> asyncio.Task[None]:
        """The reading under way, or a new one: never two at once."""
        if self._reading is None:
            self._reading = asyncio.get_running_loop().create_task(self._fill())
            self._reading.add_done_callback(self._read_ended)
        return self._reading

    async def _fill(self) -> None:
        began = time.monotonic()
        await ParamFill(self.talk, self.vehicle).run()
        took = time.monotonic() - began
        self._events.emit("param", "info", f"{self.known.count} parameters read in {took:.1f} s", limit="param read")

    def _read_ended(self, task: asyncio.Task[None]) -> None:
        """What it raised is said to who asked for it; here it decides when the background tries again."""
        self._reading, now = None, time.monotonic()
        self._restarts = self.known.restarts
        error = None if task.cancelled() else task.exception()
        if isinstance(error, LinkDown):
            self._due = now + LINK_DOWN_RETRY
        elif error is not None and not isinstance(error, Stale):
            self._due, self._retry = now + self._retry, min(2 * self._retry, RETRY[1])
            why = error.message if isinstance(error, ZmavError) else repr(error)
            self._events.emit("param", "warning", f"parameters not read: {why}", limit="param not read")

    # How it is done.

    async def _entry(self, asked: str) -> tuple[str, Entry]:
        """The parameter and its name as the autopilot spells it."""
        if not is_name(asked):
            expected = "1 to 16 printable characters"
            raise BadInput(f"{asked!r} cannot be a parameter's name", field="name", value=asked, expected=expected)
        entry = self.known.entries.get(self.known.spelt(asked))
        if entry is None:
            self.talk.check()
            entry = await self.talk.read(asked)  # it may be hidden, or not read yet
        name = self.known.spelt(asked)
        entry = entry or self.known.entries.get(name)
        if entry is not None:
            return name, entry
        if self.known.complete:
            raise unknown(asked, self.known.entries)
        text = f"{asked} does not come, and not all parameters are read yet: there may be none of that name"
        raise TimedOut(text, vehicle=self.vehicle, name=asked)


class ParamLoader:
    """Sets many parameters, a few at a time; one that fails does not stop the others. Lives on the event loop."""

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
                await together(*(self._work(waiting, values, done, report) for _ in range(LOADED_AT_ONCE)))
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
