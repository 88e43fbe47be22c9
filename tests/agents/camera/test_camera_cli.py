"""``zmav camera run|view`` as processes and in this one, beside a real router."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import pytest
from click.testing import CliRunner, Result

import zmav
from agents.camera.cli import camera
from tests.agents.camera.conftest import write_pictures
from zmav.errors import BadConfig, TimedOut, VehicleError
from zmav.vision.reader import camera_info

if TYPE_CHECKING:
    from tests.agents.camera.conftest import Run, StartCamera
    from tests.conftest import Net


def invoke(*arguments: str) -> Result:
    return CliRunner().invoke(camera, arguments, catch_exceptions=False)


async def test_a_camera_runs_says_what_it_is_and_is_looked_at(net: Net, start: StartCamera, tmp_path: Path) -> None:
    _, endpoint = net.router()
    pictures = write_pictures(tmp_path / "pictures", 20)
    mount = ("--mount", "0,90,0", "--offset", "0.1,0,0.02", "--fov", "90")
    agent = start("run", str(pictures), "--vehicle", "quad1", "--name", "nose", "--loop", "-e", endpoint, *mount)
    await asyncio.to_thread(agent.expect, "demo/quad1/nose")
    async with zmav.open(connect=[endpoint]) as z:
        told = await camera_info(z, "quad1", "nose")
    assert told.camera == "nose"
    assert told.mount == pytest.approx((0.0, 1.5708, 0.0), abs=1e-4)
    assert told.offset == (0.1, 0.0, 0.02)
    assert told.focal[0] == pytest.approx(0.5 * told.width)
    viewer = start("view", "quad1", "--name", "nose", "--record", str(tmp_path / "seen"), "-e", endpoint)
    await asyncio.to_thread(viewer.expect, "written")
    await asyncio.to_thread(viewer.stop)
    image = cv2.imread(str(tmp_path / "seen" / "00000000.jpg"))
    assert image is not None
    assert image.shape[0] in (120, 240)  # half of it where the budget is low
    assert await asyncio.to_thread(agent.stop) == 0
    assert "pictures sent" in agent.stderr


async def test_what_comes_is_told_each_second(net: Net, run_camera: Run, start: StartCamera) -> None:
    _, endpoint = net.router()
    await run_camera(endpoint, budget=1e6)
    viewer = start("view", "quad1", "-e", endpoint)
    line = await asyncio.to_thread(viewer.expect, "Hz")
    assert "torn" in line
    await asyncio.to_thread(viewer.stop)
    assert "Traceback" not in viewer.stderr


def test_a_viewer_says_what_is_missing(net: Net) -> None:
    _, endpoint = net.router()
    with pytest.raises(VehicleError, match="has no camera 'down'"):
        invoke("view", "quad1", "-e", endpoint, "--wait", "0.3")


async def test_a_camera_without_pictures_is_told_from_none(net: Net, run_camera: Run) -> None:
    _, endpoint = net.router()
    await run_camera(endpoint, most=2e6, rate=0.2, budget=4e3)
    with pytest.raises(TimedOut, match="is there, but sent no whole picture"):
        await asyncio.to_thread(invoke, "view", "quad1", "-e", endpoint, "--wait", "0.1")


WRONG = {
    "size": (("run", "0", "--vehicle", "quad1", "--size", "big"), "not like 640x480"),
    "mount": (("run", "0", "--vehicle", "quad1", "--mount", "1,2"), "not three numbers"),
    "budget": (("run", "0", "--vehicle", "quad1", "--budget", "much"), "expected 1Mbit/s, 60kB/s"),
    "vehicle": (("run", "0"), "Missing option '--vehicle'"),
}


@pytest.mark.parametrize("what", WRONG)
def test_wrong_usage_is_said(what: str) -> None:
    arguments, words = WRONG[what]
    done = invoke(*arguments)
    assert done.exit_code == 2
    assert words in done.output


def test_what_cannot_be_run() -> None:
    with pytest.raises(BadConfig, match="not both"):
        invoke("run", "0", "--vehicle", "quad1", "--fov", "60", "--calibration", "a.toml")
    with pytest.raises(BadConfig, match="no camera /dev/video99"):
        invoke("run", "99", "--vehicle", "quad1")


@pytest.mark.parametrize("verb", ["run", "view"])
def test_every_verb_explains_itself(verb: str) -> None:
    done = invoke(verb, "--help")
    assert done.exit_code == 0
    assert "Usage:" in done.output
