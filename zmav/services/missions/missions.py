"""Missions, fences and rally points: replaced as a whole or not at all, cached beside the autopilot, and served from
there (``mission/{kind}``), so that a second reader costs the radio nothing.

Protocol: https://mavlink.io/en/services/mission.html
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import time
from collections.abc import AsyncIterator, Coroutine, Iterator
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from typing import Any, get_args

import zenoh

from zmav import keys, wire
from zmav.autopilots import Target
from zmav.autopilots.base import Fields
from zmav.errors import BadInput, Stale, ZmavError
from zmav.mavlink import Frame
from zmav.services.authority.bounds import Bounds
from zmav.services.companion import Companion
from zmav.services.files.ftp import Ftp
from zmav.services.link.heard import AutopilotMessages
from zmav.services.missions.by_file import FileTransfer
from zmav.services.missions.items import KINDS, WORDS, Items, Raw, home, same
from zmav.services.missions.replace import NotReplaced, Phase, Replacer
from zmav.services.missions.transfer import Download, Step, Transfer, TransferTimes, opaque_ids
from zmav.services.orders.command import Commander
from zmav.services.orders.orders import Report
from zmav.services.queries.questions import Reply
from zmav.waiting import cancelled, within
from zmav.wire import MissionKind

QUERY_WAIT = 1.5
"""s that a reader waits for a plan that is not in the cache; then it is told how far the reading is"""
NO_MISSION = 1
"""MISSION_STATE_NO_MISSION"""
Owner = tuple[tuple[int, int] | None, str | None]


@dataclass
class Held:
    """A plan as the autopilot of ``owner`` has it, home included; ``sure``: nothing says that somebody changed it."""

    plan: Download
    owner: Owner
    sure: bool = True
    encoded: tuple[object, bytes] | None = None
    """as it was told last, and of which progress"""


@dataclass
class Reading:
    """A download under way, and who is told how far it is."""

    task: asyncio.Task[Held]
    reports: list[Report]


@dataclass
class Progress:
    """What MISSION_CURRENT and MISSION_ITEM_REACHED last said, counted as the autopilot does."""

    current: int | None = None
    reached: int | None = None
    state: int = 0
    ids: tuple[int | None, ...] = field(default=(None, None, None))


class Missions:
    """Handlers of the ``mission_*`` orders that move nothing, the cache and its queries. Lives on the event loop."""

    mend_every = 5.0

    def __init__(
        self,
        companion: Companion,
        commander: Commander,
        bounds: Bounds,
        ftp: Ftp,
        pace: TransferTimes | None = None,
    ) -> None:
        self._questions, self._port, self._identity = companion.questions, companion.port, companion.identity
        self._bounds, self._ftp = bounds, ftp
        self._do, self._events, self.pace = commander, companion.events, pace or TransferTimes()
        self.progress = Progress()
        self._held: dict[MissionKind, Held] = {}
        self._lock = asyncio.Lock()
        self._doing = ""
        self._readings: dict[MissionKind, Reading] = {}
        self._owed: dict[MissionKind, tuple[Owner, Download, list[Raw]]] = {}
        """plans to be put back where an upload ended without a word of the autopilot: whose, the old, the new"""
        self._mended = 0.0
        self._no_file: set[tuple[Owner, MissionKind]] = set()
        """autopilots and plans of which there is no file"""
        self._tasks: set[asyncio.Task[Any]] = set()
        handlers = {
            "MISSION_CURRENT": self._on_current,
            "MISSION_ITEM_REACHED": self._on_reached,
            "MISSION_ACK": self._on_others,
            "MISSION_COUNT": self._on_others,
            "HEARTBEAT": self._on_heartbeat,
        }
        self._heard = AutopilotMessages(companion, handlers)

    def start(self) -> None:
        loop = asyncio.get_running_loop()
        key = keys.MISSION.key(self._port.fleet, self._port.name, kind="*")
        self._questions.declare(key, lambda query: self._answer(query, loop))
        self._heard.start()

    async def close(self) -> None:
        self._heard.close()
        tasks = [*self._tasks, *(reading.task for reading in self._readings.values())]
        await cancelled(*tasks)

    # Orders.

    async def upload(self, args: wire.MissionUpload, report: Report) -> dict[str, Any]:
        """Replace the whole plan of that kind, and see it there; nothing, by clearing. Refused items are named by
        their index, and whatever goes wrong, the error says which plan is in force.
        """
        new = await asyncio.to_thread(self.items().encode, args.kind, args.items)  # the first reads the dialect's XML
        return await self._replace(args.kind, new, report, force=args.force)

    async def clear(self, args: wire.MissionClear, report: Report) -> dict[str, Any]:
        """Leave none of that kind."""
        return await self._replace(args.kind, [], report, force=False)

    async def download(self, args: wire.MissionRefresh, report: Report) -> dict[str, Any]:
        """Read the plan again into the cache."""
        held = await self._read(args.kind, report)
        return {"kind": args.kind, "count": len(self._ours(args.kind, held)), "id": held.plan.id}

    # What others use.

    def items(self) -> Items:
        """How items are written for this autopilot; raises :class:`Stale` where none was ever heard."""
        autopilot = self._identity.autopilot or self._do.autopilot()
        return Items(self._port.dialect, autopilot.missions)

    async def plan(self, kind: MissionKind, report: Report) -> list[Raw]:
        """The plan that is on the autopilot (home included), from the cache where nothing speaks against it."""
        held = self._cached(kind)
        return (held if held and held.sure else await self._read(kind, report)).plan.items

    async def rally(self) -> list[Target]:
        """The rally points that are on the autopilot, over the ground."""
        points = await self.plan("rally", lambda news: None)
        return [Target(lat_deg=raw.x / 1e7, lon_deg=raw.y / 1e7) for raw in points]

    # Transactions: one at a time.

    async def _replace(self, kind: MissionKind, new: list[Raw], report: Report, *, force: bool) -> dict[str, Any]:
        autopilot = self._do.autopilot()
        async with self._turn(f"writing the {WORDS[kind]}", report):
            # A mission may be flown at once; else its start is judged. Rally points are flown to without being asked:
            # on the ground they are judged where the vehicle knows its place.
            if kind != "fence" and (self._identity.armed or (kind == "rally" and self._bounds.placed)):
                self._bounds.check_mission(new, force=force)
            phase = functools.partial(_steps, kind, [report])
            transfer = self._transfer(kind)
            old = self._before(kind, await self._known(kind, transfer, phase))
            replacer = self._replacer(kind, transfer, phase)
            start = self.items().offset(kind)
            self._owed[kind] = owed = self._owner(), old, [*old.items[:start], *new]
            try:
                done = await replacer.replace(old, new)
            except NotReplaced as e:
                self._hold(kind, e.now)
                if e.now is not None:
                    del self._owed[kind]
                self._events.emit("mission", "warning", e.error.message, **e.error.detail)
                raise e.error from e.__cause__
            except asyncio.CancelledError:
                self._hold(kind, None)
                raise
            assert self._owed.pop(kind) is owed
            self._hold(kind, done.now)
            if kind == "mission":
                self.progress.reached, self.progress.state = None, 0  # what was said of the old one
        words = f"{WORDS[kind]}: {len(new)} items" if new else f"{WORDS[kind]} cleared"
        self._events.emit("mission", "info", f"{words} on the {autopilot.name}", plan=kind, count=len(new))
        kept = {"kept_otherwise": done.notes} if done.notes else {}
        return {"kind": kind, "count": len(new), "id": done.now.id, "known_by": done.how, **kept}

    def _before(self, kind: MissionKind, there: Download) -> Download:
        """The plan to go back to: what is there, unless that is what a broken upload left behind."""
        owed = self._owed.get(kind)
        if owed is None or not _same_owner(owed[0], self._owner()) or same(self.items(), kind, there.items, owed[2]):
            return there
        return owed[1]

    async def _known(self, kind: MissionKind, transfer: Transfer, phase: Phase) -> Download:
        """The plan that is there now; read again unless its opaque id shows that the cache is right."""
        held = self._cached(kind)
        said = self.progress.ids[KINDS[kind]]
        if held is not None and held.sure and held.plan.id is not None and held.plan.id == said:
            return held.plan
        return await transfer.download(phase("reading the old plan"))

    async def _read(self, kind: MissionKind, report: Report) -> Held:
        """Download; who comes while it is under way shares it."""
        reading = self._readings.get(kind)
        if reading is None:
            self._do.autopilot()
            reports: list[Report] = []
            reading = Reading(asyncio.get_running_loop().create_task(self._read_once(kind, reports)), reports)
            self._readings[kind] = reading
            reading.task.add_done_callback(lambda task: self._read_over(kind, task))
        reading.reports.append(report)
        return await asyncio.shield(reading.task)

    def _read_over(self, kind: MissionKind, task: asyncio.Task[Held]) -> None:
        del self._readings[kind]
        if not task.cancelled():
            task.exception()  # looked at: nobody may be left who waits for it

    async def _read_once(self, kind: MissionKind, reports: list[Report]) -> Held:
        def tell(news: dict[str, Any]) -> None:
            for report in reports:
                report(news)

        async with self._turn(f"reading the {WORDS[kind]}", tell):
            found = await self._transfer(kind).download(_steps(kind, [tell], "reading"))
            held = self._hold(kind, found)
            assert held is not None
            return held

    @contextlib.asynccontextmanager
    async def _turn(self, doing: str, report: Report) -> AsyncIterator[None]:
        if self._lock.locked():
            report({"waiting_for": self._doing})
        async with self._lock:
            self._doing = doing
            yield

    def _transfer(self, kind: MissionKind) -> Transfer:
        rules, plan = self._do.autopilot().missions, (self._owner(), kind)
        given = self._port, self._do.source(), kind, self.pace, rules.window
        if kind in rules.files and plan not in self._no_file:
            disarmed, shut = lambda: self._identity.armed is False, lambda: self._no_file.add(plan)
            return FileTransfer(*given, self._ftp, disarmed, shut)
        return Transfer(*given)

    def _replacer(self, kind: MissionKind, transfer: Transfer, phase: Phase) -> Replacer:
        exact = self._do.autopilot().missions.exact
        return Replacer(transfer, self.items(), kind, self._events, phase, exact)

    # The cache.

    def _owner(self) -> Owner:
        return self._identity.source, self._identity.uid

    def _hold(self, kind: MissionKind, plan: Download | None) -> Held | None:
        if plan is None:
            self._held.pop(kind, None)
            return None
        self._held[kind] = held = Held(plan, self._owner())
        return held

    def _cached(self, kind: MissionKind) -> Held | None:
        """What is held, unless it is another autopilot's."""
        if any(not _same_owner(held.owner, self._owner()) for held in self._held.values()):
            self._held.clear()
            self.progress = Progress()
        return self._held.get(kind)

    def _ours(self, kind: MissionKind, held: Held) -> list[Raw]:
        return held.plan.items[self.items().offset(kind) :]

    def _mission(self, kind: MissionKind, held: Held, at: Progress) -> wire.Mission:
        items = self.items()
        mission = wire.Mission(kind=kind, items=items.decode(kind, held.plan.items), id=held.plan.id)
        if kind == "mission":
            start = items.offset(kind)
            mission.home = home(held.plan.items) if start else None
            mission.current, mission.reached = _index(at.current, start), _index(at.reached, start)
            state = self._port.dialect.enum_name("MISSION_STATE", at.state)
            mission.state = state.removeprefix("MISSION_STATE_") if state and at.state else None
        return mission

    # What the autopilot says.

    def _on_current(self, fields: Fields, frame: Frame) -> None:
        ids = opaque_ids(frame, "MISSION_CURRENT")
        self.progress.current, self.progress.state, self.progress.ids = fields["seq"], fields["mission_state"], ids
        held = self._cached("mission")
        if held is not None:
            none = fields["total"] == 0xFFFF or fields["mission_state"] == NO_MISSION
            total = 0 if none else fields["total"] or None
            if total is not None and total != len(self._ours("mission", held)):
                self._doubt("mission")
        for kind, number in KINDS.items():
            held, said = self._cached(kind), ids[number]
            if held is not None and None not in (said, held.plan.id) and said != held.plan.id:
                self._doubt(kind)

    def _on_reached(self, fields: Fields, frame: Frame) -> None:
        self.progress.reached = fields["seq"]

    def _on_others(self, fields: Fields, frame: Frame) -> None:
        """A ground station's transaction on this link: what it wrote is news to us."""
        kind = next((kind for kind, number in KINDS.items() if number == fields["mission_type"]), None)
        theirs = (fields["target_system"], fields["target_component"]) not in (self._port.address, (0, 0))
        held = self._cached(kind) if kind else None
        if kind is None or held is None or not theirs:
            return
        if fields.get("type") == 0 or ("count" in fields and fields["count"] != len(held.plan.items)):
            self._doubt(kind)

    def _doubt(self, kind: MissionKind) -> None:
        """Somebody else changed the plan: what is held is read again, once nobody writes."""
        held = self._held[kind]
        if not held.sure or self._lock.locked():
            return
        held.sure = False
        self._events.emit("mission", "notice", f"the {WORDS[kind]} on the autopilot changed", plan=kind)
        self._in_background(self._read(kind, lambda news: None))

    def _on_heartbeat(self, fields: Fields, frame: Frame) -> None:
        """An autopilot that fell silent in the middle of an upload answers again."""
        if self._owed and not self._lock.locked() and time.monotonic() - self._mended > self.mend_every:
            self._mended = time.monotonic()
            self._in_background(self._mend())

    async def _mend(self) -> None:
        """Put the old plans back, unless the vehicle flies what is there, is another one, or somebody was faster."""
        for kind, (owner, old, new) in list(self._owed.items()):
            flying = self._identity.armed and self._identity.mode == self._do.autopilot().missions.mode
            if not _same_owner(owner, self._owner()):
                del self._owed[kind]
            elif not flying:
                async with self._turn(f"restoring the {WORDS[kind]}", lambda news: None):
                    if kind not in self._owed:
                        return  # somebody has put another there meanwhile
                    replacer = self._replacer(kind, self._transfer(kind), functools.partial(_steps, kind, []))
                    now, which = await replacer.restore(old, new)
                    del self._owed[kind]
                    self._hold(kind, now)
                what = {"new": "the new one is in force after all", "old": "the old one is in force"}
                text = f"{WORDS[kind]}: {what.get(which, 'the old one was restored')}"
                self._events.emit("mission", "notice", text, plan=kind)

    def _in_background(self, work: Coroutine[Any, Any, Any]) -> None:
        async def quietly() -> None:
            with contextlib.suppress(ZmavError):
                await work

        task = asyncio.get_running_loop().create_task(quietly())
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    # Questions: asked in their lane, worked out here on the event loop, one at a time.

    def _answer(self, query: zenoh.Query, loop: asyncio.AbstractEventLoop) -> Iterator[Reply | Future[Any]]:
        asked, known = str(query.key_expr), get_args(MissionKind)
        kinds: list[MissionKind] = [kind for kind in known if query.key_expr.intersects(self._key(kind))]
        if "*" not in asked and not kinds:
            given = asked.rpartition("/")[2]
            why = f"no kind of mission {given!r}; there are {', '.join(known)}"
            raise BadInput(why, field="kind", value=given, expected=", ".join(known))
        for kind in kinds:
            yield (told := asyncio.run_coroutine_threadsafe(self._tell(kind, read="*" not in asked), loop))
            data = told.result()
            if data:
                yield Reply(self._key(kind), data)

    async def _tell(self, kind: MissionKind, read: bool) -> bytes:
        """The plan, encoded once as long as nothing of it changes; nothing where it is not held nor to be ``read``."""
        held = self._cached(kind)
        if held is None and not read:
            return b""
        progress: dict[str, Any] = {}
        try:
            if held is None or (read and not held.sure):
                held = await within(QUERY_WAIT, self._read(kind, progress.update))
        except asyncio.TimeoutError:
            far = f"{progress.get('done', 0)} of {progress.get('of', '?')} items"
            raise Stale(f"the {WORDS[kind]} are being read: {far}; ask again", reading=True, **progress) from None
        at = replace(self.progress)  # it may change while the plan is encoded
        if held.encoded is None or held.encoded[0] != at:
            held.encoded = (at, await asyncio.to_thread(lambda: wire.encode(self._mission(kind, held, at))))
        return held.encoded[1]

    def _key(self, kind: MissionKind) -> str:
        return keys.MISSION.key(self._port.fleet, self._port.name, kind=kind)


def _steps(kind: MissionKind, reports: list[Report], phase: str) -> Step:
    def step(done: int, of: int) -> None:
        for report in reports:
            report({"kind": kind, "phase": phase, "done": done, "of": of})

    return step


def _index(seq: int | None, start: int) -> int | None:
    return None if seq is None or seq < start else seq - start


def _same_owner(one: Owner, other: Owner) -> bool:
    return one[0] == other[0] and (None in (one[1], other[1]) or one[1] == other[1])
