"""A server of streams and its callers, of which none outlives it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable

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
