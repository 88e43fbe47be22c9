"""Logs beside the autopilot: listed, fetched over good links and bad ones, erased, refused while armed."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.services.files.disk import PATIENCE_S, Disk, disk, noise, same
from zmav import wire
from zmav.errors import BadInput, Refused, TimedOut
from zmav.mavlink.ftp import crc32
from zmav.services.files.store import Store

if TYPE_CHECKING:
    from tests.conftest import Net, StartOnboard


def _stored(result: dict[str, Any]) -> wire.StoredFile:
    return wire.StoredFile(**result)


async def get(d: Disk, log: int) -> wire.StoredFile:
    return _stored(await d.onboard.logs.get(wire.LogGet(log=log), lambda news: None))


async def test_logs_are_listed_with_their_size_and_time(net: Net, onboard: StartOnboard, tmp_path: Path) -> None:
    async with disk(net, onboard, tmp_path) as d:
        assert await d.v.logs.list() == []
        before = time.time()
        for size in (100, 0, 90_000):
            d.log(noise(size))
        logs = await d.v.logs.list()
        assert [(log.id, log.size) for log in logs] == [(1, 100), (2, 0), (3, 90_000)]
        for log in logs:
            assert log.t == pytest.approx(before, abs=60.0)
            assert log.name.startswith(f"log_{log.id}_20")
            assert log.name.endswith(".bin")


async def test_a_log_comes_whole(net: Net, onboard: StartOnboard, tmp_path: Path) -> None:
    async with disk(net, onboard, tmp_path) as d:
        d.log(noise(100))
        data = d.log(noise(200_003))
        (_, entry) = await d.v.logs.list()
        said: list[dict[str, Any]] = []
        target = await d.v.logs.get(entry, tmp_path, said.append)
        assert target == tmp_path / entry.name
        same(target.read_bytes(), data)
        assert {news["stage"] for news in said} <= {"autopilot", "network"}
        stored = await get(d, 2)
        assert (stored.by, stored.crc32) == ("store", crc32(data))


async def test_sizes_at_the_edges(net: Net, onboard: StartOnboard, tmp_path: Path, subtests: pytest.Subtests) -> None:
    async with disk(net, onboard, tmp_path) as d:
        for number, size in enumerate((0, 1, 89, 90, 91, 90 * 8, 90 * 9), 1):
            with subtests.test(size=size):
                data = d.log(noise(size))
                same((await d.v.logs.get(number, tmp_path / f"log{number}")).read_bytes(), data)


async def test_a_bad_link_costs_time_and_nothing_else(net: Net, onboard: StartOnboard, tmp_path: Path) -> None:
    async with disk(net, onboard, tmp_path, "lossy:{}?loss=0.2&delay=0.02&seed=6") as d:
        d.log(noise(10))
        data = d.log(noise(40_000))
        assert len(await d.v.logs.list()) == 2
        same((await d.v.logs.get(2, tmp_path / "log")).read_bytes(), data)


async def test_an_interrupted_log_is_gone_on_with(net: Net, onboard: StartOnboard, tmp_path: Path) -> None:
    async with disk(net, onboard, tmp_path) as d:
        data = d.log(noise(1_500_000))
        under_way = asyncio.Event()

        def report(news: dict[str, Any]) -> None:
            if news.get("bytes", 0) > 10_000:
                under_way.set()

        task = asyncio.ensure_future(d.onboard.logs.get(wire.LogGet(log=1), report))
        await asyncio.wait_for(under_way.wait(), PATIENCE_S)
        await d.v.files.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        d.onboard.files.store = Store(d.onboard.files.store.directory)
        stored = await get(d, 1)
        assert 10_000 < stored.resumed < len(data)
        assert stored.crc32 == crc32(data)


async def test_an_armed_ardupilot_gives_out_no_logs(net: Net, onboard: StartOnboard, tmp_path: Path) -> None:
    async with disk(net, onboard, tmp_path, speed=4.0) as d:
        d.log(noise(100))
        await d.v.arm()
        for asked in (d.v.logs.list(), d.v.logs.get(1, tmp_path), d.v.logs.erase()):
            with pytest.raises(Refused, match="no logs while it is armed") as caught:
                await asked
            assert caught.value.detail["reasons"] == ["Disarm for log download"]
        await d.v.disarm()
        assert [log.id for log in await d.v.logs.list()] == [1, 2]


async def test_erasing_is_seen_through(net: Net, onboard: StartOnboard, tmp_path: Path) -> None:
    async with disk(net, onboard, tmp_path) as d:
        d.log(noise(100))
        d.log(noise(200))
        assert await d.v.logs.erase() == 2
        assert await d.v.logs.list() == []
        assert await d.v.logs.erase() == 0


async def test_what_is_no_log_is_said(net: Net, onboard: StartOnboard, tmp_path: Path) -> None:
    async with disk(net, onboard, tmp_path) as d:
        d.log(noise(100))
        with pytest.raises(BadInput, match="there is no log 7"):
            await d.v.logs.get(7, tmp_path)


async def test_an_autopilot_without_logs_is_given_up(
    net: Net,
    onboard: StartOnboard,
    tmp_path: Path,
) -> None:
    async with disk(net, onboard, tmp_path) as d:
        d.onboard.logs.patience, d.onboard.logs.give_up = 0.2, 0.5
        d.call(lambda: d.world.vehicles[0].node.answer("LOG_REQUEST_LIST", lambda channel, msg, sender: None))
        with pytest.raises(TimedOut, match="may have no log"):
            await d.v.logs.list()
