"""A way from outside into a host's loopback: its router, as a program in the host's namespace would reach it."""

from __future__ import annotations

import abc
import asyncio
import contextlib
import socket
from typing import TypeVar

from mesh.lab.network import Network

T = TypeVar("T", bound="Server")


class Server(abc.ABC):
    """Open while ``async with`` lasts. Anyone who calls and leaves, or sends what is unreadable, ends only itself."""

    def __init__(self) -> None:
        self._server: asyncio.Server | None = None
        self._callers: set[asyncio.Task[None]] = set()

    @abc.abstractmethod
    async def listen(self) -> asyncio.Server:
        """Open, with :meth:`_enter` for who calls."""

    @abc.abstractmethod
    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One caller, until it leaves."""

    async def __aenter__(self: T) -> T:
        self._server = await self.listen()
        return self

    async def __aexit__(self, *_: object) -> None:
        assert self._server is not None
        self._server.close()
        for caller in list(self._callers):
            caller.cancel()
        await asyncio.gather(*self._callers, return_exceptions=True)
        await self._server.wait_closed()

    async def _enter(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._callers.add(task)
        try:
            with contextlib.suppress(OSError, ValueError, asyncio.CancelledError):
                await self.serve(reader, writer)
        finally:
            self._callers.discard(task)
            writer.close()


PORT = 7447
_CHUNK = 65_536


class HostProxy(Server):
    """Listens on a free port of our loopback, and leads every connection to ``port`` on the host's."""

    def __init__(self, network: Network, host: str, port: int = PORT) -> None:
        super().__init__()
        self._network, self._host, self._port = network, host, port

    async def listen(self) -> asyncio.Server:
        return await asyncio.start_server(self._enter, "127.0.0.1", 0)

    @property
    def endpoint(self) -> str:
        """For ``-e`` and :class:`zmav.session.SessionSettings`."""
        assert self._server is not None
        return f"tcp/127.0.0.1:{self._server.sockets[0].getsockname()[1]}"

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with self._network.inside(self._host):
            theirs = socket.socket()
        try:
            theirs.setblocking(False)
            theirs.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            await asyncio.get_running_loop().sock_connect(theirs, ("127.0.0.1", self._port))
            back, out = await asyncio.open_connection(sock=theirs)
        except OSError:
            theirs.close()
            raise
        ways = [asyncio.ensure_future(_pass(reader, out)), asyncio.ensure_future(_pass(back, writer))]
        try:
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for way in ways:
                way.cancel()
            await asyncio.gather(*ways, return_exceptions=True)
            out.close()


async def _pass(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while data := await reader.read(_CHUNK):
        writer.write(data)
        await writer.drain()
