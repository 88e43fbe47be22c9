"""How a zmav process lives: it runs until SIGTERM or SIGINT, and then ends or starts again; how a script does; and free
ports for those that it starts.
"""

from __future__ import annotations

import asyncio
import contextlib
import datetime
import errno
import itertools
import os
import secrets
import signal
import socket
import stat
import sys
import tempfile
from collections.abc import Coroutine
from pathlib import Path
from typing import Any, NoReturn

import click

from zmav import systemd
from zmav.errors import BadConfig, ZmavError

FREE_PORTS = range(20_000, 32_000)
"""beyond those that vehicles, ground stations and routers are usually found at"""
_NUMBERS = itertools.count(secrets.randbelow(len(FREE_PORTS)))
"""of the ports that this process gives: another one, which begins elsewhere, does not come upon them soon"""


def run(main: Coroutine[Any, Any, int | None]) -> None:
    """Run a script to its end, as ``asyncio.run``, and end the process with what it returns where that is a number.

    Ctrl-C and SIGTERM cancel it, and what it does then (``except asyncio.CancelledError``, ``async with``) is waited
    for. It ends without a traceback: with 130 after Ctrl-C, 0 after SIGTERM, and 1 and its words after a
    :class:`~zmav.errors.ZmavError`. In the main thread.
    """

    async def body() -> int | None:
        task = asyncio.current_task()
        assert task is not None
        asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, task.cancel)
        return await main

    try:
        code = asyncio.run(body())
    except KeyboardInterrupt:
        sys.exit(130)
    except asyncio.CancelledError:
        sys.exit(0)
    except ZmavError as e:
        sys.exit(f"{Path(sys.argv[0]).stem}: {e}")
    if code is not None:
        sys.exit(code)


async def until_stopped() -> None:
    """Return when the process is asked to end (SIGTERM, SIGINT). Run in the main thread.

    A second SIGINT, while what is open is closed, cancels the main task, as ``asyncio.run`` has it from Python 3.11 on.
    """
    stop, loop, before = asyncio.Event(), asyncio.get_running_loop(), signal.getsignal(signal.SIGINT)
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    try:
        await stop.wait()
    finally:
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.remove_signal_handler(number)
        if before is not None:  # else KeyboardInterrupt comes anywhere: also where the loop is told of a thread's end
            signal.signal(signal.SIGINT, before)


def say(line: str) -> None:
    """A line on standard error for anyone who watches; that nobody does any more (a closed terminal) ends nothing."""
    with contextlib.suppress(OSError, ValueError):
        click.echo(line, err=True)


def log(line: str) -> None:
    """As :func:`say`, for a program that runs for long: with the local time, but where a journal keeps times itself."""
    say(line if systemd.journals() else f"{datetime.datetime.now().isoformat(' ', 'milliseconds')} {line}")


def own_directory(name: str, advice: str) -> Path:
    """Where this user's running programs of a kind have their sockets; made where it is missing.

    In ``XDG_RUNTIME_DIR``, or else in the directory for temporary files. :class:`BadConfig`, with ``advice``, where it
    belongs to somebody else, or others may write to it.
    """
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    base = Path(runtime) / name if runtime else Path(tempfile.gettempdir()) / f"{name}-{os.getuid()}"
    try:
        base.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = base.lstat()
    except OSError as e:
        text = f"cannot make the directory {base}: {e.strerror}; {advice}"
        raise BadConfig(text, field="directory", value=str(base), expected="a directory that can be made") from e
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o022:
        text = f"{base} is not a directory of yours alone; remove it, or {advice}"
        raise BadConfig(text, field="directory", value=str(base), expected="a directory that only you may write to")
    return base


def restart() -> NoReturn:
    """Restart this program in its own place: same process id, arguments and environment; what was open is closed."""
    _flush()
    os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])


def leave(code: int) -> NoReturn:
    """End this process at once, where all that is ours is closed.

    Zenoh 1.10 may still be closing links in threads of its own, or bring a message: one that comes back to Python while
    the interpreter ends aborts the process (3 of 5 on a busy machine).
    """
    _flush()
    os._exit(code)


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()


def free_port(kind: int = socket.SOCK_STREAM, host: str = "127.0.0.1") -> int:
    """A port nobody uses now at an address of this computer, for a program that opens it some seconds later.

    It is none of those that the system hands out by itself (``ip_local_port_range``, 32768 to 60999 mostly): any
    connection, or program that lets the system choose, would take such a one meanwhile. Nor is it one that was given
    before, so that a fleet may have all of its ports before it opens any.
    """
    for number in itertools.islice(_NUMBERS, len(FREE_PORTS)):
        port = FREE_PORTS[number % len(FREE_PORTS)]
        with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, kind) as s:
            try:
                s.bind((host, port))
            except OSError as e:
                if e.errno != errno.EADDRINUSE:
                    raise
                continue
            return port
    raise OSError(errno.EADDRINUSE, f"no port from {FREE_PORTS[0]} to {FREE_PORTS[-1]} is free at {host}")
