"""Pictures by HTTP: streams, single pictures, numbers; clients that are slow, leave, or ask for what is not there."""

from __future__ import annotations

import http.client
import json
import socket
import threading
from collections.abc import Callable, Iterator
from http.client import HTTPConnection, HTTPResponse

import cv2
import numpy as np
import pytest

from tests.sim.camera.conftest import PLAIN
from zmav.errors import BadInput, PortInUse
from zmav.sim import VehicleSpec, World
from zmav.sim.camera import CameraSpec
from zmav.sim.camera.serve import CameraServer, serve_cameras

PATIENCE_S = 60.0
SMALL = CameraSpec(width=160, height=120, focal_px=130.0, rate_hz=20.0)


class Studio:
    """A world that is stepped, two cameras of it served."""

    def __init__(self) -> None:
        specs = [VehicleSpec(camera=SMALL), VehicleSpec(camera=CameraSpec(rate_hz=5.0)), VehicleSpec()]
        self.world = World(specs, scene=PLAIN, epoch_s=1000.0)
        self.port = 0
        self.urls: dict[str, str] = {}

    def serve(self) -> None:
        assert self.world.cameras is not None
        self.urls = serve_cameras(self.world.cameras, 0)
        self.port = self.server.port

    @property
    def server(self) -> CameraServer:
        assert self.world.cameras is not None
        server = self.world.cameras.server
        assert isinstance(server, CameraServer)
        return server

    def get(self, path: str) -> HTTPResponse:
        connection = HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE_S)
        connection.request("GET", path)
        return connection.getresponse()

    def step_until(self, true: Callable[[], bool]) -> None:
        """Tick by tick, each given the camera's thread's time; for at most a minute."""
        pause = threading.Event()
        for _ in range(6000):
            if true():
                return
            self.world.step(0.01)
            pause.wait(0.01)
        raise AssertionError("not within 6000 ticks")


@pytest.fixture
def studio() -> Iterator[Studio]:
    studio = Studio()
    studio.serve()
    yield studio
    studio.world.close()


def part(stream: HTTPResponse) -> tuple[dict[str, str], bytes]:
    """The next picture of a stream, with its headers."""
    assert stream.readline().strip() == b"--zmav-frame"
    headers = http.client.parse_headers(stream)
    data = stream.read(int(headers["Content-Length"]))
    assert stream.readline() == b"\r\n"
    return dict(headers), data


def shape(data: bytes) -> tuple[int, ...]:
    image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return tuple(image.shape)


def test_a_stream(studio: Studio) -> None:
    stream = studio.get("/quad1.mjpeg")
    assert stream.getheader("Content-Type") == "multipart/x-mixed-replace; boundary=zmav-frame"
    feed = studio.server.feeds["quad1"]
    times = []
    for _ in range(3):
        rendered = feed.rendered
        studio.step_until(lambda before=rendered: feed.rendered > before)  # type: ignore[misc]
        headers, data = part(stream)
        assert shape(data) == (120, 160, 3)
        times.append(float(headers["X-Time"]))
        assert float(headers["X-Timestamp"]) == pytest.approx(1000.0 + times[-1])
    assert times == sorted(set(times))
    # Pictures are taken every 50 ms of simulated time, whatever the clock does.
    assert np.diff(times) / 0.05 == pytest.approx(np.rint(np.diff(times) / 0.05), abs=1e-6)
    stream.close()


def test_each_camera_has_its_own_rate() -> None:
    studio = Studio()
    studio.serve()
    taken: dict[str, list[float]] = {"quad1": [], "quad2": []}
    for name, feed in studio.server.feeds.items():
        feed.offer = lambda poses, name=name: taken[name].append(poses.time_s)  # type: ignore[method-assign,misc]
    studio.world.step(2.0)
    studio.world.close()
    assert {name: len(times) for name, times in taken.items()} == {"quad1": 40, "quad2": 10}
    assert np.diff(taken["quad1"]) == pytest.approx(0.05)


