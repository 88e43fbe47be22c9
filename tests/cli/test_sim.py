"""``zmav sim`` and ``zmav replay`` as processes."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import pytest

from tests.cli.conftest import Here
from zmav.cli.sim.talk import clock_words
from zmav.cli.sim.up import is_open
from zmav.mavlink import Splitter, decode, load_dialect
from zmav.mavlink.dialect import Dialect
from zmav.process import free_port
from zmav.sim import VehicleStatus, WorldStatus

if TYPE_CHECKING:
    from tests.cli.conftest import StartProcess
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
    urls = [sim.expect(f"quad{i} (system id {i}): ").rpartition(" ")[2] for i in (1, 2)]
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


def test_sim_up_brings_any_mix_into_the_key_space(
    start: StartProcess, here: type[Here], monkeypatch: pytest.MonkeyPatch
) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    monkeypatch.setenv("ZMAV_CONNECT", endpoint)
    sim = start("sim", "--copters", "1", "--rovers", "1", "--planes", "1", "--up", "--endpoint", "tcp:0")
    assert endpoint in sim.expect("beside each starts 'zmav up'")
    sim.expect("look: zmav ls, zmav top, zmav echo quad1, zmav http")
    expected = [("plane1", "plane", 3), ("quad1", "copter", 1), ("rover1", "rover", 2)]
    deadline = time.monotonic() + PATIENCE_S
    rows: list[dict[str, Any]] = []
    while not (len(rows) == 3 and all(row["local"] for row in rows)):
        assert time.monotonic() < deadline, rows
        rows = here()("ls", "--json", "--wait", "1").lines if is_open(endpoint) else []
    assert [(row["name"], row["kind"], row["sysid"]) for row in rows] == expected
    joined = start("sim", "--up", "--endpoint", "tcp:0")  # its quad1 is another one: a clash, which is said elsewhere
    assert endpoint in joined.expect("which was there")
    assert joined.stop(signal.SIGINT) == 0
    children = subprocess.run(["pgrep", "-P", str(sim.popen.pid)], capture_output=True, text=True).stdout.split()
    assert len(children) == 4  # three and the router
    os.kill(int(children[-1]), signal.SIGKILL)
    assert sim.wait() == 1
    assert "but should run to the end" in sim.stderr
    assert not [pid for pid in children if Path(f"/proc/{pid}/cmdline").exists()]


# ---- words to a running simulator


@pytest.fixture
def sim(start: StartProcess, tmp_path: Path) -> Sim:
    """A simulator of two copters and a PX4, with a control socket of its own."""
    return Sim(start, tmp_path / "one.sock", "--copters", "2", "--px4", "1")


class Sim:
    """A simulator's process, and the verbs that talk to it."""

    def __init__(self, start: StartProcess, control: Path, *arguments: str) -> None:
        self.control = control
        self.process = start("sim", *arguments, "--endpoint", "tcp:0", "--control", str(control))
        self.process.expect("(system id ")
        self.zmav = Here("--control", str(control))

    def status(self) -> dict[str, Any]:
        (line,) = self.zmav("sim", "status", "--json").lines
        return line


def test_the_clock_is_told_from_outside(sim: Sim) -> None:
    assert re.fullmatch(r"\d+\.\d s simulated, paused\n", sim.zmav("sim", "pause").out)
    before = sim.status()
    assert before["paused"]
    sim.zmav("sim", "step", "2.5")
    after = sim.status()
    assert after["time_s"] == pytest.approx(before["time_s"] + 2.5)
    assert "(max)" in sim.zmav("sim", "speed", "max").out + sim.zmav("sim", "resume").out
    assert sim.status()["speed"] is None
    sim.zmav("sim", "speed", "3")
    assert sim.status()["speed"] == 3.0
    assert not sim.status()["paused"]
    sim.zmav("sim", "stop")
    assert sim.process.wait() == 0
    assert not sim.control.exists()


