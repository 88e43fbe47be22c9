"""``zmav gcs`` as a person has it."""

from __future__ import annotations

import asyncio
import contextlib
import resource
import signal
import socket
import sys
from collections.abc import AsyncIterator
from typing import TYPE_CHECKING

import pytest
from click.testing import CliRunner

import zmav
from ground.gcs.bridge import BridgeSettings
from ground.gcs.cli import allowed, command
from ground.gcs.options import Options, parse_endpoint
from tests.ground.gcs.conftest import Scene, Station
from tests.trust.conftest import Authority, authority  # noqa: F401  (a fixture)
from zmav.errors import BadConfig, PortInUse, ZmavError
from zmav.process import free_port
from zmav.waiting import within

if TYPE_CHECKING:
    from tests.conftest import Net

PATIENCE_S = 60.0


class Bridge:
    """``zmav gcs`` with a ``--tcp`` port; ``said`` is what it wrote so far."""

    def __init__(self, program: asyncio.subprocess.Process, port: int) -> None:
        self.program, self.port, self.said = program, port, ""

    async def until(self, words: str) -> None:
        while words not in self.said:
            assert self.program.stderr is not None
            line = (await within(PATIENCE_S, self.program.stderr.readline())).decode()
            assert line, self.said
            self.said += line

    async def station(self) -> Station:
        return Station(await asyncio.to_thread(socket.create_connection, ("127.0.0.1", self.port)))


@contextlib.asynccontextmanager
async def bridge(scene: Scene) -> AsyncIterator[Bridge]:
    port = free_port()
    arguments = ("-m", "zmav", "gcs", "-e", scene.router_endpoint, "--tcp", f"{port}?rate=50kB/s")
    program = await asyncio.create_subprocess_exec(sys.executable, *arguments, stderr=asyncio.subprocess.PIPE)
    try:
        yield Bridge(program, port)
    finally:
        if program.returncode is None:
            program.kill()
            await program.wait()


async def test_it_says_what_it_does_and_ends_when_told_to(scene: Scene) -> None:
    one = scene.craft("quad1", 1)
    async with bridge(scene) as gcs:
        await gcs.until(f"tcp: waiting for stations at 127.0.0.1:{gcs.port} (50000 B/s)")
        one.publish_state()
        await gcs.until("quad1 is there: system 1, copter, ardupilot")
        station = await gcs.station()
        station.beat()
        await gcs.until("is 255/190 (GCS)")
        await station.gets(one.says("ATTITUDE"))
        station.close()
        await gcs.until("is gone: closed the connection")
        gcs.program.send_signal(signal.SIGTERM)
        assert await within(PATIENCE_S, gcs.program.wait()) == 0


async def test_where_it_has_no_descriptor_left_it_says_so_once_and_lets_stations_in_again(scene: Scene) -> None:
    """Whoever is there is served meanwhile."""
    one = scene.craft("quad1", 1)
    async with bridge(scene) as gcs:
        await gcs.until("tcp: waiting for stations")
        one.publish_state()
        await gcs.until("quad1 is there")
        first = await gcs.station()
        first.beat()
        await gcs.until("is 255/190 (GCS)")
        pid = gcs.program.pid
        soft, hard = resource.prlimit(pid, resource.RLIMIT_NOFILE)
        resource.prlimit(pid, resource.RLIMIT_NOFILE, (3, hard))  # below all that may be free, now and later
        second = await gcs.station()
        await gcs.until("tcp: no station can be let in: Too many open files")
        await first.gets(one.says("ATTITUDE"))
        resource.prlimit(pid, resource.RLIMIT_NOFILE, (soft, hard))
        second.beat()
        await gcs.until(f"{second.sock.getsockname()[1]} is 255/190 (GCS)")
        await second.gets(one.says("ATTITUDE"))
        assert gcs.said.count("no station can be let in") == 1
        first.close()
        second.close()


@pytest.mark.parametrize("role", ["viewer", "planner", "operator"])
async def test_credentials_that_may_not_send_make_it_read_only(scene: Scene, authority: Authority, role: str) -> None:  # noqa: F811
    folder = authority.issue("alice", role)
    endpoint = parse_endpoint("tcp", "0", Options(rate=500.0))
    async with zmav.open(connect=[scene.router_endpoint], credentials=str(folder)) as z:
        (options,) = (each.options for each in allowed(z, BridgeSettings(endpoints=(endpoint,))).endpoints)
    assert options == Options(rate=500.0, read_only=role != "operator")


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (["--tcp", "x"], BadConfig),
        (["--rate", "fast"], BadConfig),
        (["--vehicles", ""], BadConfig),
        (["--tcp", "5760", "-e", "tcp/127.0.0.1:1"], ZmavError),
    ],
)
def test_bad_options_end_it_in_a_typed_error(arguments: list[str], error: type[Exception]) -> None:
    result = CliRunner().invoke(command, arguments)
    assert isinstance(result.exception, error)


def test_a_port_that_is_taken_ends_it(net: Net) -> None:
    _, endpoint = net.router()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        result = CliRunner().invoke(command, ["--udpin", str(taken.getsockname()[1]), "-e", endpoint])
    assert isinstance(result.exception, PortInUse) and "is held by another program" in str(result.exception)
