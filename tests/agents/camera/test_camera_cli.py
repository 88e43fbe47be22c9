"""``zmav camera run|view|list|calibrate`` as processes and in this one, beside a real router."""

from __future__ import annotations

import asyncio
import json
import urllib.request
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import pytest
from click.testing import CliRunner, Result

from agents.camera.cli import camera
from agents.camera.mjpeg import part
from tests.agents.camera.conftest import write_video
from zmav.errors import BadConfig, PortInUse, TimedOut, VehicleError
from zmav.vision.opencv import decode

if TYPE_CHECKING:
    from tests.agents.camera.conftest import Run, StartCamera
    from tests.conftest import Net

PATIENCE_S = 30.0


def invoke(*arguments: str) -> Result:
    return CliRunner().invoke(camera, arguments, catch_exceptions=False)


async def test_a_camera_runs_is_listed_and_looked_at(net: Net, start: StartCamera, tmp_path: Path) -> None:
    _, endpoint = net.router()
    write_video(tmp_path / "a.avi", 20)
    mount = ("--mount", "0,90,0", "--offset", "0.1,0,0.02", "--fov", "90")
    agent = start(
        "run", str(tmp_path / "a.avi"), "--vehicle", "quad1", "--name", "nose", "--loop", "-e", endpoint, *mount
    )
    await asyncio.to_thread(agent.expect, "demo/quad1/nose")
    listed = await asyncio.to_thread(invoke, "list", "-e", endpoint, "--json")
    (told,) = [json.loads(line) for line in listed.output.splitlines()]
    assert (told["vehicle"], told["camera"]) == ("quad1", "nose")
    assert told["mount"] == pytest.approx([0.0, 1.5708, 0.0], abs=1e-4)
    assert told["offset"] == [0.1, 0.0, 0.02]
    assert told["focal"][0] == pytest.approx(0.5 * told["width"])
    table = await asyncio.to_thread(invoke, "list", "-e", endpoint)
    assert "quad1" in table.output
    assert "90°" in table.output
    out = tmp_path / "newest.jpg"
    seen = await asyncio.to_thread(invoke, "view", "quad1", "--name", "nose", "--save", str(out), "-e", endpoint)
    assert "taken" in seen.output
    image = cv2.imread(str(out))
    assert image is not None
    assert image.shape[0] in (120, 240)  # half of it where the budget is low
    assert await asyncio.to_thread(agent.stop) == 0
    assert "pictures sent" in agent.stderr


async def test_pictures_for_a_browser(net: Net, run_camera: Run, start: StartCamera) -> None:
    _, endpoint = net.router()
    await run_camera(endpoint, budget=1e6)
    viewer = start("view", "quad1", "--serve", "0", "-e", endpoint)
    said = await asyncio.to_thread(viewer.expect, "pictures are at")
    url = said.split()[-1]

    def look() -> tuple[bytes, dict[str, str], bytes]:
        with urllib.request.urlopen(url, timeout=PATIENCE_S) as page:
            html = page.read()
        with urllib.request.urlopen(f"{url}/mjpeg", timeout=PATIENCE_S) as stream:
            headers, jpeg = part(stream)
        return html, headers, jpeg

    html, headers, jpeg = await asyncio.to_thread(look)
    assert b"/mjpeg" in html
    assert float(headers["x-timestamp"]) > 1e9
    assert decode(jpeg).ndim == 3
    line = await asyncio.to_thread(viewer.expect, "Hz")
    assert "torn" in line
    await asyncio.to_thread(viewer.stop)
    assert "Traceback" not in viewer.stderr


def test_a_viewer_says_what_is_missing(net: Net) -> None:
    _, endpoint = net.router()
    with pytest.raises(VehicleError, match="has no camera 'down'"):
        invoke("view", "quad1", "-e", endpoint, "--wait", "0.3")
    assert "no camera in fleet 'demo' answered" in invoke("list", "-e", endpoint, "--wait", "0.3").output


async def test_a_camera_without_pictures_is_told_from_none(net: Net, run_camera: Run) -> None:
    _, endpoint = net.router()
    await run_camera(endpoint, most=2e6, rate=0.2, budget=4e3)
    with pytest.raises(TimedOut, match="is there, but sent no whole picture"):
        await asyncio.to_thread(invoke, "view", "quad1", "-e", endpoint, "--wait", "0.1")


async def test_a_taken_port_is_said(net: Net, run_camera: Run) -> None:
    _, endpoint = net.router()
    await run_camera(endpoint, budget=1e6)
    server = await asyncio.start_server(lambda reader, writer: None, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    with pytest.raises(PortInUse, match=str(port)):
        await asyncio.to_thread(invoke, "view", "quad1", "-e", endpoint, "--serve", str(port))
    server.close()


WRONG = {
    "size": (("run", "0", "--vehicle", "quad1", "--size", "big"), "not like 640x480"),
    "mount": (("run", "0", "--vehicle", "quad1", "--mount", "1,2"), "not three numbers"),
    "budget": (("run", "0", "--vehicle", "quad1", "--budget", "much"), "expected 1Mbit/s, 60kB/s"),
    "room": (("record", "quad1", "out", "--keep-free", "lots"), "not a number of bytes"),
    "vehicle": (("run", "0"), "Missing option '--vehicle'"),
}


@pytest.mark.parametrize("what", WRONG)
def test_wrong_usage_is_said(what: str) -> None:
    arguments, words = WRONG[what]
    done = invoke(*arguments)
    assert done.exit_code == 2
    assert words in done.output


def test_what_cannot_be_run(tmp_path: Path) -> None:
    with pytest.raises(BadConfig, match="not both"):
        invoke("run", "0", "--vehicle", "quad1", "--fov", "60", "--calibration", "a.toml")
    with pytest.raises(BadConfig, match="no camera /dev/video99"):
        invoke("run", "99", "--vehicle", "quad1")
    with pytest.raises(BadConfig, match="neither a folder nor a vehicle"):
        invoke("calibrate", str(tmp_path / "none"), "--squares", "9x6", "--size", "0.1", "-o", "x.toml")


@pytest.mark.parametrize("verb", ["run", "view", "record", "calibrate", "list"])
def test_every_verb_explains_itself(verb: str) -> None:
    done = invoke(verb, "--help")
    assert done.exit_code == 0
    assert "Usage:" in done.output