def test_the_status_is_a_table_and_json(sim: Sim) -> None:
    vehicles = sim.status()["vehicles"]
    assert [(v["name"], v["sysid"], v["kind"], v["autopilot"]) for v in vehicles] == [
        ("quad1", 1, "copter", "arducopter"),
        ("quad2", 2, "copter", "arducopter"),
        ("px4-1", 3, "px4", "px4"),
    ]
    table = sim.zmav("sim", "status").out
    assert all(v["name"] in table and v["url"] in table and v["mode"] in table for v in vehicles)
    assert "s simulated at ×" in table.splitlines()[-1]


def test_two_simulators_are_told_apart(sim: Sim, start: StartProcess, tmp_path: Path) -> None:
    other = Sim(start, tmp_path / "two.sock", "--rovers", "1")
    assert [v["kind"] for v in other.status()["vehicles"]] == ["rover"]
    assert len(sim.status()["vehicles"]) == 3
    third = start("sim", "--endpoint", "tcp:0", "--control", str(sim.control))
    assert third.wait() == 1
    assert f"another simulator has the control socket {sim.control}" in third.stderr
    sim.process.popen.kill()
    sim.process.wait()
    assert "no simulator listens" in str(Here("--control", str(sim.control)).fails("sim", "status").error)
    again = Sim(start, sim.control)  # what the killed one left is no hindrance
    assert len(again.status()["vehicles"]) == 1
    assert again.process.stop(2) == 0
    assert not sim.control.exists()


def test_words_that_make_no_sense(sim: Sim, here: type[Here]) -> None:
    assert "expected a number" in str(sim.zmav.fails("sim", "speed", "fast").error)
    assert "expected 0.01 to" in str(sim.zmav.fails("sim", "step", "0").error)
    for words in (("sim", "dance"), ("sim", "--speed", "3", "pause"), ("sim", "--copters", "251")):
        here().misused(*words)
    assert sim.status()["vehicles"]


def test_what_is_asked_of_a_world_is_checked_first(here: type[Here], tmp_path: Path) -> None:
    file = tmp_path / "fleet.toml"
    file.write_text('[vehicles.q]\nlink = "tcp:127.0.0.1:5760"\nsim = { airfraem = "hexa" }\n')
    for words, expected in (
        (("--home", "47,8"), "expected LAT,LON,AMSL,HEADING"),
        (("--wind", "strong"), "expected SPEED"),
        (("--speed", "fast"), "expected a number"),
        (("--fleet", str(file)), f"{file}: Object contains unknown field `airfraem` (at vehicles.q.sim)"),
        (("--fleet", str(tmp_path / "none.toml")), "none.toml"),
    ):
        assert expected in str(here().fails("sim", *words).error)


def test_one_file_starts_the_simulator_and_says_where_agents_find_it(start: StartProcess, tmp_path: Path) -> None:
    file = tmp_path / "fleet.toml"
    file.write_text(
        f"""
        [sim]
        speed = 5
        [vehicles.quad1]
        link = "{tmp_path}/tty,57600"
        sysid = 7
        sim = {{ airframe = "hexa" }}
        [vehicles.real]
        link = "/dev/ttyACM0"
        """
    )
    control = str(tmp_path / "s")
    sim = start("sim", "--fleet", str(file), "--px4", "1", "--endpoint", "tcp:0", "--control", control)
    assert sim.expect("quad1 (system id 7): ").endswith(f"{tmp_path}/tty,115200")
    sim.expect("px4-1 (system id 2): tcp:127.0.0.1:")
    (status,) = Here("--control", control)("sim", "status", "--json").lines
    assert [(v["name"], v["airframe"]) for v in status["vehicles"]] == [("quad1", "hexa"), ("px4-1", "sih")]
    assert status["speed"] == 5.0
    assert sim.stop() == 0
    assert {path.name for path in tmp_path.iterdir()} == {"fleet.toml"}


