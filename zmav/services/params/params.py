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
import difflib
import time
from collections.abc import Callable, Coroutine, Iterable, Iterator
from concurrent.futures import Future
from typing import Any

import msgspec
import zenoh

from zmav import keys, wire
from zmav.autopilots.base import Fields
from zmav.errors import BadInput, LinkDown, Stale, TimedOut, ZmavError
from zmav.mavlink import Frame, paramvalue
from zmav.mavlink.paramvalue import ParamEncoding
from zmav.services.companion import Companion
from zmav.services.link.heard import AutopilotMessages
from zmav.services.link.timesync import AutopilotRestarted
from zmav.services.orders.orders import Report
from zmav.services.params.fill import ParamFill
from zmav.services.params.requests import ParamTalk
from zmav.services.params.values import Entry, ParamSet, is_name
from zmav.services.queries.questions import Reply
from zmav.trust.verify import Allowance
from zmav.waiting import together

HINTS = 2.0
"""a second: names like one that there is not take milliseconds to find"""
LONGEST_NAME = 16


def unknown(name: str, names: Iterable[str]) -> BadInput:
    """The error for a name that no parameter has, with those like it; none for what is too long to be one."""
    close = difflib.get_close_matches(name.upper(), names, n=3, cutoff=0.6) if len(name) <= LONGEST_NAME else []
    expected = f"a name such as {', '.join(close)}" if close else "a parameter's name"
    hint = f"; did you mean {', '.join(close)}?" if close else ""
    return BadInput(f"no parameter {name!r}{hint}", field="name", value=name, expected=expected)


class ParamQueries:
    """Answers in the lane of questions, from what is ``known``; what is not is looked for by ``find``, on the loop.

    ``table()`` is the whole set.
    """

    def __init__(
        self,
        companion: Companion,
        known: ParamSet,
        talk: ParamTalk,
        table: Callable[[], wire.ParamTable],
        find: Callable[[str], Coroutine[Any, Any, wire.Param]],
    ) -> None:
        self._questions, self._port, self._known, self._talk = companion.questions, companion.port, known, talk
        self._whole, self._find = table, find
        self._hints = Allowance(HINTS, time.monotonic)
        self._encoded: tuple[tuple[object, ...], wire.ParamTable, bytes] | None = None

    def start(self) -> None:
        loop = asyncio.get_running_loop()
        self._questions.declare(self._table_key(), self._on_table)
        self._questions.declare(self._key("*"), lambda query: self._on_name(query, loop))

    def _table_key(self) -> str:
        return keys.PARAMS.key(self._port.fleet, self._port.name)

    def _key(self, name: str) -> str:
        return keys.PARAM.key(self._port.fleet, self._port.name, param=name)

    def _on_table(self, query: zenoh.Query) -> Iterator[Reply]:
        asked = wire.decode(query.payload.to_bytes() if query.payload else b"", wire.ParamQuery, "param")
        yield Reply(self._table_key(), self._table(asked.hash))

    def _table(self, has: str) -> bytes:
        """The set, or a line where the asker has it already."""
        version = self._known.version, self._known.complete, self._talk.encoding
        if self._encoded is None or self._encoded[0] != version:
            table = self._whole()
            self._encoded = (version, table, wire.encode(table))
        _, table, encoded = self._encoded
        if table.hash != has:
            return encoded
        return wire.encode(msgspec.structs.replace(table, t=self._known.confirmed, params=[], unchanged=True))

    def _on_name(self, query: zenoh.Query, loop: asyncio.AbstractEventLoop) -> Iterator[Reply | Future[Any]]:
        asked = str(query.key_expr)
        if asked.endswith("**"):
            return  # who looks around for everything gets the table, and not every line of it once more
        last = asked.rpartition("/")[2]
        if "*" in asked:
            yield from self._all(query, [last] if "*" not in last else self._known.names())
            return
        found = self._line(last)
        if found is None and self._known.complete:
            hints = len(last) <= LONGEST_NAME and self._hints.take()
            raise unknown(last, self._known.names() if hints else ())
        if found is None:
            yield (heard := asyncio.run_coroutine_threadsafe(self._find(last), loop))
            found = wire.encode(heard.result())
        yield Reply(self._key(last), found)

    def _all(self, query: zenoh.Query, names: list[str]) -> Iterator[Reply]:
        """Each that matches, under its own key; nothing where none does."""
        for name in names:
            line = self._line(name)
            if line is not None and query.key_expr.intersects(self._key(name)):
                yield Reply(self._key(name), line)

    def _line(self, name: str) -> bytes | None:
        """One parameter from the cache."""
        try:
            return wire.encode(self._known.param(self._known.spelt(name), self._talk.encoding))
        except KeyError:
            return None


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
        if not self._identity.connected or self._port.link.recorded:  # a recording answers nobody
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
