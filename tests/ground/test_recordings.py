"""What is played again is heard by who names its fleet, and by nobody who listens to vehicles, of all fleets or one."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest
import zenoh

import zmav
from ground.record.folder import Folder
from ground.record.history import END
from ground.record.part import Asked
from ground.record.recorder import Recorder, Wanted
from ground.record.storage import RecordingSettings
from ground.top.watch import Watch as TopWatch
from zmav import keys, wire
from zmav.client import Answer, Client

if TYPE_CHECKING:
    from tests.conftest import Net

PATIENCE_S = 30.0
EVENT = b'{"t": 1.0, "kind": "mode", "severity": "info", "text": "%s"}'
REST = (
    "state",
    "event",
    "link/autopilot",
    "agent/ev1/status",
    "mav/rx/1/1/ATTITUDE",
    "setpoint/x",
    "agent/ev1/out/signals",
)


class Two(NamedTuple):
    """A fleet that flies and the same one played again; who listens is a client of all fleets."""

    net: Net
    router: zenoh.Session
    endpoint: str
    z: Client

    def put(self, rest: str, flown: bytes, played: bytes) -> None:
        """The recording's first: who is told of the other has been told of it before."""
        for fleet, data in (("demo-replay", played), ("demo", flown)):
            key = f"zmav/{fleet}/quad1/{rest}"
            self.router.put(key, data, congestion_control=zenoh.CongestionControl.BLOCK)


@pytest.fixture
async def two(net: Net) -> AsyncIterator[Two]:
    router, endpoint = net.router()
    async with zmav.open(fleet="*", connect=[endpoint]) as z:
        yield Two(net, router, endpoint, z)


@pytest.mark.parametrize("rest", REST)
async def test_who_listens_to_all_fleets_hears_no_recording(two: Two, rest: str) -> None:
    async with two.z.subscribe(f"*/{rest}") as heard, two.z.subscribe(f"zmav/demo-replay/*/{rest}") as played:
        for fleet in ("demo", "demo-replay"):
            await two.net.linked(two.router, f"zmav/{fleet}/quad1/{rest}")
        two.put(rest, b"flown", b"played")
        sample = await asyncio.wait_for(heard.get(), PATIENCE_S)
        assert (str(sample.key_expr), sample.payload.to_bytes()) == (f"zmav/demo/quad1/{rest}", b"flown")
        assert (await asyncio.wait_for(played.get(), PATIENCE_S)).payload.to_bytes() == b"played"


async def test_past_events_are_of_vehicles(two: Two) -> None:
    """Those that a publisher keeps, which come first where somebody asks for them."""
    publishers = [
        zenoh.ext.declare_advanced_publisher(
            two.router,
            keys.EVENT.key(fleet, "quad1"),
            cache=zenoh.ext.CacheConfig(max_samples=5),
            publisher_detection=True,
        )
        for fleet in ("demo-replay", "demo")
    ]
    for publisher in publishers:
        publisher.put(EVENT % b"before")
    async with two.z.subscribe("*/event", history=5) as events:
        first = await asyncio.wait_for(events.get(), PATIENCE_S)
        assert str(first.key_expr) == "zmav/demo/quad1/event"
        for publisher in publishers:
            publisher.put(EVENT % b"now")
        assert str((await asyncio.wait_for(events.get(), PATIENCE_S)).key_expr) == "zmav/demo/quad1/event"


async def test_no_recording_answers_who_asks_all_fleets(two: Two) -> None:
    def reply(query: zenoh.Query) -> None:
        for fleet in ("demo-replay", "demo"):
            if query.key_expr.intersects(key := f"zmav/{fleet}/quad1/msg/ATTITUDE"):
                query.reply(key, fleet.encode())

    queryable = two.router.declare_queryable("zmav/*/quad1/msg/ATTITUDE", reply, complete=True)
    for asked, answers in (("*", [b"demo"]), ("demo", [b"demo"]), ("demo-replay", [b"demo-replay"])):
        found = await two.z.ask(f"zmav/{asked}/quad1/msg/ATTITUDE", timeout=PATIENCE_S, channel=keys.MSG)
        assert [answer.payload for answer in found if isinstance(answer, Answer)] == answers
    queryable.undeclare()


async def test_no_recording_is_recorded_with_all_fleets(two: Two, tmp_path: Path) -> None:
    with Folder(tmp_path) as folder:
        async with Recorder(
            two.z, folder, RecordingSettings(keep_free=0), Wanted(name="gs"), lambda line: None
        ) as recorder:
            for fleet in ("demo", "demo-replay"):
                for rest in ("event", "setpoint/x"):
                    await two.net.linked(two.router, f"zmav/{fleet}/quad1/{rest}")
            for rest in ("event", "setpoint/x"):
                two.put(rest, EVENT % b"flown", EVENT % b"played")
            while not all(_kept(recorder, "demo", what) for what in ("event", "setpoint")):
                await asyncio.sleep(0.05)
            assert not any(_kept(recorder, "demo-replay", what) for what in ("event", "setpoint"))


def _kept(recorder: Recorder, fleet: str, channel: str) -> list[Any]:
    return list(recorder.storage.history.newest(Asked(fleet, "quad1", channel), 0, END, 1000)[0])


async def test_the_monitor_of_all_fleets_tells_of_no_recording(two: Two) -> None:
    """Neither of the vehicle nor of its events and agents."""
    watch = TopWatch(two.z)
    running = asyncio.create_task(watch.run())
    for fleet in ("demo", "demo-replay"):
        for rest in ("event", "agent/ev1/status", "state"):
            await two.net.linked(two.router, f"zmav/{fleet}/quad1/{rest}")
    two.put("agent/ev1/status", *(_status(state) for state in ("flown", "played")))
    two.put("event", EVENT % b"flown", EVENT % b"played")
    two.put("state", *(_state(fleet) for fleet in ("demo", "demo-replay")))
    while not ((found := watch.report().vehicles) and found[0].events and watch.report().agents):
        await asyncio.sleep(0.05)
    report = watch.report()
    running.cancel()
    assert [(v.fleet, v.name, [e.text for e in v.events]) for v in report.vehicles] == [("demo", "quad1", ["flown"])]
    assert [agent.state for agent in report.agents] == ["flown"]


def _status(state: str) -> bytes:
    return wire.encode(wire.AgentStatus(t=1.0, agent="ev1", state=state))


def _state(fleet: str) -> bytes:
    return wire.encode(wire.VehicleState(t=1.0, fleet=fleet, name="quad1", instance=fleet))
