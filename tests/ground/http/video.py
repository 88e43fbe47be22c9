"""A camera's video for the gateway's tests: an agent with a stream, in a thread of its own."""

from __future__ import annotations

import asyncio
import threading
from typing import Any

import zmav
from agents.camera.settings import CameraSettings
from agents.camera.streams import open_stream
from agents.camera.video import VideoAgent
from zmav.session import SessionSettings


class RunningVideo:
    """quad1's camera ``down`` sends ``source`` until it is closed. ``agent`` is on the thread's loop."""

    agent: VideoAgent

    def __init__(
        self, endpoint: str, source: Any = "clock:640x360@20", budget: float = 2e6, fleet: str = "demo"
    ) -> None:
        self._endpoint, self._budget, self._fleet = endpoint, budget, fleet
        self._stream = open_stream(source) if isinstance(source, str) else source
        self._ready = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()), daemon=True)
        self._thread.start()
        assert self._ready.wait(30.0)

    async def _run(self) -> None:
        self._loop, self._stop = asyncio.get_running_loop(), asyncio.Event()
        settings = SessionSettings(connect=[self._endpoint])
        own = CameraSettings(vehicle="quad1", budget=self._budget)
        async with (
            zmav.open(fleet=self._fleet, settings=settings) as z,
            VideoAgent(z, own, [self._stream]) as self.agent,
        ):
            self._ready.set()
            await self._stop.wait()

    def close(self) -> None:
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(30.0)
        assert not self._thread.is_alive()
