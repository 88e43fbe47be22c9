"""A server of streams whose callers do not outlive it; and by it a way from outside into a host's loopback: its router,
as a program in the host's namespace would reach it.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Awaitable, Callable

from mesh.lab.network import Network
from zmav.session import DEFAULT_PORT
from zmav.waiting import until_any

Serve = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]
"""one caller, until it leaves"""


@contextlib.asynccontextmanager
async def serving(listen: Callable[[Serve], Awaitable[asyncio.Server]], serve: Serve) -> AsyncIterator[asyncio.Server]:
    """Open by ``listen``, which gives each caller to what it is called with. A caller that leaves, or sends what is
    unreadable, ends only itself.
    """
    callers = set[asyncio.Task[None]]()

    async def enter(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        callers.add(task)
        try:
            with contextlib.suppress(OSError, ValueError, asyncio.CancelledError):
                await serve(reader, writer)
        finally:
            callers.discard(task)
            writer.close()

    server = await listen(enter)
    try:
        yield server
    finally:
        server.close()
        for caller in list(callers):
            caller.cancel()
        await asyncio.gather(*callers, return_exceptions=True)
        await server.wait_closed()


_CHUNK = 65_536


@contextlib.asynccontextmanager
async def door_of(network: Network, host: str) -> AsyncIterator[str]:
    """An endpoint on our own loopback, each of whose connections leads to the host's router.

    Not the router's unix socket: routers announce the sockets they listen on, and hosts share the file system, so that
    one would be another way between the hosts.
    """

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with network.inside(host):
            theirs = socket.socket()
        with theirs:
            theirs.setblocking(False)
            theirs.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            await asyncio.get_running_loop().sock_connect(theirs, ("127.0.0.1", DEFAULT_PORT))
            back, out = await asyncio.open_connection(sock=theirs)
            with contextlib.closing(out):
                await until_any(_pass(reader, out), _pass(back, writer))

    async with serving(lambda enter: asyncio.start_server(enter, "127.0.0.1", 0), serve) as server:
        yield f"tcp/127.0.0.1:{server.sockets[0].getsockname()[1]}"


async def _pass(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while data := await reader.read(_CHUNK):
        writer.write(data)
        await writer.drain()
