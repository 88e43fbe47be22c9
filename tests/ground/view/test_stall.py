"""A viewer that stalls, and how everything ends: real processes, files and sockets."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
import sys
import time
import urllib.request
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import zenoh

from ground.view.cli import sinks_of
from ground.view.screen import LOST, PainterSettings, Screen, Sink
from ground.view.table import Table
from tests.waiting import until
from zmav import keys, wire
from zmav.errors import BadConfig
from zmav.process import free_port
from zmav.waiting import within

if TYPE_CHECKING:
    from tests.conftest import Net

Read = Callable[[Path], dict[str, list[Any]]]
PATIENCE_S = 60.0
Q1 = ("demo", "quad1")
POSE = "/world/ned/vehicles/quad1/pose"


def north_of(rows: dict[str, list[Any]]) -> list[float]:
    """Where quad1 was drawn, in the order in which it was."""
    return [row.values["Transform3D:translation"][0][0] for row in rows.get(POSE, [])]


def alive(pid: int) -> bool:
    """A process that runs, or has been stopped; not one that has ended and was not waited for."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


def children(pid: int) -> list[int]:
    """Of a process, and theirs."""
    found = [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    return found + [grandchild for child in found for grandchild in children(child)]


async def test_a_stopped_painter_holds_up_nobody_and_goes_on_with_the_newest(
    tmp_path: Path, state: Callable[..., wire.VehicleState], read: Read
) -> None:
    kept, path, said = Table(), tmp_path / "a.rrd", list[str]()
    async with Screen(kept, PainterSettings(Sink("save", path=str(path))), said.append) as screen:
        serving = asyncio.create_task(screen.serve())
        kept.put("state", Q1, wire.encode(state(local=(1.0, 0.0, -5.0))))
        await within(PATIENCE_S, screen.started.wait())
        os.kill(screen.pid, signal.SIGSTOP)
        await asyncio.sleep(0)
        before = screen.batches
        for i in range(5000):
            kept.put("state", Q1, wire.encode(state(local=(100.0 + i, 0.0, -5.0))))
        assert len(screen.reader) == 1, "one newest value waits, not five thousand"
        await until(lambda: bool(said), "it was not said that the file takes nothing")
        assert screen.batches <= before + 1
        assert "takes nothing any more" in said[0]
        os.kill(screen.pid, signal.SIGCONT)
        goal = screen.batches + 3
        await until(lambda: screen.batches >= goal, "it did not go on")
        serving.cancel()
    drawn = north_of(read(path))
    assert drawn[-1] == 5099.0
    assert len(drawn) <= 3, "what was overwritten was drawn, too"


async def test_a_painter_that_can_open_nothing_is_ended_all_the_same(
    tmp_path: Path,
) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)  # nobody reads it: who opens it to write waits for ever
    kept = Table()
    async with Screen(kept, PainterSettings(Sink("save", path=str(pipe))), print) as screen:
        screen.end = 0.5
        kept.put("state", Q1, b"{}")
        kept.put("state", Q1, b"{ }")
        assert len(screen.reader) == 1
        pid = screen.pid
    assert not alive(pid)


async def test_a_file_that_grows_no_more_ends_its_painter(
    tmp_path: Path, state: Callable[..., wire.VehicleState]
) -> None:
    """It was deleted; a full disk looks alike."""
    kept, path = Table(), tmp_path / "a.rrd"
    async with Screen(kept, PainterSettings(Sink("save", path=str(path))), print) as screen:
        serving = asyncio.create_task(screen.serve())
        await within(PATIENCE_S, screen.started.wait())
        path.unlink()
        assert await within(PATIENCE_S, _fed(kept, state(), serving)) == LOST


async def _fed(kept: Table, state: wire.VehicleState, serving: asyncio.Task[int]) -> int:
    while not serving.done():
        kept.put("state", Q1, wire.encode(state))
        await asyncio.wait([serving], timeout=0.5)
    return serving.result()


async def _started(endpoint: str, *options: str, lines: int) -> tuple[asyncio.subprocess.Process, list[str]]:
    """``zmav view``, and the first lines that it says."""
    command = (sys.executable, "-m", "zmav", "view", "-e", endpoint, *options)
    process = await asyncio.create_subprocess_exec(*command, stderr=asyncio.subprocess.PIPE)
    assert process.stderr is not None
    return process, [(await within(PATIENCE_S, process.stderr.readline())).decode() for _ in range(lines)]


