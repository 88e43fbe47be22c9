"""Recordings: what they hold, what a full disk does, and what is left of a recorder that was killed."""

from __future__ import annotations

import csv
import shutil
import signal
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pytest

from agents.camera.cli import PictureRecorder
from tests.agents.camera.conftest import scene
from tests.waiting import until
from zmav.errors import BadConfig
from zmav.vision.opencv import decode, encode
from zmav.vision.reader import Picture

if TYPE_CHECKING:
    from tests.agents.camera.conftest import Run, StartCamera
    from tests.conftest import Net


def picture(number: int, width: int = 320, height: int = 240) -> Picture:
    jpeg = encode(scene(number, width, height), 60)
    return Picture(jpeg, 1000.0 + 0.1 * number, number, width, height, 1000.05 + 0.1 * number)


def lines(table: Path) -> list[dict[str, str]]:
    with table.open() as file:
        return list(csv.DictReader(file))


def test_a_folder(tmp_path: Path) -> None:
    recorder = PictureRecorder(tmp_path / "new" / "folder")
    for number in range(3):
        assert recorder.add(picture(number))
    recorder.close()
    rows = lines(tmp_path / "new" / "folder" / "pictures.csv")
    assert [(row["file"], float(row["t"]), int(row["width"])) for row in rows] == [
        ("00000000.jpg", 1000.0, 320),
        ("00000001.jpg", 1000.1, 320),
        ("00000002.jpg", 1000.2, 320),
    ]
    assert (tmp_path / "new" / "folder" / "00000001.jpg").read_bytes() == picture(1).jpeg
    with pytest.raises(BadConfig, match="is there already"):
        PictureRecorder(tmp_path / "new" / "folder")


class Usage(NamedTuple):
    total: int
    used: int
    free: int


def test_a_full_disk_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorder = PictureRecorder(tmp_path / "folder", keep_free=1e6)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: Usage(10**9, 10**9, 999_999))
    assert not recorder.add(picture(0))
    assert (recorder.written, recorder.unwritten) == (0, 1)
    assert "nothing is written" in recorder.full
    monkeypatch.setattr(shutil, "disk_usage", lambda path: Usage(10**9, 0, 10**9))
    monkeypatch.setattr(time, "monotonic", lambda: float("inf"))
    assert recorder.add(picture(1))
    assert recorder.full == ""


def test_where_nobody_may_write(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(BadConfig, match="cannot write"):
        PictureRecorder(tmp_path / "file")
    with pytest.raises(BadConfig, match="cannot write"):
        PictureRecorder(tmp_path / "file" / "below")


async def test_what_is_left_of_a_recorder_that_was_killed(
    net: Net, run_camera: Run, start: StartCamera, tmp_path: Path
) -> None:
    _, endpoint = net.router()
    await run_camera(endpoint, budget=1e6)
    path = tmp_path / "folder"
    process = start("view", "quad1", "--record", str(path), "-e", endpoint)
    table = path / "pictures.csv"
    await until(lambda: table.exists() and len(lines(table)) >= 15, "15 pictures")
    process.popen.send_signal(signal.SIGKILL)
    process.wait()
    rows = [row for row in lines(table) if row["height"]]  # the last line may be half written
    assert len(rows) >= 15
    for row in rows:
        assert decode((path / row["file"]).read_bytes()).shape == (240, 320, 3)
