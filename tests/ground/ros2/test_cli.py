"""``zmav ros2`` as a person has it."""

from __future__ import annotations

import asyncio
import signal
import socket
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import zenoh
from click.testing import CliRunner

from ground.ros2.cli import command
from ground.ros2.graph import SPACE
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


def test_looks_at_the_fleet_that_have_ended_end_it_with_their_error(net: Net, monkeypatch: pytest.MonkeyPatch) -> None:
    """Or ROS would show nobody, and nobody would learn why."""

    get = zenoh.Liveliness.get

    def fail(self: zenoh.Liveliness, key: Any, *args: Any, **more: Any) -> Any:
        if str(key).startswith(SPACE):
            raise zenoh.ZError("no looks any more")
        return get(self, key, *args, **more)

    _, endpoint = net.router()
    monkeypatch.setattr(zenoh.Liveliness, "get", fail)
    result = CliRunner().invoke(command, ["-e", endpoint])
    assert isinstance(result.exception, zenoh.ZError)
    assert "no looks any more" in str(result.exception)


def test_all_fleets_at_once_are_refused(net: Net) -> None:
    _, endpoint = net.router()
    result = CliRunner().invoke(command, ["--fleet", "*", "-e", endpoint])
    assert isinstance(result.exception, BadConfig)
    assert "name one fleet" in str(result.exception)


FILE = """
fleet = "alpha"
[ros2]
domain = 5
beside = ["quad1"]
orders = true
rates = { "imu/data" = 50.0 }
[vehicles.quad1]
link = "tcp:127.0.0.1:1"
[vehicles.quad2]
link = "tcp:127.0.0.1:2"
"""


@pytest.fixture
def file(tmp_path: Path) -> str:
    (path := tmp_path / "fleet.toml").write_text(FILE)
    return str(path)


async def first_lines(count: int, *args: str) -> list[str]:
    """What it says on standard error; then it is told to end, and ends well."""
    command = (sys.executable, "-m", "zmav", "ros2", *args)
    program = await asyncio.create_subprocess_exec(*command, stderr=asyncio.subprocess.PIPE)
    assert program.stderr is not None
    said = [(await within(PATIENCE_S, program.stderr.readline())).decode() for _ in range(count)]
    program.send_signal(signal.SIGTERM)
    assert await within(PATIENCE_S, program.wait()) == 0
    return said


async def test_the_fleet_file_says_what_runs_beside_a_vehicle(net: Net, file: str) -> None:
    _, endpoint = net.router()
    (said,) = await first_lines(1, "-e", endpoint, "--file", file, "--beside", "quad1")
    assert "alpha/quad1 in ROS domain 5, with orders from any node of ROS" in said


async def test_a_domain_that_differs_from_the_fleet_files_is_said(net: Net, file: str) -> None:
    """Of the whole fleet, started by hand, orders are asked for by hand."""
    _, endpoint = net.router()
    differs, said = await first_lines(2, "-e", endpoint, "--file", file, "--domain", "7")
    assert "domain 7" in differs
    assert "has 5, and routers with credentials let no other through" in differs
    assert "fleet alpha in ROS domain 7, read-only" in said


def test_beside_needs_a_file_and_a_vehicle(file: str) -> None:
    result = CliRunner().invoke(command, ["--beside", "quad1"])
    assert isinstance(result.exception, BadConfig)
    assert "--beside needs --file" in str(result.exception)
    result = CliRunner().invoke(command, ["--file", file, "--beside"])
    assert isinstance(result.exception, BadConfig)
    assert "give --beside VEHICLE: no vehicle's service is installed here" in str(result.exception)


def test_where_nobody_asks_for_it_its_unit_ends_in_good_order(file: str, tmp_path: Path) -> None:
    """systemd.service(5): one of Type=notify that ends before it says so has failed, and would be started again."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as told:
        told.bind(str(tmp_path / "notify"))
        told.settimeout(PATIENCE_S)
        where = {"NOTIFY_SOCKET": str(tmp_path / "notify")}
        result = CliRunner().invoke(command, ["--file", file, "--beside", "quad2"], env=where)
        assert result.exit_code == 0
        assert "beside quad2 ([ros2] beside): there is nothing to do" in result.output
        assert told.recv(1000).startswith(b"READY=1\n")


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ('beside = ["quad1"]', 'beside = ["quad9"]', "quad9"),
        ("domain = 5\n", "", "ros2.domain"),
        ("domain = 5", "domain = 500", "ros2.domain"),
    ],
)
def test_a_file_that_cannot_be_is_refused(file: str, before: str, after: str, words: str) -> None:
    text = Path(file).read_text()
    assert before in text
    Path(file).write_text(text.replace(before, after))
    result = CliRunner().invoke(command, ["--file", file])
    assert isinstance(result.exception, BadConfig)
    assert words in str(result.exception)


def test_a_rate_in_the_file_that_cannot_be_is_refused(file: str) -> None:
    Path(file).write_text(FILE.replace("imu/data", "imu/dat"))
    result = CliRunner().invoke(command, ["--file", file, "--beside", "quad1"])
    assert isinstance(result.exception, BadConfig)
    assert "did you mean imu/data" in str(result.exception)
