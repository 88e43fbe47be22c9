"""Photos beside the camera: whole pictures with their time and place, series, zoom, and what is refused."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import os
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from PIL import Image

import zmav
from agents.camera.photos import Photos
from agents.camera.settings import Calibration, cropped
from tests.agents.camera.conftest import Painted, scene
from tests.waiting import until
from zmav import keys, wire
from zmav.errors import BadConfig, BadInput, Refused
from zmav.session import SessionSettings

if TYPE_CHECKING:
    from tests.agents.camera.conftest import Run
    from tests.conftest import Net

GPS, EXIF = 0x8825, 0x8769
LARGE = (1280, 960)
Open = Callable[..., Any]


@pytest.fixture
async def photos(net: Net, run_camera: Run, tmp_path: Path) -> AsyncIterator[Open]:
    async with contextlib.AsyncExitStack() as stack:

        async def start(source: Any = None, **how: Any) -> tuple[Photos, zmav.Vehicle]:
            _, endpoint = net.router()
            camera = await run_camera(endpoint, source or Painted(width=LARGE[0], height=LARGE[1]))
            z = await stack.enter_async_context(zmav.open(settings=SessionSettings(connect=[endpoint])))
            found = Photos(z, camera, tmp_path / "kept", **how)
            await stack.enter_async_context(found)
            telling = asyncio.create_task(found.run())
            stack.callback(telling.cancel)
            return found, z.vehicle("quad1")

        yield start


def tell_state(found: Photos) -> None:
    """The vehicle says where it is: it flies north."""
    place = wire.GlobalPosition(lat_deg=-35.363262, lon_deg=149.165237, alt_amsl=604.25, alt_rel=20.25)
    state = wire.VehicleState(
        t=10.0,
        fleet="demo",
        name="quad1",
        instance="x",
        position=place,
        velocity=(0.0, 0.0, 0.0),
        attitude=wire.Attitude(roll=0.1, pitch=-0.2, yaw=1.5),
    )
    found.z.put(keys.STATE, keys.STATE.key("demo", "quad1"), state)


async def test_a_photo_is_the_whole_picture_with_its_time_and_place(photos: Open, tmp_path: Path) -> None:
    found, vehicle = await photos()
    tell_state(found)
    await until(lambda: found.vehicle.last_state is not None, "the vehicle's state")
    told = await vehicle.tell("photos-down", "photo")
    assert told["number"] == found.taken == 1
    file = tmp_path / "kept" / "quad1-down-00001.jpg"
    assert told["file"] == str(file)
    with Image.open(file) as image:
        assert image.size == LARGE
        exif = image.getexif()
        gps, inner = exif.get_ifd(GPS), exif.get_ifd(EXIF)
    assert (gps[1], gps[3]) == ("S", "E")
    degrees = [float(sum(part / 60**i for i, part in enumerate(gps[tag]))) for tag in (2, 4)]
    assert degrees == pytest.approx([35.363262, 149.165237], abs=1e-8)
    assert float(gps[6]) == pytest.approx(604.25)
    assert inner[0x9003].startswith("20")
    beside = json.loads(file.with_suffix(".json").read_text())
    assert beside["attitude"] == {"roll": 0.1, "pitch": -0.2, "yaw": 1.5}
    assert beside["t"] == told["t"]
    assert (beside["width"], beside["height"]) == LARGE


async def test_one_without_a_place_has_none(photos: Open) -> None:
    _, vehicle = await photos()
    told = await vehicle.tell("photos-down", "photo")
    assert told["position"] is told["attitude"] is None
    with Image.open(told["file"]) as image:
        assert GPS not in image.getexif()


async def test_a_series_ends_with_its_count_or_its_end(photos: Open) -> None:
    found, vehicle = await photos()
    await vehicle.tell("photos-down", "photo", every=0.2, count=3)
    await until(lambda: found.taken == 3, "three photos")
    await asyncio.sleep(0.5)
    assert found.taken == 3
    await vehicle.tell("photos-down", "photo", every=0.2, count=0)
    await until(lambda: found.taken >= 5, "two more")
    taken = (await vehicle.tell("photos-down", "stop"))["taken"]
    await asyncio.sleep(0.5)
    assert found.taken <= taken + 1  # one was being written


async def test_a_photo_that_is_being_written_is_kept_where_its_series_ends(photos: Open, tmp_path: Path) -> None:
    slow = tmp_path / "kept" / "quad1-down-00001.json.part"
    slow.parent.mkdir()
    os.mkfifo(slow)  # it takes what is written once somebody reads
    found, vehicle = await photos()
    await vehicle.tell("photos-down", "photo", every=0.2, count=2)
    await asyncio.sleep(1.0)
    assert found.taken == 0
    second = asyncio.create_task(vehicle.tell("photos-down", "photo"))  # which ends the series
    await asyncio.sleep(0.3)
    await asyncio.to_thread(slow.read_bytes)
    assert (await second)["number"] == 2
    names = sorted(path.name for path in slow.parent.glob("*.jpg"))
    assert names == ["quad1-down-00001.jpg", "quad1-down-00002.jpg"]


async def test_numbers_go_on_where_they_ended(photos: Open, tmp_path: Path) -> None:
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "quad1-down-00041.jpg").touch()
    found, vehicle = await photos()
    assert found.taken == 41
    assert (await vehicle.tell("photos-down", "photo"))["number"] == 42


async def test_what_cannot_be_is_refused(photos: Open) -> None:
    _, vehicle = await photos()
    for args, field in (({"every": 0.01, "count": 2}, "every"), ({"count": -1}, "count"), ({"count": 5}, "every")):
        with pytest.raises(BadInput) as caught:
            await vehicle.tell("photos-down", "photo", **args)
        assert caught.value.detail["field"] == field
    for factor in (0.5, 9.0):
        with pytest.raises(BadInput, match="factor"):
            await vehicle.tell("photos-down", "zoom", factor=factor)


async def test_a_full_disk_is_refused(photos: Open) -> None:
    found, vehicle = await photos(keep_free=math.inf)
    for args in ({}, {"every": 1.0, "count": 2}):
        with pytest.raises(Refused, match="no photo is taken"):
            await vehicle.tell("photos-down", "photo", **args)
    assert found.taken == 0


async def test_a_folder_that_is_gone(photos: Open, tmp_path: Path) -> None:
    found, vehicle = await photos()
    (tmp_path / "kept").rmdir()
    with pytest.raises(Refused, match="0 MB are free"):
        await vehicle.tell("photos-down", "photo")
    await vehicle.tell("photos-down", "zoom", factor=2.0)
    assert found.taken == 0


async def test_a_source_without_pictures_is_told_of(photos: Open) -> None:
    _, vehicle = await photos(Painted(count=0))
    with pytest.raises(Refused, match="no picture came within 3 s: the source has ended"):
        await vehicle.tell("photos-down", "photo")


async def test_a_folder_that_cannot_be_written_to(net: Net, run_camera: Run, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    _, endpoint = net.router()
    camera = await run_camera(endpoint)
    async with zmav.open(settings=SessionSettings(connect=[endpoint])) as z:
        with pytest.raises(BadConfig, match="cannot keep photos"):
            Photos(z, camera, tmp_path / "file")


async def test_zoom_sends_the_middle_and_says_so(photos: Open) -> None:
    found, vehicle = await photos(Painted(width=640, height=480))
    before = found.camera.info()
    await vehicle.tell("photos-down", "zoom", factor=2.0)
    after = found.camera.info()
    assert after.focal[0] == pytest.approx(2.0 * before.focal[0])
    assert after.center == pytest.approx(before.center)
    await until(lambda: found.camera.zoom == 2.0, "the zoom")
    told = await vehicle.tell("photos-down", "photo")
    assert (told["width"], told["height"]) == (640, 480)


def test_a_pixel_keeps_its_ray_under_zoom() -> None:
    """What lies at the middle of the crop's quarter lies twice as far from the middle."""
    lens = Calibration(width=640, height=480, focal=(500.0, 510.0), center=(330.0, 250.0))
    closer = lens.zoomed(2.0)
    u = 400.0
    ray = (u - lens.center[0]) / lens.focal[0]
    middle = 319.5
    assert (2.0 * (u - middle) + middle - closer.center[0]) / closer.focal[0] == pytest.approx(ray)
    image = scene(1, 640, 480)
    assert cropped(image, 2.0).shape == (240, 320, 3)
    assert cropped(image, 1.0) is image
