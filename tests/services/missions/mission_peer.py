"""An autopilot that stores missions as ArduPilot does, or as PX4 does, behind a link that loses and delays."""

from __future__ import annotations

import asyncio
import random
import struct
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

from tests.services.conftest import Bench, Peer, StartBench, Told
from zmav import keys, wire
from zmav.mavlink.frame import build_frame
from zmav.services.missions.transfer import TransferTimes

MISSION, FENCE, RALLY = 0, 1, 2
ACCEPTED, ERROR, UNSUPPORTED, INVALID, INVALID_SEQUENCE, DENIED, CANCELLED = 0, 1, 3, 5, 13, 14, 15
Item = dict[str, Any]
HOME = {
    "frame": 0,
    "command": 16,
    "autocontinue": 1,
    "param1": 0.0,
    "param2": 0.0,
    "param3": 0.0,
    "param4": 0.0,
    "x": -353632610,
    "y": 1491652300,
    "z": 584.0,
}


class MissionPeer(Peer):
    """``style`` "ardupilot": missions are overwritten as items arrive and begin with home, fences are kept until the
    last item; requests stand for themselves. "px4": the old plan stands until the acknowledgement, which gives an
    opaque id, and a download goes item by item. What goes wrong is set by the fields below.
    """

    def __init__(self, sysid: int = 1, *, style: str = "ardupilot", **more: Any) -> None:
        super().__init__(sysid, autopilot={"ardupilot": 3, "px4": 12}.get(style, 0), **more)
        self.style = style
        self.place = (-35.36, 149.16)
        self.plans: dict[int, list[Item]] = {MISSION: [], FENCE: [], RALLY: []}
        self.ids = {MISSION: 0, FENCE: 0, RALLY: 0}
        self.loss, self.delay = 0.0, 0.0
        self.random = random.Random(1)
        self.time = 1.0
        """ArduPilot's own timeouts (1 s, 8 s), times this"""
        self.asks = "MISSION_REQUEST_INT"
        self.times_asked = 1
        self.refuses: dict[int, int] = {}
        """result for the item of that number, as the autopilot counts"""
        self.loses: Callable[[int], bool] = lambda seq: False
        """whether its request for that item is lost, and not repeated"""
        self.dies_at: int | None = None
        """the item after which it says and hears no more"""
        self.dead = False
        self.kinds = {MISSION, FENCE, RALLY}
        self.changes: Callable[[int, Item], Item] = lambda seq, item: item
        """what becomes of an item when it is stored"""
        self.silent_at_end = False
        """never says that an upload is complete"""
        self.upload: dict[str, Any] | None = None
        self.timer: asyncio.TimerHandle | None = None
        self.at = 0

    @property
    def home_first(self) -> bool:
        return self.style == "ardupilot"

    @property
    def by_item(self) -> int:
        """Items that were asked for one by one, repetitions aside: on a busy machine an answer may come too late."""
        asked, lists = set[tuple[int, int]](), 0
        for told in self.told:
            lists += told.name == "MISSION_REQUEST_LIST"
            if told.name == "MISSION_REQUEST_INT":
                asked.add((lists, told.fields["seq"]))
        return len(asked)

    def load(self, kind: int, items: list[Item]) -> None:
        """What is stored before the test begins."""
        home = [dict(HOME)] if kind == MISSION and self.home_first and items else []
        self.plans[kind] = home + [dict(item) for item in items]
        self.ids[kind] = self._id(self.plans[kind])

    def stored(self, kind: int = MISSION) -> list[Item]:
        """The items without home."""
        return self.plans[kind][1 if kind == MISSION and self.home_first else 0 :]

    # The link.

    def raw(self, data: bytes) -> None:
        if self.dead or self.random.random() < self.loss:
            return
        if self.delay:
            asyncio.get_running_loop().call_later(self.delay, super().raw, data)
        else:
            super().raw(data)

    def datagram_received(self, data: bytes, addr: Any) -> None:
        if self.dead or self.random.random() < self.loss:
            return
        if self.delay:
            asyncio.get_running_loop().call_later(self.delay, self._take, data, addr)
        else:
            self._take(data, addr)

    def _take(self, data: bytes, addr: Any) -> None:
        before = len(self.told)
        super().datagram_received(data, addr)
        for told in self.told[before:]:
            handler = getattr(self, f"on_{told.name.lower()}", None)
            if handler is not None and told.fields["target_system"] == self.packer.sysid:
                if told.fields.get("mission_type", 0) in self.kinds:
                    handler(told)
                else:
                    self.ack(told.fields["mission_type"], UNSUPPORTED, told.source)

    def ack(self, kind: int, result: int, to: tuple[int, int], opaque: int = 0) -> None:
        self.late("MISSION_ACK", struct.pack("<BBBBI", *to, result, kind, opaque))

    def say_current(self, seq: int = 0, state: int = 0, total: int | None = None) -> None:
        count = len(self.stored()) if total is None else total
        ids = [self.ids[kind] for kind in (MISSION, FENCE, RALLY)] if self.style == "px4" else [0, 0, 0]
        self.late("MISSION_CURRENT", struct.pack("<HHBBIII", seq, count or 0xFFFF, state, 0, *ids))

    def late(self, name: str, payload: bytes) -> None:
        """A message with the fields that the dialect does not know yet."""
        self.raw(build_frame(self.dialect.message(name), payload, self.packer.sysid, 1, 0))

    # Upload.

    def on_mission_count(self, told: Told) -> None:
        kind, count = told.fields["mission_type"], told.fields["count"]
        if self.upload is not None and self.upload["from"] != told.source:
            self.ack(kind, DENIED, told.source)
            return
        self.upload = {"kind": kind, "count": count, "from": told.source, "next": 0, "new": []}
        if self.style == "ardupilot" and kind != FENCE:
            del self.plans[kind][count:]
        self.ask()

    def ask(self) -> None:
        """Ask for the next item, now and again, and give up in the end."""
        upload = self.upload
        if upload is None or self.dead or self.loses(upload["next"]):
            return
        for _ in range(self.times_asked):
            system, component = upload["from"]
            self.send(
                self.asks,
                target_system=system,
                target_component=component,
                seq=upload["next"],
                mission_type=upload["kind"],
            )
        upload.setdefault("asked", []).append(upload["next"])
        if self.timer:
            self.timer.cancel()
        if upload["asked"][-8:] == [upload["next"]] * 8:
            self.ack(upload["kind"], 15, upload["from"])
            self.upload = None
            return
        self.timer = asyncio.get_running_loop().call_later(1.0 * self.time, self.ask)

    def on_mission_item_int(self, told: Told) -> None:
        upload, fields = self.upload, told.fields
        if upload is None or upload["from"] != told.source:
            self.ack(fields["mission_type"], ERROR, told.source)
            return
        seq, kind = fields["seq"], upload["kind"]
        if seq != upload["next"]:
            if self.style == "ardupilot":
                self.ack(kind, INVALID_SEQUENCE, told.source)
            return
        if seq in self.refuses:
            self.ack(kind, self.refuses[seq], told.source)
            self.upload = None
            return
        item = self.changes(seq, {name: fields[name] for name in HOME})
        upload["new"].append(item)
        if self.style == "ardupilot" and kind != FENCE:
            self.plans[kind][seq : seq + 1] = [dict(HOME) if seq == 0 and kind == MISSION else item]
        if seq == self.dies_at:
            self.dead, self.dies_at = True, None
            return
        upload["next"] += 1
        if upload["next"] < upload["count"]:
            self.ask()
            return
        self.plans[kind] = self.plans[kind] if self.style == "ardupilot" and kind != FENCE else upload["new"]
        self.ids[kind] = self._id(self.plans[kind])
        self.upload = None
        if not self.silent_at_end:
            self.ack(kind, ACCEPTED, told.source, self.ids[kind] if self.style == "px4" else 0)

    def on_mission_clear_all(self, told: Told) -> None:
        kind = told.fields["mission_type"]
        self.plans[kind] = []
        self.ids[kind] = self._id([])
        self.ack(kind, ACCEPTED, told.source)

    def _id(self, items: list[Item]) -> int:
        return hash(str(items)) & 0xFFFFFFFF or 1

    # Download.

    def on_mission_request_list(self, told: Told) -> None:
        kind, (system, component) = told.fields["mission_type"], told.source
        if self.upload is not None:
            self.ack(kind, DENIED, told.source)
            return
        self.at = 0
        opaque = self.ids[kind] if self.style == "px4" else 0
        self.late("MISSION_COUNT", struct.pack("<HBBBI", len(self.plans[kind]), system, component, kind, opaque))

    def on_mission_request_int(self, told: Told) -> None:
        kind, seq, (system, component) = told.fields["mission_type"], told.fields["seq"], told.source
        if seq >= len(self.plans[kind]):
            self.ack(kind, INVALID_SEQUENCE, told.source)
            return
        if self.style == "px4" and seq not in (self.at, self.at - 1):
            return  # one after the other, or the last one again
        self.at = max(self.at, seq + 1)
        item = {**self.plans[kind][seq], "seq": seq, "mission_type": kind}
        self.send("MISSION_ITEM_INT", target_system=system, target_component=component, **item)


