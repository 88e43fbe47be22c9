"""``zmav ros2`` as a person has it."""

from __future__ import annotations

import asyncio
import signal
import sys
from typing import TYPE_CHECKING

import pytest
from click.testing import CliRunner

from ground.ros2.cli import command
from zmav.errors import BadConfig, SessionError
from zmav.waiting import within

if TYPE_CHECKING:
    from tests.conftest import Net

PATIENCE_S = 60.0


async def test_it_says_what_it_does_and_ends_when_told_to(net: Net) -> None:
    _, endpoint = net.router()
    args = ("-m", "zmav", "ros2", "-e", endpoint, "--domain", "7")
    program = await asyncio.create_subprocess_exec(sys.executable, *args, stderr=asyncio.subprocess.PIPE)
    assert program.stderr is not None
    said = (await within(PATIENCE_S, program.stderr.readline())).decode()
    assert "fleet demo in ROS domain 7" in said
    program.send_signal(signal.SIGTERM)
    assert await within(PATIENCE_S, program.wait()) == 0


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["--rate", "imu/dat=5"], "did you mean imu/data"),
        (["--rate", "imu/data"], "expected TOPIC=HZ"),
        (["--rate", "imu/data=nan"], "above 0"),
        (["--rate", "imu/data=9999"], "at most 500"),
    ],
)
def test_a_rate_that_cannot_be_is_refused(args: list[str], words: str) -> None:
    result = CliRunner().invoke(command, args)
    assert isinstance(result.exception, BadConfig)
    assert words in str(result.exception)


def test_a_domain_that_cannot_be_is_refused() -> None:
    assert "0<=x<=232" in CliRunner().invoke(command, ["--domain", "233"]).output


def test_no_router_is_said() -> None:
    result = CliRunner().invoke(command, ["-e", "tcp/127.0.0.1:1"])
    assert isinstance(result.exception, SessionError)


def test_all_fleets_at_once_are_refused(net: Net) -> None:
    _, endpoint = net.router()
    result = CliRunner().invoke(command, ["--fleet", "*", "-e", endpoint])
    assert isinstance(result.exception, BadConfig)
    assert "name one fleet" in str(result.exception)
