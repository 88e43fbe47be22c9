"""The pictures that come, for a browser on this computer: multipart over HTTP on loopback."""

from __future__ import annotations

import asyncio
import contextlib
from types import TracebackType

from zmav.errors import PortInUse
from zmav.vision.reader import Picture

PAGE = b'<!doctype html><title>zmav camera</title><body style="margin:0;background:#111"><img src="/mjpeg">'
BOUNDARY = "zmav-frame"
STALLED = 10.0
"""s after which a browser that takes nothing is given up"""
LONGEST_REQUEST = 8192
CLIENTS = 8


class WebServer:
    """``async with WebServer(port)``: what :meth:`show` gets is seen at :attr:`url`. Raises :class:`PortInUse`."""

    def __init__(self, port: int) -> None:
        self.url = ""
        self._port = port
        self._picture: Picture | None = None
        self._news = asyncio.Condition()
        self._server: asyncio.Server | None = None
        self._clients: set[asyncio.Task[None]] = set()

    async def __aenter__(self) -> WebServer:
        try:
            self._server = await asyncio.start_server(self._meet, "127.0.0.1", self._port, limit=LONGEST_REQUEST)
        except OSError as e:
            raise PortInUse(f"cannot listen at port {self._port}: {e.strerror}", port=self._port) from e
        self.url = f"http://127.0.0.1:{self._server.sockets[0].getsockname()[1]}"
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None
    ) -> None:
        if self._server is not None:
            self._server.close()
        for client in self._clients:
            client.cancel()
        await asyncio.gather(*self._clients, return_exceptions=True)

    async def show(self, picture: Picture) -> None:
        async with self._news:
            self._picture = picture
            self._news.notify_all()

    async def _meet(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        client = asyncio.current_task()
        assert client is not None
        if len(self._clients) < CLIENTS:
            self._clients.add(client)
            # It has gone, stalls, or asks nothing that is there.
            with contextlib.suppress(OSError, asyncio.TimeoutError, asyncio.IncompleteReadError, ValueError):
                await self._answer(reader, writer)
            self._clients.discard(client)
        writer.close()

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            request = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), STALLED)
        except asyncio.LimitOverrunError:
            return
        path = request.split(b" ", 2)[1] if request.startswith(b"GET ") else b""
        if path == b"/mjpeg":
            await self._stream(writer)
            return
        status, body = ("200 OK", PAGE) if path == b"/" else ("404 Not Found", b"there are / and /mjpeg")
        head = (
            f"HTTP/1.1 {status}\r\nContent-Type: text/html\r\nContent-Length: {len(body)}\r\nConnection: close\r\n\r\n"
        )
        writer.write(head.encode() + body)
        await asyncio.wait_for(writer.drain(), STALLED)

    async def _stream(self, writer: asyncio.StreamWriter) -> None:
        kind = f"multipart/x-mixed-replace; boundary={BOUNDARY}"
        writer.write(f"HTTP/1.1 200 OK\r\nContent-Type: {kind}\r\nCache-Control: no-store\r\n\r\n".encode())
        shown: Picture | None = None
        while True:
            async with self._news:
                if self._picture is shown:
                    await self._news.wait()
                shown = self._picture
            if shown is None:
                continue
            head = f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(shown.jpeg)}\r\n"
            writer.write(f"{head}X-Timestamp: {shown.t:.6f}\r\n\r\n".encode() + shown.jpeg + b"\r\n")
            await asyncio.wait_for(writer.drain(), STALLED)
