"""However a lab ends, nothing of it is left: no process, no namespace, no interface, no file."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from mesh.lab.remote import Remote
from zmav import rundir

pytestmark = [pytest.mark.root, pytest.mark.usefixtures("able")]

PATIENCE_S = 30.0
FILE = """
name = "tiny"
[hosts.h1]
program = "none"
[hosts.h2]
[[media]]
kind = "link"
between = ["h1", "h2"]
"""


@dataclass
class Running:
    """A lab in a process of its own, and what it made."""

    process: subprocess.Popen[str]
    directory: Path
    relay: int
    networks: set[str]
    sockets: Path
    """of its hosts' programs"""

    def left(self) -> list[str]:
        """What is still there."""
        found = [f"process {pid}" for pid, network in networks_of_processes() if network in self.networks]
        if Path(f"/proc/{self.relay}").exists():
            found.append("the relay")
        if self.directory.exists():
            found.append(f"files: {sorted(self.directory.iterdir())}")
        if self.sockets.exists():
            found.append(f"files: {self.sockets}")
        return found

    def gone(self) -> None:
        """Wait until nothing is left."""
        end = time.monotonic() + PATIENCE_S
        while left := self.left():
            assert time.monotonic() < end, left
            time.sleep(0.02)


Begin = Callable[..., Running]


def networks_of_processes() -> Iterator[tuple[str, str]]:
    """Every process with its network namespace."""
    for path in Path("/proc").glob("[0-9]*/ns/net"):
        with contextlib.suppress(OSError):
            yield path.parts[2], str(path.readlink())


@pytest.fixture
def begin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Begin]:
    """Start ``zmav lab up``; it is up when this returns. ``--bare``: what is not about the router does without."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    file = tmp_path / "tiny.toml"
    file.write_text(FILE)
    started: list[subprocess.Popen[str]] = []

    def begin(*options: str) -> Running:
        command = [sys.executable, "-m", "zmav", "lab", "up", str(file), *options]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        started.append(process)
        assert process.stdout is not None
        said = [process.stdout.readline() for _ in range(2)]
        assert said[1].startswith("up in"), said + process.stdout.readlines()
        with Remote() as remote:
            room = remote.call("room", host="h1")
            other = remote.call("room", host="h2")
        networks = {inode(each["namespace"]) for each in (room, other)}
        sockets = Path(room["environment"][rundir.VARIABLE]).parent
        return Running(process, tmp_path / "zmav-lab" / "tiny", room["pid"], networks, sockets)

    yield begin
    for process in started:
        if process.poll() is None:
            process.kill()
        process.wait()
        assert process.stdout is not None
        process.stdout.close()


def inode(namespace: str) -> str:
    """A namespace as ``/proc/PID/ns/net`` shows it."""
    return f"net:[{Path(namespace).stat().st_ino}]"


def test_killed_it_ends_with_its_programs(begin: Begin) -> None:
    lab = begin()
    assert len(lab.left()) >= 3  # the router, the relay and files: this looks at the right places
    lab.process.kill()
    lab.gone()


def test_a_relay_that_dies_ends_all_of_it(begin: Begin) -> None:
    lab = begin("--bare")
    os.kill(lab.relay, signal.SIGKILL)
    assert lab.process.wait(PATIENCE_S) == 1
    assert "the lab's relay has died" in lab.process.communicate()[0]
    lab.gone()


def test_a_program_that_dies_ends_all_of_it_and_its_last_words_are_said(begin: Begin) -> None:
    lab = begin()
    (router,) = [int(pid) for pid, network in networks_of_processes() if network in lab.networks]
    os.kill(router, signal.SIGKILL)
    assert lab.process.wait(PATIENCE_S) == 1
    said = lab.process.communicate()[0]
    assert "h2 has ended with code -9" in said
    assert "it said" in said
    lab.gone()


def test_killed_with_its_relay_only_files_are_left_and_the_next_one_takes_their_place(begin: Begin) -> None:
    lab = begin("--bare")
    lab.process.send_signal(signal.SIGSTOP)  # so that it cannot clean up
    os.kill(lab.relay, signal.SIGKILL)
    lab.process.kill()
    lab.process.wait(PATIENCE_S)
    end = time.monotonic() + PATIENCE_S
    while [each for each in lab.left() if not each.startswith("files")]:
        assert time.monotonic() < end, lab.left()
        time.sleep(0.02)
    assert lab.directory.exists()
    again = begin("--bare")
    again.process.send_signal(signal.SIGINT)
    assert again.process.wait(PATIENCE_S) == 0
    assert again.left() == []
