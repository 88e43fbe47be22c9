"""Where pictures come from: files, folders, the simulator, a server that dies; and what is no source."""

from __future__ import annotations

import itertools
import socket
import threading
import time
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import pytest

from agents.camera.capture import Capture, Lost, Shot, Source
from agents.camera.mjpeg import MjpegSource, numbers
from agents.camera.sources import DeviceSource, Replay, StreamSource, open_source, taken
from tests.agents.camera.conftest import scene, write_pictures
from tests.conftest import PATIENCE_S
from zmav.errors import BadConfig
from zmav.sim import VehicleSpec, World
from zmav.sim.camera import CameraSpec
from zmav.sim.camera.serve import serve_cameras
from zmav.vision.opencv import decode, encode

JPEG = encode(scene(3), 60)


def shots(source: Source, count: int) -> list[Shot]:
    """The first so many of a source, as they come."""
    return list(itertools.islice(source.shots(threading.Event()), count))


def test_a_folder_at_its_rate(tmp_path: Path) -> None:
    folder = str(write_pictures(tmp_path / "pictures", 5))
    source, begun = open_source(folder, rate=50.0), time.time()
    found = shots(source, 99)
    assert [shot.seq for shot in found] == [0, 1, 2, 3, 4]
    assert found[-1].t - begun >= 4 / 50.0 - 0.001  # from its begin: the first may be late, and none is early for that
    again = open_source(folder, rate=50.0, loop=True)
    assert [shot.seq for shot in shots(again, 12)] == list(range(12))


def test_a_folder_of_pictures(tmp_path: Path) -> None:
    (tmp_path / "1.jpg").write_bytes(JPEG)
    cv2.imwrite(str(tmp_path / "2.png"), scene(2))
    (tmp_path / "3.png").write_bytes(b"broken")
    (tmp_path / "notes.txt").write_text("no picture")
    first, second = shots(open_source(str(tmp_path), rate=50.0), 99)
    assert (first.jpeg, first.image) == (JPEG, None)
    assert second.jpeg is None
    assert second.image is not None
    assert (second.image == scene(2)).all()
    assert len(shots(open_source(str(tmp_path), rate=50.0, loop=True), 7)) == 7


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("99", "there is no camera /dev/video99"),
        ("/dev/video98", "there is no camera /dev/video98"),
        ("nowhere.avi", "neither a device, a URL nor a folder"),
        ("gopher://camera/1", "gopher:// is no source of pictures"),
        ("http://", "is no address of pictures"),
        ("http://host:port/a.mjpeg", "is no address of pictures"),
    ],
)
def test_what_is_no_source_is_said(source: str, words: str) -> None:
    with pytest.raises(BadConfig, match=words):
        open_source(source)


def test_files_that_hold_no_pictures(tmp_path: Path) -> None:
    with pytest.raises(BadConfig, match="there are no pictures"):
        open_source(str(tmp_path))


def test_when_a_devices_picture_was_taken() -> None:
    """V4L2's monotonic stamp where it can be one, else the stated delay."""
    assert taken(stamp=99.96, monotonic=100.0, utc=5000.0, delay=0.1) == pytest.approx(4999.96)
    for odd in (0.0, 101.0, 12.0, -1.0):
        assert taken(stamp=odd, monotonic=100.0, utc=5000.0, delay=0.1) == pytest.approx(4999.9)


def test_a_password_is_not_shown() -> None:
    assert open_source("rtsp://me:secret@camera/stream").words == "rtsp://camera/stream"


class Device:
    """A V4L2 camera as OpenCV shows it: two pictures with monotonic stamps, then it is unplugged."""

    def __init__(self, path: str, backend: int) -> None:
        assert (path, backend) == ("/dev/video3", cv2.CAP_V4L2)
        self.asked: dict[int, float] = {}
        self._left = 2

    def set(self, what: int, value: float) -> None:
        self.asked[what] = value

    def get(self, what: int) -> float:
        assert what == cv2.CAP_PROP_POS_MSEC
        return 1e3 * (time.monotonic() - 0.04)

    def read(self) -> tuple[bool, Any]:
        self._left -= 1
        return self._left >= 0, scene(1)

    def release(self) -> None:
        assert self.asked[cv2.CAP_PROP_FRAME_WIDTH] == 320


