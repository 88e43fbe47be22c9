"""The cameras' pictures for other programs, by HTTP.

``/NAME.mjpeg`` is a stream that browsers and OpenCV's VideoCapture open (multipart/x-mixed-replace: RFC 2046, section
5.1; each part is a JPEG), ``/NAME.json`` says what the camera's lens and mount are. Every picture comes with X-Time
(simulated seconds) and X-Timestamp (UTC seconds). Anyone who is slow gets the latest picture, not all of them.
"""

from __future__ import annotations

import errno
import json
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from socketserver import TCPServer
from typing import Any

import cv2

from zmav.errors import BadInput, PortInUse
from zmav.sim.camera.cameras import Cameras, Poses, SimCamera

HOST = "127.0.0.1"
BOUNDARY = "zmav-frame"
JPEG_QUALITY = 85
STALLED_S = 10.0  # a client that takes nothing for so long is given up


def serve_cameras(cameras: Cameras, port: int) -> dict[str, str]:
    """Serve every camera by HTTP on loopback until the world is closed; gives the URL of each one's pictures. Port 0:
    any free one.

    Raises :class:`PortInUse`, and :class:`BadInput` where they are served already.
    """
    if cameras.server is not None:
        raise BadInput("the cameras are served already", field="port", value=port, expected="one server")
    for camera in cameras.all:
        camera.prepare()
    cameras.server = server = CameraServer(cameras, port)
    return {camera.name: f"{server.url}/{camera.name}.mjpeg" for camera in cameras.all}


class Feed:
    """One camera's pictures: rendered in a thread of its own while somebody watches."""

    def __init__(self, camera: SimCamera, now: float) -> None:
        self.camera = camera
        self.viewers = 0
        self.closed = False
        self.rendered = 0
        """pictures so far; :attr:`part` is the latest, as it stands in the stream"""
        self.part = b""
        self._next: Poses | None = None
        self._due = now + 1.0 / camera.spec.rate_hz
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
        if self.viewers:
            with self._changed:
                self._next = poses
                self._changed.notify_all()

    # ---- its own thread

    def _run(self) -> None:
        try:
            self._render()
        finally:
            self._end()  # also where a defect ends it: nobody is to wait for pictures that will not come

    def _render(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self.closed or self._next is not None)
                poses, self._next = self._next, None
            if self.closed or poses is None:
                return
            frame = self.camera.capture(poses)
            jpeg = cv2.imencode(".jpg", frame.image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()
            head = (
                f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n"
                f"X-Time: {frame.time_s:.6f}\r\nX-Timestamp: {frame.unix_s:.6f}\r\n\r\n"
            )
            with self._changed:
                self.part = head.encode() + jpeg + b"\r\n"
                self.rendered += 1
                self._changed.notify_all()

    def _end(self) -> None:
        with self._changed:
            self.closed = True
            self._changed.notify_all()

    # ---- clients' threads

    def watch(self, more: int) -> None:
        """One viewer more, or with -1 one less."""
        with self._changed:
            self.viewers += more

    def after(self, count: int) -> tuple[int, bytes]:
        """The latest picture once there are more than ``count``, and which it is; none at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self.closed or self.rendered > count)
            return self.rendered, b"" if self.closed else self.part

    def close(self) -> None:
        self._end()
        self._thread.join()


class CameraServer:
    """Listens at ``port`` of loopback until :meth:`close`. Raises :class:`PortInUse`, :class:`BadInput`."""

    def __init__(self, cameras: Cameras, port: int) -> None:
        if not 0 <= port <= 65535:
            raise BadInput.wrong("port", port, "0 to 65535", f"port {port}")
        cv2.setNumThreads(1)  # pictures are many and small: further threads would only take turns with the vehicles
        try:
            self._server = _Server((HOST, port), _Handler)
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                text = f"port {port}, for the cameras, is in use by another program; choose another, or 0 for any"
                raise PortInUse(text, port=port) from error
            text = f"cameras at {HOST}:{port}: {error}"
            raise BadInput(text, field="port", value=port, expected="a free port") from error
        now = cameras.look().time_s
        self.feeds = self._server.feeds = {camera.name: Feed(camera, now) for camera in cameras.all}
        self.port = int(self._server.server_address[1])
        self.url = f"http://{HOST}:{self.port}"
        self._thread = threading.Thread(target=self._server.serve_forever, name="zmav-cameras", daemon=True)
        self._thread.start()

    def tick(self, now: float, snapshot: Callable[[], Poses]) -> None:
        """Hand the cameras that are due at ``now`` where everything is; all of them get the same."""
        if due := [feed for feed in self.feeds.values() if feed.due(now)]:
            poses = snapshot()
            for feed in due:
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
    feeds: dict[str, Feed]

    def server_bind(self) -> None:
        """Without asking the network for this machine's name, which may take seconds."""
        TCPServer.server_bind(self)
        host, port = self.server_address[:2]
        self.server_name, self.server_port = str(host), int(port)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that vanishes is nobody's error."""


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    server_version = "zmav"
    sys_version = ""
    timeout = STALLED_S

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing is logged."""

    def do_GET(self) -> None:
        name, _, kind = self.path.partition("?")[0].strip("/").rpartition(".")
        feed = self.server.feeds.get(name)
        try:
            if feed is not None and kind == "mjpeg":
                self._stream(feed)
            elif feed is not None and kind == "json":
                self._begin("application/json")
                self.wfile.write(json.dumps(numbers(feed.camera)).encode())
            else:
                there = ", ".join(f"/{each}.mjpeg" for each in self.server.feeds)
                self.send_error(404, "no such picture", f"there are {there}, and .json of each")
        except OSError:
            self.close_connection = True  # it has gone, or takes nothing

    def _begin(self, kind: str) -> None:
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Cache-Control", "no-store")
        self.end_headers()

    def _stream(self, feed: Feed) -> None:
        self._begin(f"multipart/x-mixed-replace; boundary={BOUNDARY}")
        feed.watch(1)
        try:
            count, part = feed.after(feed.rendered)
            while part:
                self.wfile.write(part)
                count, part = feed.after(count)
        finally:
            feed.watch(-1)


def numbers(camera: SimCamera) -> dict[str, Any]:
    """Intrinsics and mount."""
    spec = camera.spec
    return {
        "name": camera.name,
        "width": spec.width,
        "height": spec.height,
        "camera_matrix": camera.matrix.tolist(),
        "mount_deg": list(spec.mount_deg),
        "offset_m": list(spec.offset_m),
        "gimbal": spec.gimbal,
        "rate_hz": spec.rate_hz,
    }
