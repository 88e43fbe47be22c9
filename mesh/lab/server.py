"""What serves connections while it is open, and lets go of who is connected when it closes."""

from __future__ import annotations

import abc
import asyncio
import contextlib
from typing import TypeVar

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
