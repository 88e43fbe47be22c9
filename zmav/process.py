"""How a zmav process lives: it runs until SIGTERM or SIGINT, and then ends or starts anew."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
from typing import NoReturn

import click


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


def say(line: str) -> None:
    """A line on standard error for whoever watches; that nobody does any more (a closed terminal) ends nothing."""
    with contextlib.suppress(OSError, ValueError):
        click.echo(line, err=True)


def restart() -> NoReturn:
    """Start this program anew in its own place: same process id, arguments and environment; what was open is closed."""
    _flush()
    os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])


def leave() -> NoReturn:
    """End this process at once, in good order (code 0), once all that is ours is closed.

    Zenoh 1.10 may still be closing links in threads of its own: one that comes back to Python while the interpreter
    ends aborts the process (3 of 5 on a busy machine).
    """
    _flush()
    os._exit(0)


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
