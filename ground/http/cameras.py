"""``GET /camera/{vehicle}/{camera}``: a camera's pictures as MJPEG, for the page, a script or a video player.

A vehicle sends pictures only while somebody looks, and as many as the way to us carries (docs/camera.md); here each
camera is read once for all who look. Of each reader only the newest picture waits: one that takes them slower than they
come gets fewer, and none of them is late.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import secrets
from collections import Counter
from collections.abc import Iterator

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route
from starlette.types import Receive, Scope, Send

from ground.http import video
from ground.http.gateway import Gateway
from ground.http.reply import Failure
from ground.http.server import send_the_newest
from ground.http.sharing import Pool, Shared
from zmav import keys
from zmav.client import Client
from zmav.errors import VehicleError
from zmav.vision.reader import Picture, Reader, camera_info
from zmav.waiting import until_any

MOST = 32
"""readers at once"""
MOST_EACH = 3
"""of one address: a browser has six connections to a host, and no order is to wait for a picture"""
HEADERS = (
    (b"cache-control", b"no-store"),
    (b"x-content-type-options", b"nosniff"),
)


class Pictures(Shared[Reader]):
    """The newest picture for each who looks."""

    kind = Reader

    def __init__(self, client: Client, vehicle: str, camera: str) -> None:
        self.newest: tuple[int, Picture] | None = None
        """and how many came before it"""
        self._news = asyncio.Event()
        super().__init__(client, vehicle, camera)

    async def after(self, count: int) -> tuple[int, Picture] | None:
        """The newest picture, which as many or more came before; waits for one. None: no more will come."""
        while not self.ended:
            if self.newest is not None and self.newest[0] >= count:
                return self.newest
            await self._news.wait()
        return None

    @property
    def count(self) -> int:
        """Pictures that came."""
        return self.newest[0] + 1 if self.newest is not None else 0

    async def _take(self) -> None:
        async for picture in self.reader:
            self.newest = self.count, picture
            news, self._news = self._news, asyncio.Event()
            news.set()

    def _end(self) -> None:
        """Who still looks is told: nobody waits for a picture that cannot come."""
        super()._end()
        self._news.set()


class Cameras(Pool[Pictures]):
    """Every camera that somebody looks at, and who does."""

    def __init__(self, gateway: Gateway) -> None:
        super().__init__(functools.partial(Pictures, gateway.client))
        self._client = gateway.client
        self._readers: Counter[str] = Counter()
        """by address"""
        self.sent = self.left_out = 0
        """pictures, of all readers; and those for which one of them was too slow"""
        gateway.at_end(self._close)

    async def look(self, request: Request) -> Response:
        """A camera's pictures, live: multipart/x-mixed-replace, as an img element and most video players read it.

        Each part is a JPEG with X-Timestamp (UTC seconds at the middle of the exposure) and X-Sequence (as seq in its
        detections). A reader that is slow gets fewer of them.
        """
        vehicle, camera = request.path_params["vehicle"], request.path_params["camera"]
        return _Mjpeg(self, vehicle, camera, request.client.host if request.client else "")

    @property
    def readers(self) -> int:
        return self._readers.total()

    @contextlib.contextmanager
    def counted(self, address: str) -> Iterator[None]:
        """Raises :class:`Failure` where there are too many."""
        if self.readers >= MOST or self._readers[address] >= MOST_EACH:
            text = f"there are {self._readers[address]} readers of pictures at {address}, and {self.readers} in all"
            raise Failure(429, "too_many", f"{text}: no more than {MOST_EACH} and {MOST}")
        self._readers[address] += 1
        try:
            yield
        finally:
            self._readers[address] -= 1
            self._readers += Counter()  # addresses without readers are forgotten

    async def check(self, vehicle: str, camera: str) -> None:
        """Raises :class:`Failure` where there is no such camera, :class:`~zmav.errors.BadKey` for what is no name."""
        keys.check_name(vehicle, "vehicle")
        keys.check_name(camera, "camera")
        shared = self.being_read.get((vehicle, camera))
        if shared is not None and shared.count and not shared.ended:
            return
        try:
            await camera_info(self._client, vehicle, camera)
        except VehicleError as e:
            raise Failure(404, "not_found", e.message) from e

    def _close(self) -> None:
        for shared in self.being_read.values():
            shared.close()


class _Mjpeg(Response):
    """Pictures until the reader goes."""

    def __init__(self, cameras: Cameras, vehicle: str, camera: str, address: str) -> None:
        super().__init__()
        self._cameras, self._place, self._address = cameras, (vehicle, camera), address
        self._mark = f"zmav-{secrets.token_hex(8)}".encode()
        """between the parts: none that a picture could hold on purpose, to pass for a page of ours"""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        with self._cameras.counted(self._address):
            await self._cameras.check(*self._place)
            kind = b"multipart/x-mixed-replace; boundary=" + self._mark
            headers = [(b"content-type", kind), *HEADERS]
            await send({"type": "http.response.start", "status": 200, "headers": headers})
            if scope["method"] == "HEAD":
                await send({"type": "http.response.body"})
                return
            send_the_newest(scope)
            with self._cameras.shared(*self._place) as shared:
                await until_any(_gone(receive), self._send_all(shared, send))

    async def _send_all(self, shared: Pictures, send: Send) -> None:
        boundary = b"--" + self._mark + b"\r\n"
        await _put(send, boundary)
        count = shared.count  # what came before is of another time
        while found := await shared.after(count):
            at, picture = found
            self._cameras.left_out += at - count
            count = at + 1
            # The boundary that ends a part goes with it: some browsers show a picture only then.
            await _put(send, _head(picture) + picture.jpeg + b"\r\n" + boundary)
            await _put(send, b"")  # returns when what is before it has gone
            self._cameras.sent += 1
        await send({"type": "http.response.body"})


def _head(picture: Picture) -> bytes:
    said = {
        "Content-Type": "image/jpeg",
        "Content-Length": len(picture.jpeg),
        "X-Timestamp": f"{picture.t:.6f}",
        "X-Sequence": picture.seq,
    }
    return "".join(f"{name}: {value}\r\n" for name, value in said.items()).encode() + b"\r\n"


async def _put(send: Send, data: bytes) -> None:
    await send({"type": "http.response.body", "body": data, "more_body": True})


async def _gone(receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass


def routes(gateway: Gateway) -> list[BaseRoute]:
    cameras = Cameras(gateway)
    gateway.figures.update(
        camera_readers=lambda: cameras.readers,
        pictures=lambda: cameras.sent,
        pictures_left_out=lambda: cameras.left_out,
    )
    pictures = Route("/camera/{vehicle}/{camera}", cameras.look, methods=["GET"])
    return [pictures, *video.routes(gateway, cameras.counted)]
