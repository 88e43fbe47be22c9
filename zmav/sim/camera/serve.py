"""The cameras' pictures for other programs, by HTTP.

``/NAME.mjpeg`` is a stream that browsers and OpenCV's VideoCapture open (multipart/x-mixed-replace: RFC 2046, section
5.1; each part is a JPEG), ``/NAME.jpg`` one picture, ``/NAME.json`` the camera's numbers and its latest pose. Every
picture comes with headers of its own: X-Sequence, X-Time (simulated seconds), X-Timestamp (UTC seconds), X-Position
(metres NED) and X-Attitude (w, x, y, z). Anyone who is slow gets the latest picture, not all of them.
"""

from __future__ import annotations

import errno
import json
import select
import socket
import threading
from collections.abc import Callable, Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from socketserver import TCPServer
from typing import Any, NamedTuple

import cv2

from zmav.errors import BadInput, PortInUse
from zmav.sim.camera.cameras import Cameras, Frame, SimCamera
from zmav.sim.camera.poses import Poses

BOUNDARY = "zmav-frame"
STALLED_S = 10.0  # a client that takes nothing for so long is given up
LOOK_S = 1.0  # how often a stream without pictures looks whether its client is still there


def serve_cameras(cameras: Cameras, port: int, host: str = "127.0.0.1") -> dict[str, str]:
    """Serve every camera by HTTP until the world is closed; gives the URL of each one's pictures. Port 0: any free one.

    Raises :class:`PortInUse`, :class:`BadInput` where they are served already, and :class:`BadConfig` for a lens that
    cannot be.
    """
    if cameras.served:
        raise BadInput("the cameras are served already", field="port", value=port, expected="one server")
    for camera in cameras.all:
        camera.prepare()
    server = CameraServer(cameras.all, host, port, cameras.look())
    cameras.attach(server)
    return {camera.name: f"{server.url}/{camera.name}.mjpeg" for camera in cameras.all}


class Picture(NamedTuple):
    """An encoded frame."""

    frame: Frame
    jpeg: bytes

    def headers(self) -> dict[str, str]:
        frame = self.frame
        return {
            "Content-Type": "image/jpeg",
            "Content-Length": str(len(self.jpeg)),
            "X-Sequence": str(frame.sequence),
            "X-Time": f"{frame.time_s:.6f}",
            "X-Timestamp": f"{frame.unix_s:.6f}",
            "X-Position": " ".join(f"{c:.6f}" for c in frame.position),
            "X-Attitude": " ".join(f"{c:.9f}" for c in frame.attitude),
        }


class Feed:
    """One camera's pictures: rendered in a thread of its own while somebody watches."""

    def __init__(self, camera: SimCamera, poses: Poses) -> None:
        self.camera = camera
        self.poses = poses
        """the latest"""
        self.picture: Picture | None = None
        self.viewers = 0
        self.closed = False
        self.rendered = 0
        self._next: Poses | None = None
        self._due = poses.time_s + 1.0 / camera.spec.rate_hz
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name=f"zmav-camera-{camera.name}", daemon=True)
        self._thread.start()

    # ---- the world's thread

    def due(self, now: float) -> bool:
        """Whether the next picture is due at ``now`` simulated seconds."""
        if now < self._due - 1e-6:
            return False
        period = 1.0 / self.camera.spec.rate_hz
        self._due += period
        if self._due < now - 1e-6:  # it cannot follow: no burst to catch up
            self._due = now + period
        return True

    def offer(self, poses: Poses) -> None:
        """Take what is to be seen; what was offered before and is not begun yet is dropped."""
        self.poses = poses
        if self.viewers:
            with self._changed:
                self._next = poses
                self._changed.notify_all()

    # ---- its own thread

    def _run(self) -> None:
        try:
            self._render()
        finally:
            with self._changed:  # also where a defect ends it: nobody is to wait for pictures that will not come
                self.closed = True
                self._changed.notify_all()

    def _render(self) -> None:
        while True:
            with self._changed:
                while self._next is None and not self.closed:
                    self._changed.wait()
                if self.closed:
                    return
                poses, self._next = self._next, None
            assert poses is not None
            picture = self.take(poses)
            with self._changed:
                self.picture = picture
                self.rendered += 1
                self._changed.notify_all()

    # ---- clients' threads

    def take(self, poses: Poses) -> Picture:
        """A picture of the world at ``poses``."""
        frame = self.camera.capture(poses)
        return Picture(frame, self.camera.encode(frame))

    def watch(self, more: int) -> None:
        """One viewer more, or with -1 one less."""
        with self._changed:
            self.viewers += more

    def after(self, sequence: int, timeout: float) -> Picture | None:
        """The latest picture once it is later than ``sequence``; None after ``timeout`` seconds, or at the end."""

        def ready() -> bool:
            return self.closed or (self.picture is not None and self.picture.frame.sequence > sequence)

        with self._changed:
            self._changed.wait_for(ready, timeout)
            picture = self.picture
        return picture if not self.closed and picture is not None and picture.frame.sequence > sequence else None

    def close(self) -> None:
        with self._changed:
            self.closed = True
            self._changed.notify_all()
        self._thread.join()