WAYPOINT = "MAV_CMD_NAV_WAYPOINT"
QUICK = TransferTimes(reply=0.1, shortest=0.02, longest=0.15, again=0.05, busy=0.3)
"""ten times as fast as life, as MissionPeer's own timeouts are"""


def waypoints(count: int, alt: float = 30.0) -> list[dict[str, Any]]:
    """A mission as do/mission_upload takes it."""
    return [
        {"command": WAYPOINT, "params": [i % 5], "x": -35.36 + i * 1e-4, "y": 149.16 - i * 2e-4, "z": alt + i / 8}
        for i in range(count)
    ]


def raw(items: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The same as an autopilot stores it."""
    return [
        {
            "frame": 3,
            "command": 16,
            "autocontinue": 1,
            "param1": item["params"][0],
            "param2": 0.0,
            "param3": 0.0,
            "param4": 0.0,
            "x": round(item["x"] * 1e7),
            "y": round(item["y"] * 1e7),
            "z": item["z"],
        }
        for item in items
    ]


FENCE_ITEMS = [
    *(
        {
            "command": "MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION",
            "frame": "MAV_FRAME_GLOBAL",
            "params": [3],
            "x": x,
            "y": y,
        }
        for x, y in ((-35.0, 149.0), (-35.0, 149.1), (-35.1, 149.0))
    ),
    {
        "command": "MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION",
        "frame": "MAV_FRAME_GLOBAL",
        "params": [25.5],
        "x": -35.05,
        "y": 149.02,
    },
]
RALLY_ITEMS = [{"command": "MAV_CMD_NAV_RALLY_POINT", "x": -35.361, "y": 149.161, "z": 40.0}]


MissionBench = Callable[..., Awaitable[tuple[Bench, MissionPeer]]]


@asynccontextmanager
async def mission_benches(bench: StartBench) -> AsyncIterator[MissionBench]:
    """What the fixture ``mission_bench`` gives: ``await mission_bench(style, pace=...)``."""
    peers: list[MissionPeer] = []

    async def start(
        style: str = "ardupilot", pace: TransferTimes = QUICK, settings: Any = None, **more: Any
    ) -> tuple[Bench, MissionPeer]:
        peer = MissionPeer(style=style, **more)
        await peer.open()
        peers.append(peer)
        b = await (await bench(peer, settings=settings)).connected()
        b.vehicle.missions.pace = pace
        return b, peer

    yield start
    for peer in peers:
        await peer.close()


async def plan(b: Bench, kind: str = "mission") -> wire.Mission:
    (reply,) = await b.ground.ask(keys.MISSION.key("demo", "quad1", kind=kind))
    if reply.ok is None:
        assert reply.err is not None
        raise wire.error_from(reply.err.payload.to_bytes())
    return wire.decode(reply.ok.payload.to_bytes(), wire.Mission, "mission")
