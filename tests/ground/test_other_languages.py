"""The examples in other languages, each flown: judged by what it says and by what the simulator saw."""

from __future__ import annotations

import asyncio
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

import zmav
from mesh.credentials.ca import Authority
from tests.waiting import wait_until
from zmav.process import free_port
from zmav.sim import Remote
from zmav.trust.certificate import Role

pytestmark = [pytest.mark.process, pytest.mark.flight, pytest.mark.slow]
EXAMPLES = Path(__file__).resolve().parent.parent.parent / "ground" / "examples"
RUST = Path(os.environ.get("CARGO_TARGET_DIR", EXAMPLES / "rust" / "target")) / "debug" / "fly"
BUILD = "needs 'cargo build' in ground/examples/rust beforehand: some minutes of a processor"
PATIENCE_S = 60.0
SPEED = "4"
"""times real time: a climb still takes longer than an order waits, so that it is asked again"""
AT = (6.0, 2.0, -8.0)
"""where each leads the vehicle: m, NED"""


class Flown(NamedTuple):
    """How an example ended, what it said, and how near the vehicle came to :data:`AT`."""

    code: int
    said: str
    nearest_m: float


class Field:
    """A simulated copter, and what else is started beside it, as processes."""

    def __init__(self, folder: Path) -> None:
        self.port = free_port()
        self.router = f"tcp/127.0.0.1:{self.port}"
        self._control = folder / "sim.sock"
        self._processes: list[subprocess.Popen[bytes]] = []

    def start(self, *command: str, **environment: str) -> None:
        whole = [sys.executable, "-m", "zmav", *command]
        self._processes.append(subprocess.Popen(whole, env={**os.environ, **environment}, stdout=subprocess.DEVNULL))

    def start_sim(self, *more: str, **environment: str) -> None:
        self.start("sim", "--control", str(self._control), *more, **environment)

    def until(self, words: str, look: list[str]) -> None:
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


class Open(Field):
    """A fleet without credentials, and the gateway."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.gateway = f"http://127.0.0.1:{free_port()}"
        self.start_sim("--up", "--endpoint", "tcp:0", "--speed", SPEED, ZMAV_CONNECT=self.router)
        wait_until(self._listens, "no router", PATIENCE_S)
        asyncio.run(self._prepare())
        self.start("http", "--port", self.gateway.rpartition(":")[2], ZMAV_CONNECT=self.router)
        self.until("quad1 ", ["curl", "--silent", f"{self.gateway}/vehicles"])

    def _listens(self) -> bool:
        with socket.socket() as sock:
            return sock.connect_ex(("127.0.0.1", self.port)) == 0

    async def _prepare(self) -> None:
        """Until the vehicle is ready to fly, however late an order to take off comes, and to land quickly."""
        async with zmav.open(connect=[self.router]) as z:
            (quad,) = await z.wait_for("quad1", timeout=PATIENCE_S)
            await quad.wait_until(lambda s: bool(s.ready), PATIENCE_S)
            await quad.params.set("DISARM_DELAY", 0)
            await quad.params.set("LAND_SPEED", 150)  # cm/s


class Closed(Field):
    """A fleet with credentials, whose vehicle's router takes TLS of members alone."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        authority = Authority.create(folder / "ca", "alpha")
        quad1 = authority.issue("quad1", Role.VEHICLE)
        self.alice, self.viewer = authority.issue("alice", Role.OPERATOR), authority.issue("lab", Role.VIEWER)
        self.strangers = Authority.create(folder / "others", "alpha").issue("alice", Role.OPERATOR)
        authority.refresh()
        self.tls, link = f"tls/127.0.0.1:{free_port()}", f"tcp:127.0.0.1:{free_port()}"
        self.start_sim("--endpoint", link.replace("127.0.0.1:", ""))
        origin = ("--origin", "-35.363261", "149.165230", "584.09")
        fleet = ("--fleet", "alpha", "--credentials", str(quad1))
        self.start("up", "--link", link, "--name", "quad1", *origin, *fleet, "-l", self.tls)
        where = ("--fleet", "alpha", "-e", self.tls, "--credentials", str(self.alice))
        self.until('"ready": true', [sys.executable, "-m", "zmav", "ls", "--json", "--wait", "2", *where])


@pytest.fixture(scope="module")
def field(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Open]:
    if shutil.which("curl") is None:
        pytest.skip("needs curl")
    made = Open(tmp_path_factory.mktemp("field"))
    yield made
    made.close()