class CameraServer:
    """Listens at ``host``:``port`` until :meth:`close`. Raises :class:`PortInUse`, :class:`BadInput`."""

    def __init__(self, cameras: Sequence[SimCamera], host: str, port: int, poses: Poses) -> None:
        if not 0 <= port <= 65535:
            raise BadInput(f"port {port}; expected 0 to 65535", field="port", value=port, expected="0 to 65535")
        cv2.setNumThreads(1)  # pictures are many and small: further threads would only take turns with the vehicles
        feeds: dict[str, Feed] = {}

        class Handler(_Handler):
            pass

        Handler.feeds = feeds
        try:
            self._server = _Server((host, port), Handler)
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                text = f"port {port}, for the cameras, is in use by another program; choose another, or 0 for any"
                raise PortInUse(text, port=port) from error
            text = f"cameras at {host}:{port}: {error}"
            raise BadInput(text, field="port", value=port, expected="a free port") from error
        feeds.update((camera.name, Feed(camera, poses)) for camera in cameras)
        self.feeds = feeds
        self.port = int(self._server.server_address[1])
        self.url = f"http://{host}:{self.port}"
        self._thread = threading.Thread(target=self._server.serve_forever, name="zmav-cameras", daemon=True)
        self._thread.start()

    def tick(self, now: float, snapshot: Callable[[], Poses]) -> None:
        """Hand the cameras that are due at ``now`` where everything is; all of them get the same."""
        poses: Poses | None = None
        for feed in self.feeds.values():
            if feed.due(now):
                poses = poses or snapshot()
                feed.offer(poses)

    def close(self) -> None:
        for feed in self.feeds.values():
            feed.close()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False

    def server_bind(self) -> None:
        """Without asking the network for this machine's name, which may take seconds."""
        TCPServer.server_bind(self)
        host, port = self.server_address[:2]
        self.server_name, self.server_port = str(host), int(port)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that vanishes is nobody's error."""


class _Handler(BaseHTTPRequestHandler):
    feeds: dict[str, Feed] = {}  # noqa: RUF012 - each server's own class has its own
    server_version = "zmav"
    sys_version = ""
    timeout = STALLED_S

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing is logged: the simulator's own line is on the terminal."""

    def do_GET(self) -> None:
        name, _, kind = self.path.partition("?")[0].strip("/").rpartition(".")
        feed = self.feeds.get(name)
        answer = {"mjpeg": self._stream, "jpg": self._still, "json": self._numbers}.get(kind)
        try:
            if self.path == "/":
                self._index()
            elif feed is None or answer is None:
                there = ", ".join(f"/{each}.mjpeg" for each in self.feeds)
                self.send_error(404, "no such picture", f"there are {there}, and .jpg and .json of each")
            else:
                answer(feed)
        except OSError:
            self.close_connection = True  # it has gone, or takes nothing

    def _index(self) -> None:
        rows = "".join(f'<p>{name}<br><img src="/{name}.mjpeg"></p>' for name in self.feeds)
        self._reply("text/html; charset=utf-8", f"<!doctype html><title>zmav cameras</title>{rows}".encode())

    def _still(self, feed: Feed) -> None:
        picture = feed.take(feed.poses)
        self._reply("image/jpeg", picture.jpeg, picture.headers())

    def _numbers(self, feed: Feed) -> None:
        self._reply("application/json", json.dumps(numbers(feed.camera, feed.poses)).encode())

    def _stream(self, feed: Feed) -> None:
        self.send_response(200)
        self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={BOUNDARY}")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        feed.watch(1)
        try:
            sequence = -1 if feed.picture is None else feed.picture.frame.sequence
            while not feed.closed:
                picture = feed.after(sequence, LOOK_S)
                if picture is not None:
                    sequence = picture.frame.sequence
                    head = "".join(f"{key}: {value}\r\n" for key, value in picture.headers().items())
                    self.wfile.write(f"--{BOUNDARY}\r\n{head}\r\n".encode() + picture.jpeg + b"\r\n")
                elif self._gone():
                    return
        finally:
            feed.watch(-1)

    def _gone(self) -> bool:
        """Whether the client has closed its end."""
        readable, _, _ = select.select([self.connection], [], [], 0)
        return bool(readable) and self.connection.recv(1, socket.MSG_PEEK) == b""

    def _reply(self, kind: str, body: bytes, headers: dict[str, str] | None = None) -> None:
        self.send_response(200)
        for key, value in {"Content-Type": kind, "Content-Length": str(len(body)), **(headers or {})}.items():
            self.send_header(key, value)
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(body)


def numbers(camera: SimCamera, poses: Poses) -> dict[str, Any]:
    """Intrinsics, distortion, mount, and the pose at ``poses``: what /NAME.json tells."""
    spec = camera.spec
    center, rotation = camera.pose(poses)
    return {
        "name": camera.name,
        "width": spec.width,
        "height": spec.height,
        "camera_matrix": camera.matrix.tolist(),
        "distortion": list(spec.distortion),
        "mount_deg": list(spec.mount_deg),
        "offset_m": list(spec.offset_m),
        "gimbal": spec.gimbal,
        "rate_hz": spec.rate_hz,
        "pose": {
            "time_s": poses.time_s,
            "unix_s": camera.unix_s(poses),
            "position_ned_m": center.tolist(),
            "attitude_wxyz": camera.attitude(poses),
            "camera_to_world": rotation.tolist(),
        },
    }
