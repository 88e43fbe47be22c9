"""A plan goes at the autopilot's pace and not at the event loop's: the link's thread answers."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import pytest

from tests.own_thread import OwnThread
from tests.services.conftest import PATIENCE_S, StartBench, Told
from tests.services.missions.mission_peer import MISSION, MissionPeer, raw, waypoints
from zmav.waiting import in_thread

COUNT = 30


class PeerAside(OwnThread):
    """An autopilot on an event loop of its own. It waits to be let ``go_on`` before it answers ``first``, and is
    through once it was told ``last``, of an item the last one.
    """

    def __init__(self, first: str, last: str) -> None:
        super().__init__(PATIENCE_S)
        self.peer = MissionPeer()
        self.peer.load(MISSION, raw(waypoints(COUNT, alt=99.0)))
        self.begun, self.go_on, self.through = threading.Event(), threading.Event(), threading.Event()
        answer: Callable[[Told], None] = getattr(self.peer, first)

        def held(told: Told) -> None:
            self.begun.set()
            assert self.go_on.wait(PATIENCE_S)
            answer(told)

        def heard(told: Told) -> None:
            if told.name == last and told.fields.get("seq", COUNT) == COUNT:
                self.through.set()

        setattr(self.peer, first, held)
        self.peer.on_told = heard

    async def live(self, ready: Future[None]) -> None:
        await self.peer.open()
        ready.set_result(None)
        await self.stop.wait()
        await self.peer.close()


@pytest.mark.parametrize(
    ("verb", "args", "first", "last"),
    [
        ("mission_download", {}, "on_mission_request_list", "MISSION_ACK"),
        ("mission_upload", {"items": waypoints(COUNT)}, "on_mission_count", "MISSION_ITEM_INT"),
    ],
)
async def test_a_plan_goes_on_while_the_event_loop_is_held(
    bench: StartBench, verb: str, args: dict[str, Any], first: str, last: str
) -> None:
    with PeerAside(first, last) as aside:
        b = await (await bench(aside.peer)).connected()
        order = asyncio.create_task(b.ground.do(verb, **args))
        assert await in_thread(aside.begun.wait, PATIENCE_S)
        aside.go_on.set()
        assert aside.through.wait(PATIENCE_S)  # here: nothing else runs on the event loop meanwhile
        assert (await order).result["count"] == COUNT