@pytest.fixture
def closed(tmp_path: Path) -> Iterator[Closed]:
    if not RUST.is_file():
        pytest.skip(BUILD)
    made = Closed(tmp_path)
    yield made
    made.close()


def check(flown: Flown, refusal: str) -> None:
    """It took off, outlived a refusal, led the vehicle to the point, and landed."""
    assert flown.code == 0, flown.said
    assert "takeoff: not done yet" in flown.said, "it was asked again under its id"
    assert re.search(refusal, flown.said), flown.said
    assert "over the ceiling of 120 m" in flown.said
    assert flown.nearest_m < 1.0, flown.said


def test_curl(field: Open) -> None:
    flown = field.fly(EXAMPLES / "curl.sh", "quad1", field.gateway)
    check(flown, "goto refused: .*bad_input")
    assert '"lease"' in flown.said and '"released":true' in flown.said
    assert re.search(r'land: .*"armed":false', flown.said)


def test_the_zenoh_command_line(field: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("zenoh_cli", reason="needs zenoh-cli")
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    flown = field.fly(EXAMPLES / "zenoh.sh", "quad1", "demo", field.router)
    check(flown, "goto refused: .*bad_input")
    assert re.search(r'setpoints: {"flown": \d\d', flown.said)
    assert re.search(r'release: .*"done"', flown.said)
    assert re.search(r'land: .*"armed": false', flown.said)


def test_javascript(field: Open) -> None:
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


def compiled(program: Path, source: str, headers: str, *flags: str) -> Path:
    """An example in C++, where its compiler and these headers are there."""
    compiler = shutil.which("g++")
    if compiler is None:
        pytest.skip("needs g++")
    includes = "".join(f"#include <{header}>\n" for header in headers.split())
    looked = [compiler, "-std=c++17", "-E", "-x", "c++", *flags, "-"]
    if subprocess.run(looked, input=includes.encode(), capture_output=True, check=False).returncode:
        pytest.skip(f"needs the headers {headers}")
    subprocess.run([compiler, "-std=c++17", "-o", program, EXAMPLES / source, *flags], check=True)
    return program


def test_cpp(field: Open, tmp_path: Path) -> None:
    program = compiled(tmp_path / "fly", "fly.cpp", "curl/curl.h nlohmann/json.hpp", "-lcurl")
    flown = field.fly(program, "quad1", field.gateway)
    check(flown, r"refused \(bad_input\)")
    assert re.search(r'moved by "cpp" under \w', flown.said), flown.said
    assert flown.said.endswith("landed\n")


def test_cpp_over_zenoh(field: Open, tmp_path: Path) -> None:
    """``$ZENOHCXX_FLAGS``: of a zenoh-cpp elsewhere, or on zenoh-pico."""
    flags = os.environ.get("ZENOHCXX_FLAGS", "-DZENOHCXX_ZENOHC -lzenohc").split()
    program = compiled(tmp_path / "fly", "fly_zenoh.cpp", "zenoh.hxx nlohmann/json.hpp", *flags)
    flown = field.fly(program, "quad1", "demo", field.router)
    check(flown, r"refused \(bad_input\)")
    assert 'moved by "cpp"' in flown.said
    assert flown.said.endswith("landed\n")


def test_rust(field: Open) -> None:
    if not RUST.is_file():
        pytest.skip(BUILD)
    flown = field.fly(RUST, "quad1", "demo", field.router)
    check(flown, r"refused \(bad_input\)")
    assert 'moved by "rust"' in flown.said
    assert flown.said.endswith("landed\n")


def test_rust_on_a_fleet_with_credentials(closed: Closed) -> None:
    """By docs/proofs.md alone: its orders are proven, its points sealed, and it believes what the vehicle signed."""
    where = ("quad1", "alpha", closed.tls)
    stranger = closed.fly(RUST, *where, closed.strangers)
    assert stranger.code == 1 and "Unable to connect" in stranger.said, "another fleet's authority"
    viewer = closed.fly(RUST, *where, closed.viewer)
    assert viewer.code == 1 and viewer.said.endswith("arm: nobody answers 4 times\n"), "the door leaves its orders out"
    flown = closed.fly(RUST, *where, closed.alice)
    check(flown, r"refused \(bad_input\)")
    assert "arm: refused (forbidden): its proof of origin is not for this start" in flown.said
    assert "signed again" in flown.said
    assert "not believed" not in flown.said
    assert 'moved by "rust"' in flown.said
    assert flown.said.endswith("landed\n")
