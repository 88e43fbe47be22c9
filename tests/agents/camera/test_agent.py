"""The agent and a reader over real sessions: whole pictures, losses, narrow links, who reads and who does not."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import msgspec
import pytest

import zmav
from agents.camera.settings import Calibration, CameraSettings
from tests.agents.camera.conftest import Painted, Way, losing
from tests.conftest import PATIENCE_S
from tests.waiting import until
from zmav import keys, wire
from zmav.errors import BadConfig, BadKey, VehicleError
from zmav.session import SessionSettings
from zmav.vision.reader import Picture, Reader, camera_info
from zmav.waiting import within

if TYPE_CHECKING:
    from tests.agents.camera.conftest import Run
    from tests.conftest import Net


def reading(endpoint: str) -> Any:
    return zmav.open(settings=SessionSettings(connect=[endpoint]))


async def take(reader: Reader, count: int) -> list[Picture]:
    return [await within(PATIENCE_S, reader.get()) for _ in range(count)]


async def test_pictures_arrive_whole_and_in_order(net: Net, run_camera: Run) -> None:
    _, endpoint = net.router()
    agent = await run_camera(endpoint, budget=1e6, quality=80)
    async with reading(endpoint) as z, Reader(z, "quad1") as reader:
        pictures = await take(reader, 8)
        assert [p.seq for p in pictures] == sorted({p.seq for p in pictures})
        for picture in pictures:
            assert picture.decode().shape == (240, 320, 3)
            assert (picture.width, picture.height) == (320, 240)
            assert picture.t <= picture.arrived
        assert reader.assembler.torn == reader.assembler.bad == 0
        info = await camera_info(z, "quad1", "down")
    assert (info.camera, info.width, info.height, info.source) == ("down", 320, 240, "painted")
    assert info.center == (159.5, 119.5)
    assert agent.bad == agent.failed == 0


async def test_nothing_is_sent_while_nobody_reads(net: Net, run_camera: Run) -> None:
    _, endpoint = net.router()
    agent = await run_camera(endpoint, budget=1e6)
    await until(lambda: agent.capture.count >= 5, "pictures of the source")
    assert (agent.sent, agent.watched) == (0, False)
    async with reading(endpoint) as z:
        async with Reader(z, "quad1") as reader:
            await take(reader, 2)
            assert agent.watched
        await until(lambda: not agent.watched, "the reader's leaving")
        await asyncio.sleep(0)
        sent, seen = agent.sent, agent.capture.count
        await until(lambda: agent.capture.count >= seen + 5, "more pictures of the source")
        assert agent.sent <= sent + 1  # one was under way


async def test_reports_reach_the_camera_and_go_with_their_reader(net: Net, run_camera: Run) -> None:
    _, endpoint = net.router()
    agent = await run_camera(endpoint, budget=100e3)
    async with reading(endpoint) as z, Reader(z, "quad1", name="eye", most_bytes=30e3) as reader:
        await until(lambda: bool(agent.budget.links), "a report")
        (name,) = agent.budget.links
        assert name.startswith("eye-")
        assert agent.budget.bytes <= 30e3
        await until(lambda: reader.report is not None and reader.report.whole > 0, "a report of whole pictures")
        assert reader.report is not None
        assert reader.report.delay is not None
        assert reader.report.rate_bytes > 0.0
        key = keys.FRAME_REPORT.key("demo", "quad1", camera="down", reader="broken")
        z.put(keys.FRAME_REPORT, key, b"{}")
        await until(lambda: agent.bad == 1, "the broken report")
    assert list(agent.budget.links) == [name]


@pytest.mark.parametrize("share", [0.1, 0.3])
async def test_a_lossy_link_is_met_by_parity(net: Net, run_camera: Run, share: float) -> None:
    (near, here), (far, there) = net.router(), net.router()
    agent = await run_camera(here, Painted(rate=15.0), rate=15.0, budget=250e3, quality=60)
    way = Way(near, far, losing(share))
    async with reading(there) as z, Reader(z, "quad1") as reader:
        await until(lambda: agent.budget.loss > 0.6 * share and bool(agent.budget.links), "the camera's knowing of it")
        await until(lambda: reader.report is not None and reader.report.whole > 2, "whole pictures")
        await take(reader, 4)
        counts = reader.assembler
        whole, torn = counts.whole, counts.torn
        await until(lambda: counts.whole + counts.torn >= whole + torn + 30, "30 pictures more")
        assert counts.whole - whole >= 0.85 * (counts.whole + counts.torn - whole - torn)
        assert counts.mended > 0
    assert way.lost > 0.5 * share * way.carried


async def test_a_narrow_link_is_not_overrun(net: Net, run_camera: Run) -> None:
    """60 kB/s into a link of 30 kB/s that drops what is too much: pictures become smaller until they pass."""
    (near, here), (far, there) = net.router(), net.router()
    agent = await run_camera(here, Painted(width=480, height=360), budget=60e3, size=(480, 360))
    way = Way(near, far, rate=30e3)
    async with reading(there) as z, Reader(z, "quad1") as reader:
        await until(lambda: agent.budget.bytes < 36e3, "a smaller budget")
        await until(lambda: agent.quality.step.half and agent.size == (240, 180), "smaller pictures")
        lost, carried, torn, whole = way.lost, way.carried, reader.assembler.torn, reader.assembler.whole
        await until(lambda: reader.assembler.whole >= whole + 8, "8 whole pictures more")
        assert way.lost - lost < 0.25 * (way.carried - carried)
        assert reader.assembler.torn - torn <= 3
        async with reading(here) as beside:
            info = await camera_info(beside, "quad1", "down")
    assert info.focal[0] == pytest.approx(info.width / 2 / 0.6131, rel=1e-3)  # 1.1 rad wide at any size


async def test_its_status_tells_how_pictures_are_sent(net: Net, run_camera: Run) -> None:
    _, endpoint = net.router()
    await run_camera(endpoint, budget=1e6)
    key = keys.AGENT_STATUS.key("demo", "quad1", agent="camera-down")
    async with (
        reading(endpoint) as z,
        Reader(z, "quad1") as reader,
        z.subscribe(key, lambda sample: wire.decode(sample.payload.to_bytes(), wire.AgentStatus, "")) as said,
    ):
        await take(reader, 4)
        while not (status := await within(PATIENCE_S, said.get())).text.startswith("320x240"):
            assert status.state in ("sending", "waiting")
    assert status.text.startswith("320x240, full size, quality 70, 10 Hz")


async def test_who_reads_slowly_gets_the_newest(net: Net, run_camera: Run) -> None:
    _, endpoint = net.router()
    await run_camera(endpoint, Painted(rate=50.0), rate=50.0, budget=2e6)
    async with reading(endpoint) as z, Reader(z, "quad1") as reader:
        await take(reader, 1)
        await until(lambda: reader.skipped >= 3, "pictures that nobody took")
        newest = reader.assembler.seq
        (picture,) = await take(reader, 1)
    assert picture.seq == newest


async def test_the_cameras_of_a_fleet(net: Net, run_camera: Run) -> None:
    _, endpoint = net.router()
    await run_camera(endpoint, gimbal=True)
    await run_camera(endpoint, camera="front", mount=(0.0, 1.57, 0.0), lens=Calibration.by_angle(1.0, 640, 640))
    async with reading(endpoint) as z:
        down = await camera_info(z, "quad1", "down")
        assert (down.camera, down.gimbal) == ("down", True)
        with pytest.raises(BadConfig, match="another shape"):
            await camera_info(z, "quad1", "front")
        with pytest.raises(VehicleError, match="no camera 'rear'"):
            await camera_info(z, "quad1", "rear", timeout=0.5)


async def test_a_source_that_ends_ends_the_sending(net: Net, run_camera: Run) -> None:
    _, endpoint = net.router()
    async with reading(endpoint) as z, Reader(z, "quad1") as reader:
        agent = await run_camera(endpoint, Painted(count=3), budget=1e6)
        await within(PATIENCE_S, agent.ended.wait())
        key = keys.AGENT_STATUS.key("demo", "quad1", agent="camera-down")
        async with z.subscribe(
            key, lambda sample: wire.decode(sample.payload.to_bytes(), wire.AgentStatus, "")
        ) as said:
            while (status := await within(PATIENCE_S, said.get())).state != "ended":
                assert status.state in ("sending", "waiting")
        assert status.detail["sent"] == agent.sent
        await until(lambda: reader.assembler.whole > 0, "a picture")


@pytest.mark.parametrize(
    ("wrong", "error"),
    [
        ({"rate": 0.0}, BadConfig),
        ({"quality": 101}, BadConfig),
        ({"size": (8, 8)}, BadConfig),
        ({"budget": 3e3}, BadConfig),
        ({"camera": "Front"}, BadKey),
        ({"vehicle": "a/b"}, BadKey),
    ],
)
def test_settings_that_cannot_be(wrong: dict[str, Any], error: type[Exception]) -> None:
    with pytest.raises(error):
        msgspec.structs.replace(CameraSettings(vehicle="quad1"), **wrong).check()