def test_nobody_watches_nothing_is_rendered(studio: Studio) -> None:
    studio.world.step(1.0)
    assert all(feed.rendered == 0 and not feed.part for feed in studio.server.feeds.values())


def test_a_client_that_leaves_is_forgotten(studio: Studio) -> None:
    feed = studio.server.feeds["quad1"]
    streams = [studio.get("/quad1.mjpeg") for _ in range(3)]
    studio.step_until(lambda: feed.viewers == 3)
    for stream in streams:
        stream.close()
    studio.step_until(lambda: feed.viewers == 0)
    rendered = feed.rendered
    studio.world.step(0.5)
    assert feed.rendered <= rendered + 1  # one may have been begun


def test_a_slow_client_gets_the_latest_and_delays_nobody(studio: Studio) -> None:
    """It reads nothing at all, until the connection is full; the other one has all it can take."""
    slow = socket.create_connection(("127.0.0.1", studio.port), timeout=PATIENCE_S)
    slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    slow.sendall(b"GET /quad1.mjpeg HTTP/1.0\r\n\r\n")
    quick = studio.get("/quad1.mjpeg")
    feed = studio.server.feeds["quad1"]
    studio.step_until(lambda: feed.viewers == 2)
    for _ in range(20):
        rendered = feed.rendered
        studio.step_until(lambda before=rendered: feed.rendered > before)  # type: ignore[misc]
        part(quick)
    slow.close()
    quick.close()


def test_the_numbers(studio: Studio) -> None:
    studio.world.step(0.3)
    told = json.loads(studio.get("/quad1.json").read())
    camera = studio.world.camera("quad1")
    assert told["camera_matrix"] == camera.matrix.tolist()
    assert (told["width"], told["height"]) == (160, 120)
    assert (told["mount_deg"], told["offset_m"], told["gimbal"]) == ([0.0] * 3, [0.0, 0.0, -0.1], False)


@pytest.mark.parametrize("path", ["/quad3.mjpeg", "/quad1.png", "/quad1", "/../etc", "/"])
def test_what_is_not_there(studio: Studio, path: str) -> None:
    answer = studio.get(path)
    assert answer.status == 404
    assert "/quad1.mjpeg" in answer.read().decode()


def test_a_port_that_is_taken() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        studio = Studio()
        assert studio.world.cameras is not None
        with pytest.raises(PortInUse, match=str(port)):
            serve_cameras(studio.world.cameras, port)
        studio.world.close()


def test_serving_twice_and_no_port(studio: Studio) -> None:
    assert studio.world.cameras is not None
    with pytest.raises(BadInput, match="already"):
        serve_cameras(studio.world.cameras, 0)
    other = Studio()
    assert other.world.cameras is not None
    with pytest.raises(BadInput, match="70000"):
        serve_cameras(other.world.cameras, 70000)
    other.world.close()


def test_closing_the_world_ends_streams_and_threads() -> None:
    before = threading.active_count()
    studio = Studio()
    studio.serve()
    stream = studio.get("/quad1.mjpeg")
    studio.world.close()
    assert stream.read() == b""
    with pytest.raises(OSError):
        studio.get("/")
    named = [thread.name for thread in threading.enumerate() if thread.name.startswith("zmav-camera")]
    assert not named
    assert threading.active_count() <= before + 1  # the stream's own may be at its last line


def test_opencv_opens_it_while_the_world_runs() -> None:
    spec = VehicleSpec(camera=SMALL, endpoints=("tcp:0",))
    with World([spec], scene=PLAIN) as world:
        assert world.cameras is not None
        capture = cv2.VideoCapture(serve_cameras(world.cameras, 0)["quad1"])
        try:
            assert capture.isOpened()
            for _ in range(3):
                good, image = capture.read()
                assert good
                assert image.shape == (120, 160, 3)
            frame = world.camera("quad1").frame()  # between two ticks of the world's thread
            assert frame.time_s > 0.0
        finally:
            capture.release()
