"""How a zmav process lives: it runs until SIGTERM or SIGINT and then ends cleanly."""

from __future__ import annotations

import asyncio
import signal


async def until_stopped() -> None:
    """Return when the process is asked to end (SIGTERM, SIGINT). Run in the main thread."""
    stop, loop = asyncio.Event(), asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    try:
        await stop.wait()
    finally:
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.remove_signal_handler(number)
