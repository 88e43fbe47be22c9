"""How a zmav process lives: it runs until SIGTERM or SIGINT and then ends cleanly, or starts anew."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from typing import NoReturn


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


def restart() -> NoReturn:
    """Start this program anew in its own place: same process id, arguments and environment; what was open is closed."""
    sys.stdout.flush()
    sys.stderr.flush()
    os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])
