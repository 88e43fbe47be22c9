"""sd_notify through real sockets, and what feeds systemd's watchdog: event loop and stream watchdog, both of them."""

from __future__ import annotations

import asyncio
import os
import socket
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.cli.conftest import Process
from tests.services.conftest import Bench, StartBench, bench, peer
from zmav import systemd
from zmav.bus import Alive
from zmav.process import free_port

if TYPE_CHECKING:
    from tests.conftest import Net

__all__ = ["bench", "peer"]
PATIENCE_S = 30.0


class Manager:
    """The other end of $NOTIFY_SOCKET."""

    def __init__(self, address: str) -> None:
        self.address = address
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind("\0" + address[1:] if address.startswith("@") else address)
        self.socket.settimeout(PATIENCE_S)

    def told(self) -> list[str]:
        """The lines of the next datagram, waited for."""
        return self.socket.recv(4096).decode().split("\n")

    def until(self, line: str) -> list[str]:
        """The first datagram with that line."""
        while line not in (told := self.told()):
            pass
        return told

    def drain(self) -> int:
        """How many came since; all are taken."""
        self.socket.setblocking(False)
        count = 0
        try:
            while self.socket.recv(4096):
                count += 1
        except BlockingIOError:
            return count
        finally:
            self.socket.settimeout(PATIENCE_S)
        return count


@pytest.fixture(params=["path", "abstract"])
def manager(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Manager]:
    if request.param == "abstract" and not sys.platform.startswith("linux"):
        pytest.skip("abstract sockets are Linux's")
    opened = Manager(str(tmp_path / "notify") if request.param == "path" else f"@zmav-test-{os.getpid()}")
    monkeypatch.setenv("NOTIFY_SOCKET", opened.address)
    with opened.socket:
        yield opened


def test_lines_arrive_as_one_datagram(manager: Manager) -> None:
    assert systemd.notify("READY=1", "STATUS=two\nlines, ü")
    assert manager.told() == ["READY=1", "STATUS=two lines, ü"]


@pytest.mark.parametrize("address", ["", "relative", "/no/such/socket", "@nobody-listens-here"])
def test_where_nobody_listens_nothing_happens(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", address)
    assert not systemd.notify("READY=1")
    monkeypatch.delenv("NOTIFY_SOCKET")
    assert not systemd.notify("READY=1")


def test_a_manager_that_does_not_read_holds_nobody_up(manager: Manager) -> None:
    sent = 0
    while systemd.notify("WATCHDOG=1"):
        sent += 1
        assert sent < 100_000
    assert manager.drain() == sent


async def test_the_stream_watchdog_and_the_loop_feed_systemd(
    bench: StartBench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("zmav.services.authority.watchdog.ROUND", 0.05)
    manager = Manager(str(tmp_path / "notify"))
    monkeypatch.setenv("NOTIFY_SOCKET", manager.address)
    with manager.socket:
        b = await (await bench()).connected()
        watchdog = b.vehicle.authority.watchdog
        b.vehicle.bus.on(Alive, lambda told: systemd.notify("WATCHDOG=1"))
        assert await asyncio.to_thread(manager.told) == ["WATCHDOG=1"]

        # The loop hangs, and the watchdog goes round.
        manager.drain()
        rounds, give_up = watchdog.rounds, time.monotonic() + PATIENCE_S
        while watchdog.rounds < rounds + 10 and time.monotonic() < give_up:
            time.sleep(0.01)
        assert watchdog.rounds >= rounds + 10
        assert manager.drain() == 0
        assert await asyncio.to_thread(manager.told) == ["WATCHDOG=1"]

        # The watchdog hangs, and the loop goes round.
        with watchdog._changed:
            await turns(b, 3)
            manager.drain()  # what its last round was worth
            await turns(b, 10)
            assert manager.drain() == 0
        assert await asyncio.to_thread(manager.told) == ["WATCHDOG=1"]


async def turns(b: Bench, count: int) -> None:
    """So many rounds of the housekeeping, each of which says the state."""
    for _ in range(count):
        await b.state(lambda s: True, "state")


def test_zmav_up_says_when_it_is_ready_alive_and_ending(manager: Manager) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    up = Process(sys.executable, "-m", "zmav", "up", "--link", "tcp:127.0.0.1:9", "-l", endpoint)
    try:
        told = manager.until("READY=1")
        assert told[1] == f"STATUS=demo/quad1: tcp:127.0.0.1:9 on {endpoint}"
        for _ in range(3):
            manager.until("WATCHDOG=1")
        up.popen.terminate()
        manager.until("STOPPING=1")
        assert up.wait() == 0
    finally:
        up.popen.kill()
        up.wait()


def test_an_agent_says_when_it_is_ready_alive_and_ending(manager: Manager, net: Net, tmp_path: Path) -> None:
    path = tmp_path / "waiter.py"
    path.write_text(
        "import asyncio\nimport zmav\n\nclass Waiter(zmav.Agent):\n    name = 'waiter'\n\n"
        "    async def run(self):\n        await asyncio.Event().wait()\n"
    )
    _, endpoint = net.router()
    agent = Process(sys.executable, "-m", "zmav", "agent", "run", str(path), "--vehicle", "quad1", "-e", endpoint)
    try:
        assert manager.until("READY=1")[1] == "STATUS=quad1/waiter: runs"
        for _ in range(2):
            manager.until("WATCHDOG=1")
        agent.popen.terminate()
        manager.until("STOPPING=1")
        assert agent.wait() == 0
    finally:
        agent.popen.kill()
        agent.wait()


def test_the_journal_keeps_times_itself(tmp_path: Path) -> None:
    """Only where it is standard error that goes there: $JOURNAL_STREAM is inherited."""
    code = "import os; os.environ['JOURNAL_STREAM'] = {}; from zmav.process import log; log('up')"
    ours, others = "f'{os.fstat(2).st_dev}:{os.fstat(2).st_ino}'", "'1:1'"
    for stream, stamped in ((ours, False), (others, True)):
        process = Process(sys.executable, "-c", code.format(stream))
        assert process.wait() == 0
        assert len(process.err) == 1
        assert (process.err != ["up"]) is stamped, process.err