def test_its_home_is_told(start: StartProcess, tmp_path: Path) -> None:
    sim = Sim(start, tmp_path / "one.sock", "--home", "47.4,8.5,488,-90", "--planes", "1")
    (plane,) = sim.status()["vehicles"]
    assert plane["heading_deg"] == pytest.approx(270.0, abs=1.0)


def listens(control: Path) -> bool:
    with socket.socket(socket.AF_UNIX) as caller:
        return caller.connect_ex(str(control)) == 0


def test_it_flies_on_when_nobody_reads_what_it_says(tmp_path: Path) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    control = tmp_path / "one.sock"
    command = (sys.executable, "-m", "zmav", "sim", "--endpoint", "tcp:0", "--control", str(control))
    with subprocess.Popen(command, stdout=writer, stderr=subprocess.PIPE, text=True) as sim:
        os.close(writer)
        try:
            while not listens(control):
                assert sim.poll() is None
            assert Here("--control", str(control))("sim", "status", "--json").lines
        finally:
            sim.send_signal(signal.SIGTERM)
        _, said = sim.communicate(timeout=PATIENCE_S)
        assert (sim.returncode, said) == (0, "")


# ---- the clock in words


def test_the_clock_in_words(make_status: Callable[..., WorldStatus]) -> None:
    assert clock_words(make_status()) == "61 s simulated at ×3.9, BEHIND the ×4 asked for"
    assert "in lock step" in clock_words(make_status(lockstep=True))
    assert clock_words(make_status(paused=True)) == "61.0 s simulated, paused"
    assert clock_words(make_status(speed=None, behind=False)) == "61 s simulated at ×3.9 (max)"
    assert clock_words(make_status(speed=None, speed_reached=0.0, behind=False)) == "61 s simulated (max)"


@pytest.fixture
def make_status() -> Callable[..., WorldStatus]:
    def make(**changes: Any) -> WorldStatus:
        usual = VehicleStatus(
            name="quad1",
            sysid=1,
            kind="copter",
            autopilot="arducopter",
            airframe="quad",
            url="",
            mode="GUIDED",
            armed=True,
            landed=False,
            ready=True,
            ned_m=(0.0, 0.0, 0.0),
            height_m=0.0,
            speed_mps=0.0,
            heading_deg=0.0,
            battery_pct=100,
            links=1,
        )
        replace = msgspec.structs.replace
        world = WorldStatus(
            time_s=61.0,
            speed=4.0,
            speed_reached=3.9,
            behind=True,
            vehicles=(
                usual,
                replace(usual, name="quad2", landed=True, faults=("gps-loss",)),
                replace(usual, name="ugv", kind="rover", mode="HOLD", armed=False, failed="a defect"),
            ),
        )
        return replace(world, **changes)

    return make


# ---- recordings


def test_replay_plays_a_recording_to_its_end(start: StartProcess, net: Net, shared_data: Path) -> None:
    _, endpoint = net.router()
    replay = start("replay", str(shared_data / "rover.tlog"), "--speed", "max", "--name", "old1", "-e", endpoint)
    assert replay.wait() == 0
    assert "as demo-replay/old1" in replay.err[0]
    assert re.match(r"\d{3,} frames \(0 unknown, 0 lost\) in \d+\.\d s", replay.err[-1])


def test_replay_is_a_vehicle_and_ends_cleanly(
    start: StartProcess, net: Net, here: type[Here], shared_data: Path
) -> None:
    session, endpoint = net.router()
    verb = here("--fleet", "demo-replay", "-e", endpoint)
    replay = start("replay", str(shared_data / "px4.tlog"), "--speed", "5", "--loop", "--name", "old1", "-e", endpoint)
    replay.expect("replaying ")
    (line,) = verb("echo", "old1/ATTITUDE", "-n", "1", "--json").lines
    assert line["key"] == "zmav/demo-replay/old1/mav/rx/1/1/ATTITUDE"
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
