"""What a client says about one vehicle's plan, and the answers it gets in the autopilot's name."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, NamedTuple

import zmav
from ground.gcs.answerer import Ground
from ground.gcs.request_handlers import RequestHandlers
from zmav import wire
from zmav.autopilots import autopilot_named
from zmav.errors import BadInput, Forbidden, NotHolder, Refused, Unsupported, ZmavError
from zmav.mavlink import Frame
from zmav.mavlink.results import MissionResult
from zmav.services.missions.items import HOME, KINDS, Items, Raw, raw_from
from zmav.waiting import within
from zmav.wire import MissionKind

BY_NUMBER = {number: kind for kind, number in KINDS.items()}
ASK_AGAIN = 1.0
"""s without the item after which it is asked for once more"""
TRIES = 8
WAITING = 0.4
"""s between two requests that keep a client waiting"""
LAST_TRIES = 3
"""requests for the last item once more, each for as long, until it came"""
WAITING_FOR_ONE = 1.0
"""the same where there is one item only, and each request counts as a repetition"""
BEYOND = 2**31 - 2
"""no place on Earth, and not the number that means "here" either"""


class ClientPlan(NamedTuple):
    """One kind of one vehicle's plans, as one client sees it."""

    handlers: RequestHandlers
    sysid: int
    kind: MissionKind


class Asked:
    """A frame of a client for one vehicle, and how it is answered."""

    def __init__(
        self,
        ground: Ground,
        handlers: RequestHandlers,
        frame: Frame,
        fields: Mapping[str, Any],
        sysid: int,
        vehicle: zmav.Vehicle,
    ) -> None:
        self._ground = ground
        self.handlers, self.frame, self.fields, self.sysid, self.vehicle = handlers, frame, fields, sysid, vehicle
        kind = BY_NUMBER.get(fields.get("mission_type", 0))
        self.line = None if kind is None else ClientPlan(handlers, sysid, kind)

    @property
    def items(self) -> Items:
        state = self.vehicle.last_state
        rules = autopilot_named(state.autopilot if state else None, state.kind if state else None)
        return Items(self._ground.dialect, rules.missions)

    def raws(self, kind: MissionKind, mission: wire.Mission) -> list[Raw]:
        """As the autopilot has it, home included."""
        items = self.items
        raws = [items.raw(kind, item) for item in mission.items]
        if not items.offset(kind) or (mission.home is None and not raws):
            return raws
        lat, lon, alt = mission.home or (0.0, 0.0, 0.0)
        return [HOME._replace(x=round(lat * 1e7), y=round(lon * 1e7), z=alt), *raws]

    def raw(self, as_float: bool) -> Raw:
        """The item in a MISSION_ITEM_INT, or in a MISSION_ITEM, whose x and y are degrees and metres."""
        if not as_float:
            return raw_from(self.fields)
        item = raw_from({**self.fields, "x": 0, "y": 0})
        scale = self.items.scale(self.items.name(item), item.frame)
        return item._replace(x=_grid(self.fields["x"] * scale), y=_grid(self.fields["y"] * scale))

    def decode(self, kind: MissionKind, raws: list[Raw]) -> list[wire.MissionItem]:
        """What the order takes; the frames are the client's own."""
        items = self.items
        found = items.decode(kind, raws)
        names = self._ground.dialect.enum_names["MAV_FRAME"]
        for item, raw in zip(found, raws[items.offset(kind) :], strict=True):
            item.frame = names.get(raw.frame, item.frame)
        return found

    # Answers.

    def say(self, name: str, **fields: Any) -> None:
        """In the autopilot's name, to who asked."""
        asker = {"target_system": self.frame.sysid, "target_component": self.frame.compid}
        kind = {"mission_type": self.fields.get("mission_type", 0)}
        component = self._ground.component(self.sysid)
        self.handlers.answer(self._ground.pack(self.sysid, component, name, **asker, **kind, **fields))

    def ack(self, result: int) -> None:
        self.say("MISSION_ACK", type=result)

    def refuse(self, error: ZmavError, what: str) -> None:
        self.tell("warning", f"{what}: {error}")
        self.ack(result_of(error, self._ground.dialect.enums["MAV_MISSION_RESULT"]))

    def tell(self, severity: wire.Severity, text: str) -> None:
        self.handlers.tell(self.sysid, severity, text)


