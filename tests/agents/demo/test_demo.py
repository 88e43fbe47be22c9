"""``zmav demo`` as the process it is: it flies, says how it went, and leaves nobody behind."""

from __future__ import annotations

import json
import math
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.ports import free_udp_ports
from zmav.children import Children
from zmav.errors import ZmavError
from zmav.process import free_port

PATIENCE_S = 60.0
Demo = subprocess.Popen[str]
ALONE = """
[origin]
lat_deg = -35.363261
lon_deg = 149.165230
alt_amsl = 584.09
[vehicles.quad1]
link = "tcp:127.0.0.1:5760"
[vehicles.quad1.sim]
[demo]
title = "one that stands"
[[demo.steps]]
pause = 600.0
[[demo.steps]]
start = "zmav swarm planner --interpret"
"""
"""a fleet that starts in a third of the time that the usual one takes"""


@pytest.fixture
def start_demo() -> Iterator[Callable[..., Demo]]:
    """Start it without a terminal; it and all it started are gone at the test's end."""
    started: list[Demo] = []

    def start(*arguments: str) -> Demo:
        started.append(
            subprocess.Popen(
                [sys.executable, "-m", "zmav", "demo", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                start_new_session=True,
                env={**os.environ, "ZMAV_CREDENTIALS": "/of/another/fleet"},
            )
        )
        return started[-1]

    yield start
    for demo in started:
        if demo.poll() is None:
            os.killpg(demo.pid, signal.SIGKILL)
        demo.communicate()


@pytest.fixture
def alone(tmp_path: Path) -> str:
    """Where the fleet of one is."""
    path = tmp_path / "alone.toml"
    path.write_text(ALONE)
    return str(path)


def children(demo: Demo) -> dict[str, int]:
    """The processes it started, by their verb, or by their vehicle's name; this needs /proc."""
    task = Path(f"/proc/{demo.pid}/task/{demo.pid}/children")
    if not task.exists():
        pytest.skip("this system does not tell a process's children")
    found = {}
    for pid in map(int, task.read_text().split()):
        words = Path(f"/proc/{pid}/cmdline").read_text().split("\0")
        if "zmav" in words:
            verb = words[words.index("zmav") + 1]
            found[words[words.index("--name") + 1] if verb == "up" else verb] = pid
    return found


def wait_for_children(demo: Demo, *names: str) -> dict[str, int]:
    end = time.monotonic() + PATIENCE_S
    while not set(names) <= (found := children(demo)).keys():
        assert demo.poll() is None, "it ended too soon"
        assert time.monotonic() < end, f"only {sorted(found)} were started"
        time.sleep(0.05)
    return found


def alive(pids: dict[str, int]) -> set[str]:
    return {name for name, pid in pids.items() if Path(f"/proc/{pid}").exists()}


EVERYONE = ("quad1", "quad2", "quad3", "router", "sim", "swarm", "record")


@pytest.mark.slow
def test_three_vehicles_change_places_and_nobody_is_left(start_demo: Callable[..., Demo], tmp_path: Path) -> None:
    demo = start_demo("--out", str(tmp_path))
    pids = wait_for_children(demo, *EVERYONE)
    out, _ = demo.communicate(timeout=115.0)
    assert demo.returncode == 0, out
    told = json.loads((tmp_path / "summary.json").read_text())
    assert (told["good"], told["fault"]) == (True, None)
    assert [(row["vehicle"], row["relays"]) for row in told["vehicles"]] == [("quad1", 0), ("quad2", 1), ("quad3", 2)]
    for row in told["vehicles"]:
        assert row["flown_m"] > 20.0
        assert row["setpoints"] >= 3  # segments, some seconds each, and no stream
        assert row["dropped"] == {}
        assert row["mavlink_lost"] <= 0.02 * row["mavlink_frames"]
        assert row["rtt_s"] > 0.0
        assert row["end"] == "disarmed in LAND"
    assert told["closest"]["m"] > 1.5
    assert 0.1 < told["pace"] < 1.2
    assert told["pace"] != 1.0, "nothing was measured"
    assert told["marks"][0]["text"] == "ready"
    for place, goal in zip(told["tracks"][-1][1], ((0.0, 15.0), (0.0, 30.0), (0.0, 0.0)), strict=True):
        assert math.dist(place[:2], goal) < 1.0  # landed below where it was sent
    assert (tmp_path / "tracks.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(path.name for path in tmp_path.glob("recording/*/*")) == [
        "quad1.001.tlog",
        "quad2.001.tlog",
        "quad3.001.tlog",
        "record.001.mcap",
    ]
    assert "all of it was flown" in out
    assert "Traceback" not in out
    assert alive(pids) == set()


@pytest.mark.parametrize(("name", "fleet"), [("sim", 1), ("quad2", 3)], ids=["simulator killed", "relay killed"])
def test_a_process_that_dies_ends_it_with_words(
    start_demo: Callable[..., Demo], alone: str, tmp_path: Path, name: str, fleet: int
) -> None:
    demo = start_demo(*([alone] if fleet == 1 else []), "--out", str(tmp_path))
    pids = wait_for_children(demo, *(("quad1", "router", "sim", "record") if fleet == 1 else EVERYONE))
    os.kill(pids[name], signal.SIGKILL)
    out, _ = demo.communicate(timeout=PATIENCE_S)
    assert demo.returncode == 1, out
    assert f"FAILED: {name} ended with -9, but should run to the end; it said last:" in out
    assert "Traceback" not in out
    assert alive(pids) == set()


@pytest.mark.parametrize(("number", "code", "stay"), [(signal.SIGTERM, 143, False), (signal.SIGINT, 130, True)])
def test_it_can_be_ended_at_any_time(
    start_demo: Callable[..., Demo], alone: str, tmp_path: Path, number: int, code: int, stay: bool
) -> None:
    more = ["--stay", "--endpoint", f"tcp/127.0.0.1:{free_port()}"] if stay else ["--out", str(tmp_path)]
    demo = start_demo(alone, *more)
    pids = wait_for_children(demo, "quad1", "sim", "router", *(("swarm",) if stay else ()))
    demo.send_signal(number)
    out, _ = demo.communicate(timeout=PATIENCE_S)
    assert demo.returncode == code, out
    assert ("swarm" in pids) == stay
    assert "Traceback" not in out
    assert alive(pids) == set()


def test_a_port_in_use_ends_it_with_words(start_demo: Callable[..., Demo], alone: str, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        demo = start_demo(alone, "--endpoint", f"tcp/127.0.0.1:{taken.getsockname()[1]}", "--out", str(tmp_path))
        out, _ = demo.communicate(timeout=PATIENCE_S)
    assert demo.returncode == 1
    assert "FAILED: ground ended with 1" in out
    assert "is in use by another program" in out


def test_an_endpoint_that_is_none_ends_it_with_words(
    start_demo: Callable[..., Demo], alone: str, tmp_path: Path
) -> None:
    demo = start_demo(alone, "--endpoint", "here", "--out", str(tmp_path))
    out, _ = demo.communicate(timeout=PATIENCE_S)
    assert demo.returncode == 1
    assert "<protocol>/<address>" in out
    assert "Traceback" not in out


# Its processes.


def test_processes_are_watched_and_all_are_ended() -> None:
    with Children() as processes:
        router = processes.start("router", "router", "-l", "tcp/127.0.0.1:0")
        help_ = processes.start("help", "--help", may_end=True)
        assert help_.wait(PATIENCE_S) == 0
        assert "Usage: " in processes.said("help", 100)
        processes.check()
        wrong = processes.start("wrong", "no-such-verb")
        assert wrong.wait(PATIENCE_S) == 2
        with pytest.raises(ZmavError, match=r"wrong ended with 2.*\n(.*\n)*.*No such command"):
            processes.check()
    with Children() as processes:
        good = processes.start("good", "--help")  # an end with 0 is no less an end
        assert good.wait(PATIENCE_S) == 0
        with pytest.raises(ZmavError, match="good ended with 0, but should run to the end"):
            processes.check()
    assert router.poll() is not None


def test_a_sigterm_ends_what_was_started_and_is_then_what_it_was() -> None:
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(SystemExit) as caught, Children(at_once=True, by_signals=True) as processes:
        router = processes.start("router", "router", "-l", "tcp/127.0.0.1:0")
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(PATIENCE_S)
    assert caught.value.code == 143
    assert router.poll() is not None
    assert signal.getsignal(signal.SIGTERM) is before


def test_free_ports_are_free() -> None:
    with socket.create_server(("127.0.0.1", free_port())):
        pass
    first = free_udp_ports(3)
    for port in range(first, first + 3):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
            s.bind(("127.0.0.1", port))
