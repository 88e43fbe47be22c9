"""Missions, fences and rally points, answered in the vehicles' place: https://mavlink.io/en/services/mission.html

Downloads come from the cache of the vehicle's agent. An upload is collected here, so that a bad radio between station
and bridge costs the vehicle nothing, and becomes one order, which replaces the plan as a whole or leaves the old one in
force; the MISSION_ACK says how that ended. On an ArduPilot item 0 is home: it is shown to clients, and what they send
in its place is left out.

Items that are orders in disguise (``current`` 2 and 3: fly there now) pass, and so does what no cache holds.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Coroutine, Iterator
from typing import Any, NamedTuple

from ground.gcs.answerer import Answerer, Ground
from ground.gcs.client import Client
from ground.gcs.mission_asked import BY_NUMBER, Asked, ClientPlan, Silent, Upload, result_of
from ground.gcs.request_handlers import HandlersByClient, RequestHandlers
from zmav import wire
from zmav.errors import Forbidden, Unsupported, ZmavError
from zmav.mavlink import Frame, decode
from zmav.mavlink.results import MissionResult
from zmav.services.missions.items import KINDS, WORDS, Raw

ALL = 255
"""MAV_MISSION_TYPE_ALL"""
ORDERS = (2, 3)
"""``current`` of an item that is flown to at once, and of one that is a new altitude"""
MOST_WORK = 256
"""transactions of all clients under way; they repeat what gets no answer"""
ACK_AGAIN = 0.5
"""s after a MISSION_ACK from which on a repeated last item says that it was lost"""
SHOWN_ON = 5.0
"""s for which a client that asked for the last item can ask again for others that were lost on the way"""


class Shown(NamedTuple):
    """A plan as the autopilot has it, and the item being flown."""

    raws: list[Raw]
    current: int


class Ended(NamedTuple):
    """How the last upload did, and when."""

    last: int
    result: int
    at: float


class Missions(Answerer):
    def __init__(self, ground: Ground, by_client: HandlersByClient) -> None:
        self._ground, self._by_client, self._dialect = ground, by_client, ground.dialect
        self._shown: dict[ClientPlan, Shown] = {}
        """what a client is downloading, from the count until it says that it has it, or a while after the last item"""
        self._single: dict[ClientPlan, dict[int, Asked]] = {}
        """items that a client asked for without a count, while the plan is read"""
        self._uploads: dict[ClientPlan, Upload] = {}
        self._orders: dict[ClientPlan, asyncio.Future[None]] = {}
        """done when the newest upload that a client sent whole, or a later clearing, has ended"""
        self._ended: dict[ClientPlan, Ended] = {}
        self._working: dict[tuple[Any, ...], asyncio.Task[None]] = {}
        """what a client has asked for and waits for, so that it is not done twice when it repeats itself"""
        self._handlers: dict[str, Callable[[Asked], None]] = {
            "MISSION_REQUEST_LIST": self._list,
            "MISSION_REQUEST_INT": self._item,
            "MISSION_REQUEST": self._item,
            "MISSION_ACK": self._over,
            "MISSION_COUNT": self._count,
            "MISSION_WRITE_PARTIAL_LIST": lambda asked: asked.ack(MissionResult.UNSUPPORTED),
            "MISSION_ITEM_INT": self._take,
            "MISSION_ITEM": self._take,
            "MISSION_CLEAR_ALL": self._clear,
            "MISSION_SET_CURRENT": self._current,
        }
        self.takes = frozenset(self._handlers)
        by_client.forget.append(self._forget)

    # On the carrying threads.

    def offer(self, client: Client, frame: Frame) -> bool:
        name = self._dialect.name_of(frame.msgid)
        if not self._ground.is_for_autopilots(client, frame):
            return False
        if name in ("MISSION_ITEM", "MISSION_ITEM_INT") and decode(frame, self._dialect)["current"] in ORDERS:
            return False
        self._by_client.of(client).ask(self._handle, frame)
        return True

    def close(self) -> None:
        self._uploads.clear()
        for task in list(self._working.values()):
            task.cancel()

    # From here on: on the event loop.

    def _forget(self, handlers: RequestHandlers) -> None:
        self._shown = {line: shown for line, shown in self._shown.items() if line.handlers is not handlers}
        self._ended = {line: ended for line, ended in self._ended.items() if line.handlers is not handlers}
        for line in [line for line in self._uploads if line.handlers is handlers]:
            upload = self._uploads.pop(line)
            if not upload.complete and upload.task is not None:  # what it sent whole is done, who would undo it?
                upload.task.cancel()

    def _handle(self, handlers: RequestHandlers, frame: Frame) -> None:
        """A frame, for each vehicle that it is for."""
        handle, fields = self._handlers[self._dialect.name_of(frame.msgid)], decode(frame, self._dialect)
        for sysid, vehicle in self._ground.vehicles(handlers.client, frame):
            handle(Asked(self._ground, handlers, frame, fields, sysid, vehicle))

    def _work(self, key: tuple[Any, ...], work: Coroutine[Any, Any, None]) -> asyncio.Task[None] | None:
        """Do it, unless it is being done."""
        if key in self._working or len(self._working) >= MOST_WORK:
            work.close()
            return None
        task = self._working[key] = self._ground.loop.create_task(work)
        task.add_done_callback(lambda task: self._working.pop(key, None))
        return task

    # Downloads.

    def _list(self, asked: Asked) -> None:
        if asked.line is None:
            asked.ack(MissionResult.UNSUPPORTED)
        else:
            self._work(("list", asked.line), self._show_count(asked, asked.line))

    async def _fetch(self, asked: Asked, line: ClientPlan) -> Shown | None:
        """The plan as it is now; None if there is none, and the client has been told."""
        try:
            mission = await asked.vehicle.missions.get(line.kind)
            raws, start = asked.raws(line.kind, mission), asked.items.offset(line.kind)
        except ZmavError as e:
            asked.refuse(e, f"{WORDS[line.kind]} not read")
            return None
        return Shown(raws, -1 if mission.current is None else mission.current + start)

    async def _show_count(self, asked: Asked, line: ClientPlan) -> None:
        if (shown := await self._fetch(asked, line)) is None:
            return
        if shown.raws:
            self._shown[line] = shown
        else:
            self._shown.pop(line, None)
        asked.say("MISSION_COUNT", count=len(shown.raws))

    def _item(self, asked: Asked) -> None:
        line, seq = asked.line, asked.fields["seq"]
        if line is None:
            asked.ack(MissionResult.UNSUPPORTED)
        elif (shown := self._shown.get(line)) is None:
            self._show_single(asked, line, seq)
        else:
            if seq == len(shown.raws) - 1:  # its ACK may never come, and a later question is about a later plan
                self._ground.loop.call_later(SHOWN_ON, self._hide, line, shown)
            self._show_item(asked, line, shown)

    def _hide(self, line: ClientPlan, shown: Shown) -> None:
        if self._shown.get(line) is shown:
            del self._shown[line]

    def _show_single(self, asked: Asked, line: ClientPlan, seq: int) -> None:
        """Of a plan that is not being downloaded as a whole; it is read once for all items asked for meanwhile."""
        if (single := self._single.get(line)) is not None:
            single[seq] = asked
        elif self._work(("item", line), self._show_all(line, single := {seq: asked})) is not None:
            self._single[line] = single

    async def _show_all(self, line: ClientPlan, single: dict[int, Asked]) -> None:
        try:
            shown = await self._fetch(next(iter(single.values())), line)
        finally:
            del self._single[line]
        if shown is None:
            return
        for asked in single.values():
            self._show_item(asked, line, shown)

    def _show_item(self, asked: Asked, line: ClientPlan, shown: Shown) -> None:
        (raws, current), seq = shown, asked.fields["seq"]
        if seq >= len(raws):
            asked.ack(MissionResult.INVALID_SEQUENCE)
            return
        fields = {**raws[seq].fields(), "seq": seq, "current": int(seq == current and line.kind == "mission")}
        if self._dialect.name_of(asked.frame.msgid) == "MISSION_REQUEST_INT":
            asked.say("MISSION_ITEM_INT", **fields)
        else:
            scale = asked.items.scale(asked.items.name(raws[seq]), raws[seq].frame)
            asked.say("MISSION_ITEM", **{**fields, "x": raws[seq].x / scale, "y": raws[seq].y / scale})

    def _over(self, asked: Asked) -> None:
        """It has all it wanted."""
        if asked.line is not None:
            self._shown.pop(asked.line, None)

    # Uploads.

    def _count(self, asked: Asked) -> None:
        line, count = asked.line, asked.fields["count"]
        if line is None:
            asked.ack(MissionResult.UNSUPPORTED)
        elif self._may_change(asked, line):
            self._begin(asked, line, count)

    def _may_change(self, asked: Asked, line: ClientPlan) -> bool:
        if asked.handlers.client.read_only:
            asked.refuse(Forbidden("read-only"), f"{WORDS[line.kind]} not changed")
        return not asked.handlers.client.read_only

    def _begin(self, asked: Asked, line: ClientPlan, count: int) -> None:
        before = self._uploads.get(line)
        if before is not None and not before.items and before.count == count:
            if count:
                before.ask()  # it has not heard that we ask
            return
        if before is not None:
            before.replaced = True
            if not before.complete and before.task is not None:
                before.task.cancel()
        self._ended.pop(line, None)
        self._shown.pop(line, None)
        upload = self._uploads[line] = Upload(asked.say, count, asked.frame.version == 1)
        upload.task = self._work(("upload", line, id(upload)), self._run(asked, line, upload))
        if upload.task is None:
            del self._uploads[line]
            asked.ack(MissionResult.DENIED)

    async def _run(self, asked: Asked, line: ClientPlan, upload: Upload) -> None:
        result: int = MissionResult.OPERATION_CANCELLED
        try:
            came = await upload.collect()
            order = self._replace(asked, line, asked.decode(line.kind, came))
            await (upload.keep_waiting(order) if came else order)
            result = MissionResult.ACCEPTED
        except Silent:
            asked.tell("warning", f"{WORDS[line.kind]} not uploaded: item {len(upload.items)} did not come")
        except ZmavError as e:
            result = result_of(e, self._dialect.enums["MAV_MISSION_RESULT"])
            asked.tell("warning", f"{WORDS[line.kind]} not uploaded: {e}")
        finally:
            if self._uploads.get(line) is upload:
                del self._uploads[line]
                self._ended[line] = Ended(upload.count - 1, result, time.monotonic())
                asked.ack(result)

    async def _replace(self, asked: Asked, line: ClientPlan, items: list[wire.MissionItem]) -> None:
        """The order, in its turn. What came over another connection, or from elsewhere, is not waited for."""
        with self._turn(line) as before:
            await asyncio.wait({before})
            await asked.vehicle.missions.upload(items, line.kind)

    @contextlib.contextmanager
    def _turn(self, line: ClientPlan) -> Iterator[asyncio.Future[None]]:
        """An order's: what it is to wait for, so that what came last over this connection is in force."""
        ended = self._ground.loop.create_future()
        before = self._orders.get(line)
        if before is None:
            before = self._ground.loop.create_future()
            before.set_result(None)
        self._orders[line] = ended
        try:
            yield before
        finally:
            ended.set_result(None)
            if self._orders.get(line) is ended:
                del self._orders[line]

    def _take(self, asked: Asked) -> None:
        line = asked.line
        if line is None:
            return
        upload, ended = self._uploads.get(line), self._ended.get(line)
        seq, as_float = asked.fields["seq"], self._dialect.name_of(asked.frame.msgid) == "MISSION_ITEM"
        if upload is not None:
            upload.take(seq, asked.raw(as_float), as_float)
        elif ended is not None and ended.last == seq and time.monotonic() - ended.at > ACK_AGAIN:
            self._ended[line] = ended._replace(at=time.monotonic())
            asked.ack(ended.result)

    # Orders.

    def _clear(self, asked: Asked) -> None:
        number = asked.fields["mission_type"]
        if number not in (*BY_NUMBER, ALL):
            asked.ack(MissionResult.UNSUPPORTED)
        elif self._may_change(asked, asked.line or ClientPlan(asked.handlers, asked.sysid, "mission")):
            self._work(("clear", asked.handlers, asked.sysid, number), self._clear_all(asked, number))

    async def _clear_all(self, asked: Asked, number: int) -> None:
        kinds = KINDS if number == ALL else [BY_NUMBER[number]]
        lines = [ClientPlan(asked.handlers, asked.sysid, kind) for kind in kinds]
        with contextlib.ExitStack() as turns:
            for line, before in [(line, turns.enter_context(self._turn(line))) for line in lines]:
                await asyncio.wait({before})
                self._shown.pop(line, None)
                try:
                    await asked.vehicle.missions.clear(line.kind)
                except ZmavError as e:
                    if number == ALL and isinstance(e, Unsupported):
                        continue  # it has none of that kind
                    asked.refuse(e, f"{WORDS[line.kind]} not cleared")
                    return
        asked.ack(MissionResult.ACCEPTED)

    def _current(self, asked: Asked) -> None:
        if asked.handlers.client.read_only:
            asked.refuse(Forbidden("read-only"), "mission item not set")
            return
        seq = asked.fields["seq"]
        self._work(("current", asked.handlers, asked.sysid, seq), self._jump(asked, seq))

    async def _jump(self, asked: Asked, seq: int) -> None:
        """The MISSION_CURRENT that the autopilot then says is the answer."""
        try:
            await asked.vehicle.missions.set_current(max(seq - asked.items.offset("mission"), 0))
        except ZmavError as e:
            asked.refuse(e, f"mission item {seq} not set")