def result_of(error: ZmavError, results: Mapping[str, int]) -> int:
    """The MAV_MISSION_RESULT that says it."""
    said = results.get(str(error.detail.get("result")))
    if said is not None:
        return said
    if isinstance(error, Unsupported):
        return MissionResult.UNSUPPORTED
    if isinstance(error, BadInput):
        return MissionResult.INVALID
    return MissionResult.DENIED if isinstance(error, (Forbidden, NotHolder, Refused)) else MissionResult.ERROR


def _grid(value: float) -> int:
    """What cannot be one is out of every range, and is refused by name."""
    return round(value) if abs(value) < BEYOND else BEYOND


class Silent(Exception):
    """The client no longer sends what it is asked for."""


class Upload:
    """The ``count`` items of a plan, which are asked for one by one, as an autopilot would, and given to the vehicle
    whole: https://mavlink.io/en/services/mission.html#uploading_mission. Lives on the event loop.

    The vehicle's agent then has the autopilot take them, which lasts. No message of the protocol says "wait", but a
    request for an item that was sent before does: stations send it once more, and begin to wait again. QGroundControl
    gives up 1.5 s after the last request, MAVSDK after five of one item or 0.5 s of silence each; the last two items in
    turn satisfy both. MAVSDK takes the MISSION_ACK that follows for a fault of the protocol unless it has sent the last
    item last.
    """

    def __init__(self, say: Callable[..., None], count: int, as_float: bool) -> None:
        self._say, self.count = say, count
        self._as_float = as_float
        """the client is of old: it knows neither MISSION_REQUEST_INT nor MISSION_ITEM_INT"""
        self.items: list[Raw] = []
        self.task: asyncio.Task[None] | None = None
        self.replaced = False
        """the client has begun another: it is asked for nothing more of this one"""
        self._came = asyncio.Event()
        self._latest = -1
        """the item that came last, be it for the first time or again"""

    @property
    def complete(self) -> bool:
        return len(self.items) >= self.count

    def take(self, seq: int, item: Raw, as_float: bool) -> None:
        """An item came; of one that came before it is only noted that the client has gone back to it."""
        if self.complete:
            self._latest = seq
            self._came.set()
        if seq == len(self.items) and not self.complete:
            self._as_float = as_float
            self.items.append(item)
            self._came.set()

    def ask(self) -> None:
        """For the next item."""
        self._request(len(self.items))

    async def collect(self) -> list[Raw]:
        """All items; raises :class:`Silent`."""
        while not self.complete:
            await self._one()
        return self.items

    async def _one(self) -> None:
        for attempt in range(TRIES):
            if attempt > 1 and not self.items:
                self._as_float = not self._as_float  # it may know the other request only
            self._came.clear()
            self.ask()
            try:
                await within(ASK_AGAIN, self._came.wait())
                return
            except asyncio.TimeoutError:
                continue
        raise Silent

    async def keep_waiting(self, work: Awaitable[object]) -> None:
        """See ``work`` through, and keep the client patient meanwhile. Raises what it raises."""
        task = asyncio.ensure_future(work)
        pause = WAITING if self.count > 1 else WAITING_FOR_ONE
        asked = last = self.count - 1
        try:
            while not (await asyncio.wait({task}, timeout=pause))[0]:
                asked = last - int(asked == last and self.count > 1)
                self._request(asked)
            task.result()
        finally:
            task.cancel()
        if asked != last or self._latest == last - 1:
            await self._back_at(last)

    async def _back_at(self, last: int) -> None:
        """Have the last item sent once more; it is waited for where the client has gone back to the one before."""
        for _ in range(LAST_TRIES):
            self._request(last)
            with contextlib.suppress(asyncio.TimeoutError):
                await within(WAITING, self._sent(last))
                return

    async def _sent(self, last: int) -> None:
        while self._latest == last - 1:
            self._came.clear()
            await self._came.wait()

    def _request(self, seq: int) -> None:
        if not self.replaced:
            self._say("MISSION_REQUEST" if self._as_float else "MISSION_REQUEST_INT", seq=seq)
