"""The examples in other languages, each flown: judged by what it says and by what the simulator saw."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from zmav.process import free_port
from zmav.sim import Remote

pytestmark = [pytest.mark.process, pytest.mark.flight, pytest.mark.slow]
EXAMPLES = Path(__file__).resolve().parent.parent.parent / "ground" / "examples"
RUST = Path(os.environ.get("CARGO_TARGET_DIR", EXAMPLES / "rust" / "target")) / "debug" / "fly"
PATIENCE_S = 60.0
AT = (6.0, 2.0, -8.0)
"""where each leads the vehicle: m, NED"""


class Flown(NamedTuple):
    """How an example ended, what it said, and how near the vehicle came to :data:`AT`."""

    code: int
    said: str
    nearest_m: float


class Field:
    """A simulated copter in the key space, and the gateway, as processes."""

    def __init__(self, folder: Path) -> None:
        self.router = f"tcp/127.0.0.1:{free_port()}"
        self.gateway = f"http://127.0.0.1:{free_port()}"
        self._control = folder / "sim.sock"
        environment = {**os.environ, "ZMAV_CONNECT": self.router}
        port = self.gateway.rpartition(":")[2]
        commands = (
            ["sim", "--up", "--endpoint", "tcp:0", "--control", str(self._control)],
            ["http", "--port", port],
        )
        self._processes: list[subprocess.Popen[bytes]] = []
        look = [sys.executable, "-m", "zmav", "ls", "--json", "--wait", "2", "-e", self.router]
        for command in commands:
            whole = [sys.executable, "-m", "zmav", *command]
            self._processes.append(subprocess.Popen(whole, env=environment, stdout=subprocess.DEVNULL))
            self._until('"ready": true', look)
        self._until("quad1 ", ["curl", "--silent", f"{self.gateway}/vehicles"])

    def _until(self, words: str, look: list[str]) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while words not in subprocess.run(look, capture_output=True, text=True, check=False).stdout:
            assert time.monotonic() < deadline
            assert all(process.poll() is None for process in self._processes)
            time.sleep(0.2)

    def fly(self, *command: str | Path) -> Flown:
        """Run an example to its end."""
        nearest, over = [float("inf")], threading.Event()

        def watch() -> None:
            with Remote(self._control) as sim:
                while not over.wait(0.05):
                    (vehicle,) = sim.status().vehicles
                    away = sum((a - b) ** 2 for a, b in zip(vehicle.ned_m, AT, strict=True)) ** 0.5
                    nearest[0] = min(nearest[0], away)

        watching = threading.Thread(target=watch)
        watching.start()
        try:
            pipe, both = subprocess.PIPE, subprocess.STDOUT
            done = subprocess.run(command, stdout=pipe, stderr=both, text=True, timeout=100, check=False)
        finally:
            over.set()
            watching.join()
        return Flown(done.returncode, done.stdout, nearest[0])

    def close(self) -> None:
        for process in reversed(self._processes):
            process.send_signal(signal.SIGTERM)
            process.wait(PATIENCE_S)


@pytest.fixture(scope="module")
def field(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Field]:
    if shutil.which("curl") is None:
        pytest.skip("needs curl")
    made = Field(tmp_path_factory.mktemp("field"))
    yield made
    made.close()


def check(flown: Flown, refusal: str) -> None:
    """It took off, outlived a refusal, led the vehicle to the point, and landed."""
    assert flown.code == 0, flown.said
    assert "takeoff: not done yet" in flown.said, "it was asked again under its id"
    assert re.search(refusal, flown.said), flown.said
    assert "over the ceiling of 120 m" in flown.said
    assert flown.nearest_m < 1.0, flown.said


def test_curl(field: Field) -> None:
    flown = field.fly(EXAMPLES / "curl.sh", "quad1", field.gateway)
    check(flown, "goto refused: .*bad_input")
    assert '"lease"' in flown.said and '"released":true' in flown.said
    assert re.search(r'land: .*"armed":false', flown.said)


def test_the_zenoh_command_line(field: Field, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("zenoh_cli", reason="needs zenoh-cli")
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    flown = field.fly(EXAMPLES / "zenoh.sh", "quad1", "demo", field.router)
    check(flown, "goto refused: .*bad_input")
    assert re.search(r'setpoints: {"flown": \d\d', flown.said)
    assert re.search(r'release: .*"done"', flown.said)
    assert re.search(r'land: .*"armed": false', flown.said)


def test_javascript(field: Field) -> None:
    node = shutil.which("node")
    if node is None:
        pytest.skip("needs node")
    number = int(subprocess.check_output([node, "--version"], text=True).lstrip("v").partition(".")[0])
    if number < 20:
        pytest.skip("needs Node 20 or newer, which has WebSockets")
    flag = ["--experimental-websocket"] if number < 22 else []
    flown = field.fly(node, *flag, EXAMPLES / "fly.mjs", "quad1", field.gateway)
    check(flown, r"refused \(bad_input\)")
    assert "moved by javascript" in flown.said
    assert flown.said.endswith("landed\n")


def test_rust(field: Field) -> None:
    if not RUST.is_file():
        pytest.skip("needs 'cargo build' in ground/examples/rust beforehand: some minutes of a processor")
    flown = field.fly(RUST, "quad1", "demo", field.router)
    check(flown, r"refused \(bad_input\)")
    assert 'moved by "rust"' in flown.said
    assert flown.said.endswith("landed\n")
