"""``zmav gcs`` as a person has it."""

from __future__ import annotations

import asyncio
import signal
import socket
import sys
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


async def test_it_says_what_it_does_and_ends_when_told_to(scene: Scene) -> None:
    one = scene.craft("quad1", 1)
    port = free_port()
    program = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "zmav",
        "gcs",
        "-e",
        scene.router_endpoint,
        "--tcp",
        f"{port}?rate=50kB/s",
        stderr=asyncio.subprocess.PIPE,
    )
    try:
        assert program.stderr is not None
        said = ""

        async def until(words: str) -> None:
            nonlocal said
            while words not in said:
                assert program.stderr is not None
                line = (await within(PATIENCE_S, program.stderr.readline())).decode()
                assert line, said
                said += line

        await until(f"tcp: waiting for stations at 127.0.0.1:{port} (50000 B/s)")
        one.publish_state()
        await until("quad1 is there: system 1, copter, ardupilot")
        station = Station(await asyncio.to_thread(socket.create_connection, ("127.0.0.1", port)))
        station.beat()
        await until("is 255/190 (GCS)")
        await station.gets(one.says("ATTITUDE"))
        station.close()
        await until("is gone: closed the connection")
        program.send_signal(signal.SIGTERM)
        assert await within(PATIENCE_S, program.wait()) == 0
    finally:
        if program.returncode is None:
            program.kill()
            await program.wait()


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
