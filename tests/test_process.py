"""How a process lives on when nobody reads what it says, and what it sets for numpy."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from zmav.process import free_port, say


def test_what_nobody_reads_ends_nothing(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    say("a line")
    assert capsys.readouterr().err == "a line\n"
    reader, writer = os.pipe()
    os.close(reader)
    stream = os.fdopen(writer, "w", buffering=1)
    monkeypatch.setattr(sys, "stderr", stream)
    with pytest.raises(BrokenPipeError):
        print("a line", file=stream)
    say("a line")
    os.close(writer)
    say("a line")
    monkeypatch.undo()
    with pytest.raises(OSError, match="Bad file descriptor"):
        stream.close()


IMPATIENT = """
import asyncio, os, signal
from zmav.process import until_stopped

async def close():
    await asyncio.sleep(0.3)
    print("closed", flush=True)

async def main():
    asyncio.get_running_loop().call_later(0.1, os.kill, os.getpid(), signal.SIGINT)
    await until_stopped()
    asyncio.get_running_loop().call_later(0.1, os.kill, os.getpid(), signal.SIGINT)
    closing = asyncio.create_task(close())
    try:
        await asyncio.shield(closing)
    finally:
        await asyncio.wait({closing})

asyncio.run(main())
"""


@pytest.mark.skipif(sys.version_info < (3, 11), reason="asyncio.run raises it anywhere")
def test_a_second_interrupt_leaves_what_closes_alone() -> None:
    done = subprocess.run([sys.executable, "-c", IMPATIENT], capture_output=True, text=True, timeout=30, check=False)
    assert (done.stdout, done.returncode) == ("closed\n", -signal.SIGINT), done.stderr


@pytest.mark.parametrize(("given", "found"), [(None, "1"), ("3", "3")])
def test_numpy_has_one_thread_unless_somebody_says_otherwise(
    monkeypatch: pytest.MonkeyPatch, given: str | None, found: str
) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", given or "")
    if given is None:
        monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    show = "print(os.environ['OPENBLAS_NUM_THREADS'])"
    program = f"import atexit, os; from zmav.cli import main; atexit.register(lambda: {show}); main()"
    done = subprocess.run([sys.executable, "-c", program, "--help"], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == found


def test_ports_are_given_once_and_are_none_that_the_system_hands_out() -> None:
    first, last = map(int, Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split())
    held = [free_port() for _ in range(200)]
    assert len(set(held)) == len(held)
    assert not [port for port in held if first <= port <= last]
    with contextlib.ExitStack() as stack:
        for port in range(held[-1] + 1, held[-1] + 20):
            with contextlib.suppress(OSError):  # somebody else's
                stack.enter_context(socket.socket()).bind(("127.0.0.1", port))
        assert free_port() not in range(held[-1] + 1, held[-1] + 20)
    with pytest.raises(OSError, match="assign"):
        free_port(host="192.0.2.1")
