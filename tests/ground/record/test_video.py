"""The video of cameras beside a recording: as it came, and whole whatever ends the recorder."""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import av
import pytest

import zmav
from ground.record.video import VideoFiles
from tests.cli.conftest import Process
from tests.ground.http.video import RunningVideo
from tests.waiting import until
from zmav.session import SessionSettings

if TYPE_CHECKING:
    from tests.conftest import Net


def decoded(path: Path) -> int:
    """Pictures that a player finds in a file."""
    with av.open(str(path)) as container:
        return sum(1 for _ in container.decode(video=0))


async def test_it_is_written_as_it_came_and_again_when_there_is_room(net: Net, tmp_path: Path) -> None:
    _, endpoint = net.router()
    room, said = [True], list[str]()
    video = RunningVideo(endpoint, "clock:640x360@20")
    try:
        async with zmav.open(settings=SessionSettings(connect=[endpoint])) as z:
            async with VideoFiles(z, tmp_path, ["quad*"], lambda: room[0], said.append) as files:
                await until(lambda: files.units >= 10, "units in a file")
                room[0] = False
                video.agent.stream.want_key()
                await until(lambda: bool(said), "a word about the room")
                assert said == ["the video of quad1/down is not written: there is too little room"]
                await until(lambda: not video.agent.watched, "a camera that need not send")
                written = files.units
                room[0] = True
                await until(lambda: files.units >= written + 10, "units in a second file")
            first, second = sorted(tmp_path.glob("*.ts"))
        assert first.name == "quad1.down.001.ts"
        assert decoded(first) + decoded(second) == files.units
    finally:
        video.close()


@pytest.mark.parametrize("patterns", [["rover*"], ["quad2"]])
async def test_other_vehicles_are_left_alone(net: Net, tmp_path: Path, patterns: list[str]) -> None:
    _, endpoint = net.router()
    video = RunningVideo(endpoint)
    try:
        async with (
            zmav.open(settings=SessionSettings(connect=[endpoint])) as z,
            VideoFiles(z, tmp_path, patterns, lambda: True, print) as files,
        ):
            heard = list[str]()
            z.session.declare_subscriber("zmav/demo/quad1/agent/video-down/status", lambda sample: heard.append("word"))
            await until(lambda: len(heard) >= 2, "the camera's status")
            assert (files.units, video.agent.watched) == (0, False)
    finally:
        video.close()


async def test_cameras_of_one_name_in_two_fleets_have_files_of_their_own(net: Net, tmp_path: Path) -> None:
    _, endpoint = net.router()
    sizes = {"demo": (640, 360), "alpha": (320, 240)}
    videos = [
        RunningVideo(endpoint, f"clock:{width}x{height}@20", fleet=fleet) for fleet, (width, height) in sizes.items()
    ]
    try:
        async with (
            zmav.open(fleet="*", settings=SessionSettings(connect=[endpoint])) as z,
            VideoFiles(z, tmp_path, ["*"], lambda: True, print) as files,
        ):
            await until(lambda: len(list(tmp_path.glob("*.ts"))) == 2, "two files")
            written = files.units
            await until(lambda: files.units >= written + 40, "units of both")
        found = set[tuple[int, int]]()
        for path in tmp_path.glob("*.ts"):
            with av.open(str(path)) as container:
                (size,) = {(frame.width, frame.height) for frame in container.decode(video=0)}
            found.add(size)
        assert found == set(sizes.values())
        (second,) = (path.name for path in tmp_path.glob("*.quad1.down.001.ts"))
        assert (tmp_path / "quad1.down.001.ts").exists() and second.split(".")[0] in sizes
    finally:
        for video in videos:
            video.close()


async def test_a_recorder_that_is_killed_leaves_a_file_that_plays(net: Net, tmp_path: Path) -> None:
    _, endpoint = net.router()
    video = RunningVideo(endpoint)
    code = "import sys; from zmav import cli; from ground.record.cli import command; cli.zmav = command; cli.main()"
    options = ("--out", str(tmp_path), "--video", "--no-mcap", "--keep-free", "1MB", "--connect", endpoint)
    recorder = Process(sys.executable, "-c", code, *options)
    try:
        await until(lambda: any(each.stat().st_size > 200_000 for each in tmp_path.glob("*/*.ts")), "a file that grows")
        recorder.popen.send_signal(signal.SIGKILL)
        recorder.wait()
        (path,) = tmp_path.glob("*/quad1.down.001.ts")
        assert decoded(path) >= 10
    finally:
        video.close()
        if recorder.popen.poll() is None:
            recorder.popen.kill()
            recorder.wait()