def test_a_device_and_its_own_time_stamps(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cv2, "VideoCapture", Device)
    found = []
    before = time.time()
    with pytest.raises(Lost, match="/dev/video3 gives no pictures"):
        for shot in DeviceSource("3", 10.0, 0.5, (320, 240)).shots(threading.Event()):
            found.append(shot)
    assert [shot.seq for shot in found] == [0, 1]
    assert before - 0.05 <= found[0].t <= time.time() - 0.039


def test_a_stream_that_nobody_serves_is_lost() -> None:
    free = socket.create_server(("127.0.0.1", 0))
    port = free.getsockname()[1]
    free.close()
    with pytest.raises(Lost, match="gives no pictures"):
        shots(StreamSource(f"http://127.0.0.1:{port}/a.mp4", 0.0), 1)


class Server:
    """Serves multipart pictures to one client after another, ``each`` to a client, then hangs up."""

    def __init__(self, body: bytes, port: int = 0) -> None:
        self._body = body
        self._socket = socket.create_server(("127.0.0.1", port))
        self.port = self._socket.getsockname()[1]
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        while True:
            try:
                client, _ = self._socket.accept()
            except OSError:
                return
            with client:
                client.recv(4096)
                client.sendall(self._body)

    def close(self) -> None:
        self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        self._thread.join(PATIENCE_S)


HEAD = b"HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=b\r\n\r\n"


def part(*headers: str) -> bytes:
    lines = ["--b", "Content-Type: image/jpeg", f"Content-Length: {len(JPEG)}", *headers]
    return "\r\n".join(lines).encode() + b"\r\n\r\n" + JPEG + b"\r\n"


@pytest.fixture
def servers() -> Iterator[list[Server]]:
    started: list[Server] = []
    yield started
    for server in started:
        server.close()


def test_the_capture_time_of_a_server_is_kept(servers: list[Server]) -> None:
    servers.append(Server(HEAD + part("X-Timestamp: 1234.5", "X-Sequence: 7") + part("X-Timestamp: nan")))
    source = MjpegSource(f"http://127.0.0.1:{servers[0].port}/a.mjpeg", delay=2.0)
    before = time.time()
    first, second = shots(source, 2)
    assert (first.t, first.jpeg) == (1234.5, JPEG)
    assert before - 2.0 <= second.t <= time.time() - 2.0


def test_a_capture_time_in_milliseconds_is_none(servers: list[Server]) -> None:
    """Every reader would leave out every chunk of such a picture, and nobody would say why."""
    servers.append(Server(HEAD + part("X-Timestamp: 1700000000000")))
    before = time.time()
    (found,) = shots(MjpegSource(f"http://127.0.0.1:{servers[0].port}/a.mjpeg"), 1)
    assert before <= found.t <= time.time()


BROKEN = {
    "not found": (b"HTTP/1.1 404 Not Found\r\n\r\n", "answers 404"),
    "a page": (b"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\n\r\n<html>", "no multipart pictures"),
    "not http": (b"\x00\x01\x02", "broke off"),
    "the end": (HEAD + part(), "the stream ended"),
    "a torn picture": (HEAD + part()[:-200], "within a picture"),
    "no length": (HEAD + b"--b\r\n\r\n", "Content-Length is ''"),
    "a huge length": (HEAD + b"--b\r\nContent-Length: 99999999999\r\n\r\n", "Content-Length"),
    "something else": (HEAD + b"hello\r\n", "something else than parts"),
    "a long line": (HEAD + b"x" * 10000, "line without an end"),
    "empty lines": (HEAD + b"\r\n" * 500, "holds nothing"),
}


@pytest.mark.parametrize("what", BROKEN)
def test_a_broken_server_is_lost_in_words(servers: list[Server], what: str) -> None:
    answer, words = BROKEN[what]
    servers.append(Server(answer))
    with pytest.raises(Lost, match=words):
        shots(MjpegSource(f"http://127.0.0.1:{servers[0].port}/a.mjpeg"), 5)


