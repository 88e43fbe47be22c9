"""When a process starts again because its router is out of date: not before it may, and not when it could not."""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import signal
from collections.abc import AsyncIterator

import pytest
import zenoh

from mesh.plan import RouterPlan, plan_router
from mesh.router import Router
from mesh.running import until_outdated
from zmav.errors import BadConfig
from zmav.session import SessionSettings

PATIENCE_S = 30.0


class Due:
    """A part of a router that finds it out of date at once."""

    async def outdated(self) -> str:
        return "wlan0 has come"


@contextlib.asynccontextmanager
async def due(session: zenoh.Session, plan: RouterPlan) -> AsyncIterator[Due]:
    yield Due()


@pytest.fixture
async def router() -> AsyncIterator[Router]:
    settings = SessionSettings(listen=["tcp/127.0.0.1:0"], cfg=["scouting/delay:0"])
    async with Router(plan_router(None, "quad1", settings), settings, (due,)) as opened:
        yield opened


async def test_a_vehicle_that_flies_goes_on_and_so_does_one_that_could_not_start_again(
    router: Router, capsys: pytest.CaptureFixture[str]
) -> None:
    flying, looks = True, 0
    wrong: BadConfig | None = BadConfig("the certificate has expired")
    asked, planned = asyncio.Event(), asyncio.Event()
    loop = asyncio.get_running_loop()

    def idle() -> bool:
        nonlocal looks
        looks += 1
        if looks == 5:
            asked.set()
        return not flying

    def plan() -> None:
        loop.call_soon_threadsafe(planned.set)
        if wrong is not None:
            raise wrong

    ended = asyncio.ensure_future(until_outdated(router, "quad1 is up", plan, idle, pace=0.02))
    await asyncio.wait_for(asked.wait(), PATIENCE_S)
    assert not ended.done()
    assert not planned.is_set()
    flying = False
    for _ in range(3):
        planned.clear()
        await asyncio.wait_for(planned.wait(), PATIENCE_S)
    assert not ended.done()
    wrong = None
    assert await asyncio.wait_for(ended, PATIENCE_S) == "wlan0 has come"
    said = capsys.readouterr().err.splitlines()
    assert all(re.fullmatch(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d{3} .*", line) for line in said), said
    assert [line[24:] for line in said] == [
        "quad1 is up",
        "wlan0 has come: starting again as soon as the vehicle is disarmed and nobody commands it",
        "wlan0 has come, but this could not start again: the certificate has expired",
    ]


async def test_who_takes_off_meanwhile_goes_on(router: Router) -> None:
    """Planning takes a moment: what may be is looked at again after it."""
    answers = iter([True, False, False, True, True])
    assert await asyncio.wait_for(
        until_outdated(router, "", lambda: None, lambda: next(answers), pace=0.02), PATIENCE_S
    )
    assert next(answers, None) is None


async def test_asked_to_end_it_does_not_start_again(router: Router) -> None:
    asked = asyncio.Event()

    def idle() -> bool:
        asked.set()
        return False

    ended = asyncio.ensure_future(until_outdated(router, "", lambda: None, idle, pace=0.02))
    await asyncio.wait_for(asked.wait(), PATIENCE_S)
    os.kill(os.getpid(), signal.SIGTERM)
    assert await asyncio.wait_for(ended, PATIENCE_S) is None
