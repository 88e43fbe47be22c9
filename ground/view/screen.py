"""A painter as who started it sees it: it is served what it asks for, and ended without waiting for it."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import struct
import sys
import time
from collections.abc import Callable
from typing import Literal

import msgspec

from ground.view.table import Table
from zmav.waiting import alongside, within

LENGTH = struct.Struct("<I")
"""before every batch"""
READY = b"?"
"""a painter's request for the next one"""
LOST = 3
"""a painter's exit code: its sink takes nothing any more, and never will"""


class Sink(msgspec.Struct, frozen=True):
    """Where a painter logs to."""

    kind: Literal["native", "web", "save"]
    path: str = ""
    """of the file, for ``save``"""
    url: str = ""
    """of Rerun's gRPC proxy, for the others"""
    port: int = 0
    """of that proxy, for ``native`` and ``web``, on loopback"""
    web_port: int = 0
    """where the web viewer is served, on loopback"""

    @property
    def words(self) -> str:
        return {"native": "the viewer", "web": "the web viewer's server", "save": self.path}[self.kind]


class PainterSettings(msgspec.Struct, frozen=True):
    sink: Sink
    several: bool = False
    """vehicles are called ``fleet/vehicle``"""
    size: float = 1.0
    """of the models"""


PATIENCE = 5.0
"""s without a request after which the painter is said to be stuck"""


class Screen:
    """One painter process. ``async with Screen(table, settings, say) as screen: await screen.serve()``.

    It has a process group of its own, with its viewer: Ctrl-C in the terminal reaches neither.
    """

    end = 4.0
    """s for a painter to write out what it has and end, before it is killed"""

    def __init__(self, table: Table, settings: PainterSettings, say: Callable[[str], None]) -> None:
        self._table, self._settings, self._say = table, settings, say
        self.sink = settings.sink
        self._process: asyncio.subprocess.Process | None = None
        self.batches = 0
        self.asked = time.monotonic()
        """when it last asked for more"""
        self.started = asyncio.Event()
        """it has asked for the first time"""

    async def __aenter__(self) -> Screen:
        self.reader = self._table.reader()
        self._process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "ground.view.painter",
            msgspec.json.encode(self._settings).decode(),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            start_new_session=True,
        )
        return self

    async def __aexit__(self, *_: object) -> None:
        process = self._process
        if process is None:
            return
        self._table.drop(self.reader)
        if process.stdin is not None:
            process.stdin.close()
        with contextlib.suppress(asyncio.TimeoutError):
            await within(self.end, process.wait())
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)  # what is left of the group: a stopped viewer, too
        await process.wait()

    @property
    def pid(self) -> int:
        """Of the painter, and of its group."""
        assert self._process is not None
        return self._process.pid

    async def serve(self) -> int:
        """Answer its requests until it ends; its exit code."""
        process = self._process
        assert process is not None and process.stdin is not None and process.stdout is not None
        async with alongside(self._watch()):
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # it has ended meanwhile
                while await process.stdout.read(1) == READY:
                    self.asked = time.monotonic()
                    self.started.set()
                    data = msgspec.msgpack.encode(self.reader.take())
                    process.stdin.write(LENGTH.pack(len(data)) + data)
                    await process.stdin.drain()
                    self.batches += 1
        return await process.wait()

    async def _watch(self) -> None:
        """Say when the painter is stuck, and when it goes on; nothing else need be done about it."""
        await self.started.wait()
        words, stuck = self.sink.words, False
        while True:
            await asyncio.sleep(0.5)
            late = time.monotonic() - self.asked > PATIENCE
            if late and not stuck:
                self._say(f"{words} takes nothing any more: what is shown is old; it goes on with the newest")
            elif stuck and not late:
                self._say(f"{words} goes on")
            stuck = late