class Heard:
    """What a capture says, with waits."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._changed = threading.Condition()

    def __call__(self, line: str = "") -> None:
        with self._changed:
            self.lines += [line] if line else []
            self._changed.notify_all()

    def until(self, true: Any, what: str) -> None:
        with self._changed:
            assert self._changed.wait_for(true, PATIENCE_S), f"never: {what}"

    def wait(self, seconds: float) -> None:
        """For the next picture or word, so long at most."""
        with self._changed:
            self._changed.wait(seconds)


def test_a_server_that_dies_and_comes_back(servers: list[Server]) -> None:
    """Its pictures go on counting, and both are said."""
    servers.append(Server(HEAD + part() * 3))
    port = servers[0].port
    heard = Heard()
    capture = Capture(MjpegSource(f"http://127.0.0.1:{port}/a.mjpeg"), news=heard, say=heard, first_wait=0.02)
    try:
        heard.until(lambda: capture.count >= 3, "three pictures")
        heard.until(lambda: bool(heard.lines), "a word on the end")
        servers.pop().close()
        seen = capture.count
        servers.append(Server(HEAD + part() * 3, port))
        heard.until(lambda: capture.count > seen, "more pictures")
        latest = capture.latest
        assert latest is not None
        assert latest.seq >= seen
        assert "opened again in" in heard.lines[0]
        assert any("pictures come again" in line for line in heard.lines)
        assert not capture.ended
    finally:
        capture.close()


def test_what_a_library_raises_is_said_and_the_source_is_opened_again(tmp_path: Path) -> None:
    """Python's resolver does not know an empty label, and OpenCV reads no picture of so many pixels."""
    cv2.imwrite(str(tmp_path / "1.png"), scene(2))
    whole = (tmp_path / "1.png").read_bytes()
    header = b"IHDR" + (900_000).to_bytes(4, "big") * 2 + whole[24:29]
    (tmp_path / "1.png").write_bytes(whole[:12] + header + zlib.crc32(header).to_bytes(4, "big") + whole[33:])
    cv2.imwrite(str(tmp_path / "2.png"), scene(2))
    assert len(shots(Replay(tmp_path, 10.0, loop=False), 1)) == 1, "the next one is shown"
    (tmp_path / "2.png").unlink()
    for source in (MjpegSource("http://a..b/x.mjpeg"), Replay(tmp_path, 10.0, loop=True)):
        heard = Heard()
        capture = Capture(source, say=heard, first_wait=0.02)
        try:
            heard.until(lambda heard=heard: bool(heard.lines), "a word on it")
            assert "opened again in" in heard.lines[0]
            assert capture.lost
        finally:
            capture.close()


def test_the_latest_picture_wins(tmp_path: Path) -> None:
    folder = write_pictures(tmp_path / "pictures", 6)
    heard = Heard()
    capture = Capture(Replay(folder, 100.0, loop=False), news=heard)
    heard.until(lambda: capture.ended, "the end")
    assert capture.count == 6
    latest = capture.latest
    assert latest is not None
    assert latest.seq == 5
    capture.close()


def test_the_simulators_camera() -> None:
    spec = CameraSpec(width=160, height=120, focal_px=130.0, rate_hz=20.0, mount_deg=(0.0, 30.0, 0.0), gimbal=True)
    world = World([VehicleSpec(name="quad1", camera=spec)], epoch_s=1000.0)
    assert world.cameras is not None
    url = serve_cameras(world.cameras, 0)["quad1"]
    heard = Heard()
    capture = Capture(open_source(url), news=heard)
    try:
        end = time.monotonic() + PATIENCE_S
        while capture.count < 2 and time.monotonic() < end:
            world.step(0.01)
            heard.wait(0.005)
        latest = capture.latest
        assert latest is not None
        assert latest.jpeg is not None
        assert decode(latest.jpeg).shape == (120, 160, 3)
        assert abs(time.time() - latest.t) < 5.0  # the world's time is of another day: it is set right
        found = numbers(url)
        assert found is not None
        assert found.calibration.focal == (130.0, 130.0)
        assert found.mount == pytest.approx((0.0, 0.5236, 0.0), abs=1e-4)
        assert (found.offset, found.gimbal) == (spec.offset_m, True)
        assert numbers(url.replace("quad1", "nobody")) is None
    finally:
        capture.close()
        world.close()