@pytest.fixture
def drawn(
    net: Net, tmp_path: Path, state: Callable[..., wire.VehicleState], read: Read
) -> Callable[[zenoh.Session, Path], Coroutine[Any, Any, None]]:
    """Waits until quad1, whose state is put again and again, is in a file."""

    async def wait(session: zenoh.Session, path: Path) -> None:
        key = keys.STATE.key(*Q1)
        await net.linked(session, key)

        def grown() -> bool:
            session.put(key, wire.encode(state(local=(7.0, 8.0, -9.0), t=time.time())))
            try:
                return path.stat().st_size > 0 and bool(north_of(read(path)))
            except RuntimeError:  # in the middle of a row that is being written
                return False

        await until(grown, "nothing was drawn")

    return wait


@pytest.mark.filterwarnings("ignore:RRD file has no footer")
async def test_the_program_records_the_fleet_until_it_is_killed(
    net: Net, tmp_path: Path, read: Read, drawn: Callable[[zenoh.Session, Path], Coroutine[Any, Any, None]]
) -> None:
    (session, endpoint), path = net.router(), tmp_path / "a.rrd"
    process, (said,) = await _started(endpoint, "--save", str(path), lines=1)
    try:
        assert "recording to" in said
        (painter,) = children(process.pid)
        await drawn(session, path)
        process.kill()
        assert await within(PATIENCE_S, process.wait()) == -signal.SIGKILL
        await until(lambda: not alive(painter), "its painter lives on")
    finally:
        if process.returncode is None:
            process.kill()
    assert set(north_of(read(path))) == {7.0}


async def test_it_ends_when_it_is_asked_to_also_with_a_viewer_that_is_stopped(
    net: Net, tmp_path: Path, read: Read, drawn: Callable[[zenoh.Session, Path], Coroutine[Any, Any, None]]
) -> None:
    """A page and a file at a time."""
    (session, endpoint), port, path = net.router(), free_port(), tmp_path / "a.rrd"
    options = ("--web", "--port", str(port), "--save", str(path))
    process, (recording, opened) = await _started(endpoint, *options, lines=2)
    try:
        assert "recording to" in recording
        assert opened.startswith("open http://127.0.0.1:"), opened
        page, policy = await asyncio.to_thread(_fetched, opened.split()[1])
        assert b"<html" in page.lower()
        assert policy == f"connect-src 'self' http://127.0.0.1:{port + 1} data: blob:", "it sends statistics elsewhere"
        program, policy = await asyncio.to_thread(_fetched, f"http://127.0.0.1:{port}/re_viewer_bg.wasm")
        assert program.startswith((b"\0asm", b"\x1f\x8b"))
        family = children(process.pid)
        assert len(family) == 3, "a painter of the file, one of the page, and the viewer's server"
        assert not _beyond_loopback(family[-1])
        await drawn(session, path)
        os.kill(family[-1], signal.SIGSTOP)
        process.terminate()
        assert await within(PATIENCE_S, process.wait()) == 0
        await until(lambda: not any(map(alive, family)), "somebody was left behind")
    finally:
        if process.returncode is None:
            process.kill()
    assert set(north_of(read(path))) == {7.0}


def _fetched(url: str) -> tuple[bytes, str]:
    """A page, and what a browser lets it do."""
    with urllib.request.urlopen(url, timeout=PATIENCE_S) as answer:
        return answer.read(), answer.headers["Content-Security-Policy"]


def _beyond_loopback(pid: int) -> list[str]:
    """Listening TCP sockets of a process that are not on loopback."""
    sockets = {str(fd.readlink()) for fd in Path(f"/proc/{pid}/fd").iterdir() if fd.is_symlink()}
    lines = [
        line.split() for table in ("tcp", "tcp6") for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]
    ]
    listening = [line[1] for line in lines if line[3] == "0A" and f"socket:[{line[9]}]" in sockets]
    assert listening, "it listens nowhere: the test looks in the wrong place"
    return [where for where in listening if not where.startswith("0100007F:")]


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"save": "/nowhere/at/all.rrd"}, "save"),
        ({"save": "/dev/full"}, "save"),
        ({}, "DISPLAY"),
    ],
)
def test_what_cannot_be_shown_is_said_with_what_to_do(
    monkeypatch: pytest.MonkeyPatch, options: dict[str, Any], field: str
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(BadConfig) as raised:
        sinks_of(options.get("save"), options.get("web", False), 9090)
    assert raised.value.detail["field"] == field
    if field == "DISPLAY":
        assert "--web" in str(raised.value) and "--save" in str(raised.value)


def test_a_port_that_is_taken_is_named() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(BadConfig, match=f"port {port}"):
            sinks_of(None, True, port)
