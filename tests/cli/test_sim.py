"""``zmav sim`` and ``zmav replay`` as processes."""

from __future__ import annotations

import re
import socket
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from zmav.mavlink import Splitter, decode, load_dialect
from zmav.mavlink.dialect import Dialect

if TYPE_CHECKING:
    from tests.cli.conftest import Here, StartProcess
    from tests.conftest import Net

PATIENCE_S = 30.0


def sysids_heard(url: str, dialect: Dialect) -> set[int]:
    """The system ids of the first heartbeats on a link."""
    splitter = Splitter(dialect)
    found: set[int] = set()
    with socket.create_connection(("127.0.0.1", int(url.rpartition(":")[2])), PATIENCE_S) as link:
        while not found:
            for frame in splitter.feed(link.recv(4096)):
                if frame.msgid == 0 and decode(frame, dialect)["autopilot"] == 3:
                    found.add(frame.sysid)
    return found


def test_sim_says_where_each_vehicle_is_and_ends_cleanly(start: StartProcess) -> None:
    sim = start("sim", "--copters", "2", "--endpoint", "tcp:0", "--speed", "4", "--wind", "1@180,gusty")
    urls = [sim.expect(f"copter{i} (system id {i}): ").rpartition(" ")[2] for i in (1, 2)]
    assert all(re.fullmatch(r"tcp:127\.0\.0\.1:\d+", url) for url in urls)
    dialect = load_dialect()
    assert [sysids_heard(url, dialect) for url in urls] == [{1}, {2}]
    assert sim.stop() == 0
    assert sim.stderr == ""


def test_sim_sends_to_an_address(start: StartProcess) -> None:
    splitter = Splitter(load_dialect())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
        ground.bind(("127.0.0.1", 0))
        ground.settimeout(PATIENCE_S)
        sim = start("sim", "--endpoint", f"udp:127.0.0.1:{ground.getsockname()[1]}")
        (frame,) = splitter.feed(ground.recv(2000))
        assert sim.stop(2) == 0
    assert (frame.sysid, frame.compid) == (1, 1)


def test_sim_says_what_cannot_be(start: StartProcess, here: type[Here]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        number = taken.getsockname()[1]
        sim = start("sim", "--endpoint", f"tcp:{number}")
        assert sim.wait() == 1
        assert f"127.0.0.1:{number} is in use by another program" in sim.stderr
    assert "expected ardupilot, tcp, tcp:[HOST:]PORT" in str(here().fails("sim", "--endpoint", "serial:0").error)


def test_replay_plays_a_recording_to_its_end(start: StartProcess, net: Net, shared_data: Path) -> None:
    _, endpoint = net.router()
    replay = start("replay", str(shared_data / "rover.tlog"), "--speed", "max", "--name", "old1", "-e", endpoint)
    assert replay.wait() == 0
    assert "as demo/old1" in replay.err[0]
    assert re.match(r"\d{3,} frames \(0 unknown, 0 lost\) in \d+\.\d s", replay.err[-1])


def test_replay_is_a_vehicle_and_ends_cleanly(
    start: StartProcess, net: Net, here: type[Here], shared_data: Path
) -> None:
    session, endpoint = net.router()
    verb = here("-e", endpoint)
    replay = start("replay", str(shared_data / "px4.tlog"), "--speed", "5", "--loop", "--name", "old1", "-e", endpoint)
    replay.expect("replaying ")
    (line,) = verb("echo", "old1/ATTITUDE", "-n", "1", "--json").lines
    assert line["key"] == "zmav/demo/old1/mav/rx/1/1/ATTITUDE"
    (row,) = verb("ls", "--json").lines
    assert (row["name"], row["autopilot"], row["kind"]) == ("old1", "px4", "copter")
    assert replay.stop() == 0
    assert "frames (" in replay.stderr
    assert list(session.liveliness().get("zmav/**", timeout=1.0)) == []


@pytest.mark.parametrize("arguments", [["--speed", "fast"], ["--name", "Old One"], ["--fleet", "a b"]])
def test_replay_says_what_cannot_be(net: Net, here: type[Here], shared_data: Path, arguments: list[str]) -> None:
    _, endpoint = net.router()
    told = here("-e", endpoint).fails("replay", str(shared_data / "rover.tlog"), *arguments)
    assert arguments[1] in str(told.error)
