"""Recordings: folders and films, what a full disk does, and what is left of a recorder that was killed."""

from __future__ import annotations

import csv
import shutil
import signal
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import cv2
import pytest

from agents.camera.recorder import Recorder
from tests.agents.camera.conftest import scene
from tests.waiting import until
from zmav.errors import BadConfig
from zmav.vision.opencv import decode, encode
from zmav.vision.reader import Picture

if TYPE_CHECKING:
    from tests.agents.camera.conftest import Run, StartCamera
    from tests.conftest import Net

ROOMY = 0.0


def picture(number: int, width: int = 320, height: int = 240) -> Picture:
    jpeg = encode(scene(number, width, height), 60)
    return Picture(jpeg, 1000.0 + 0.1 * number, number, width, height, 1000.05 + 0.1 * number)


def lines(table: Path) -> list[dict[str, str]]:
    with table.open() as file:
        return list(csv.DictReader(file))


def film(path: Path) -> list[tuple[int, ...]]:
    """The shapes of what OpenCV reads of a film."""
    video = cv2.VideoCapture(str(path))
    shapes: list[tuple[int, ...]] = []
    while True:
        good, image = video.read()
        if not good:
            return shapes
        shapes.append(image.shape)


def test_a_folder(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "new" / "folder", 10.0, ROOMY)
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
        Recorder(tmp_path / "new" / "folder", 10.0, ROOMY)


def test_a_film(tmp_path: Path) -> None:
    path = tmp_path / "a.avi"
    recorder = Recorder(path, 5.0, ROOMY)
    for number in range(11):
        assert recorder.add(picture(number) if number != 4 else picture(4, 160, 120))
    recorder.close()
    assert film(path) == [(240, 320, 3)] * 11
    assert cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FPS) == pytest.approx(10.0, rel=0.01)  # as they were taken
    assert [row["file"] for row in lines(tmp_path / "a.csv")] == ["a.avi"] * 11
    assert lines(tmp_path / "a.csv")[4]["width"] == "160"


def test_a_film_that_is_full_goes_on_in_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agents.camera.avi.FULL", 3 * len(picture(0).jpeg))
    recorder = Recorder(tmp_path / "a.avi", 5.0, ROOMY)
    for number in range(8):
        assert recorder.add(picture(number))
    recorder.close()
    files = sorted(tmp_path.glob("*.avi"))
    assert {"a.avi", "a-2.avi"} <= {path.name for path in files}
    assert sum(len(film(path)) for path in files) == 8
    assert {row["file"] for row in lines(tmp_path / "a.csv")} == {path.name for path in files}


class Usage(NamedTuple):
    total: int
    used: int
    free: int


def test_a_full_disk_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorder = Recorder(tmp_path / "folder", 10.0, keep_free=1e6)
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
        Recorder(tmp_path / "file", 10.0, ROOMY)
    (tmp_path / "a.avi").write_text("")
    with pytest.raises(BadConfig, match="is there already"):
        Recorder(tmp_path / "a.avi", 10.0, ROOMY)
    with pytest.raises(BadConfig, match="cannot write"):
        Recorder(tmp_path / "file" / "below", 10.0, ROOMY)


@pytest.mark.parametrize("target", ["folder", "a.avi"])
async def test_what_is_left_of_a_recorder_that_was_killed(
    net: Net, run_camera: Run, start: StartCamera, tmp_path: Path, target: str
) -> None:
    _, endpoint = net.router()
    await run_camera(endpoint, budget=1e6)
    path = tmp_path / target
    process = start("record", "quad1", str(path), "-e", endpoint, "--keep-free", "0kB")
    table = path / "pictures.csv" if target == "folder" else path.with_suffix(".csv")
    await until(lambda: table.exists() and len(lines(table)) >= 15, "15 pictures")
    process.popen.send_signal(signal.SIGKILL)
    process.wait()
    rows = [row for row in lines(table) if row["height"]]  # the last line may be half written
    assert len(rows) >= 15
    if target == "folder":
        for row in rows:
            assert decode((path / row["file"]).read_bytes()).shape == (240, 320, 3)
    else:
        assert len(film(path)) >= len(rows) - 11  # ten a second
