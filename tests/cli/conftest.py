"""Verbs under test, in this process or as processes of their own, beside a simulated vehicle with its real agent."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NamedTuple

import pytest
import zenoh
from click.testing import CliRunner, Result

import zmav
from zmav import cli
from zmav.process import free_port
from zmav.sim import SimVehicle, VehicleSpec, World
from zmav.wire import VehicleState

if TYPE_CHECKING:
    from tests.conftest import Net

PATIENCE_S = 30.0
Patience = Callable[[float], None]
ROOT = Path(__file__).resolve().parent.parent.parent
SPEED = 8.0
"""times real time, while a test waits for a flight"""
PLACE = ("-35.363261", "149.165230", "584.09")
"""Where the simulator's world begins"""


class Process:
    """A program, with all it has said so far."""

    def __init__(self, *command: str) -> None:
        self.popen = subprocess.Popen(
            command,
            cwd=ROOT,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.out: list[str] = []
        self.err: list[str] = []
        self._changed = threading.Condition()
        assert self.popen.stdout is not None
        assert self.popen.stderr is not None
        pairs = ((self.popen.stdout, self.out), (self.popen.stderr, self.err))
        self._readers = [threading.Thread(target=self._read, args=pair, daemon=True) for pair in pairs]
        for reader in self._readers:
            reader.start()

    def _read(self, pipe: IO[str], lines: list[str]) -> None:
        for line in pipe:
            with self._changed:
                lines.append(line.rstrip("\n"))
                self._changed.notify_all()
        with self._changed:
            self._changed.notify_all()

    @property
    def stdout(self) -> str:
        return "\n".join(self.out)

    @property
    def stderr(self) -> str:
        return "\n".join(self.err)

    def expect(self, words: str) -> str:
        """The first line with these words, waited for."""
        found: list[str] = []

        def there() -> bool:
            found[:] = [line for line in (*self.out, *self.err) if words in line]
            return bool(found) or not any(reader.is_alive() for reader in self._readers)

        with self._changed:
            ended = self._changed.wait_for(there, PATIENCE_S)
        assert ended and found, f"{words!r} was never said; {self.stdout!r}, {self.stderr!r}"
        return found[0]

    def wait(self) -> int:
        """Its exit code, once it has ended by itself and all it said is read."""
        code = self.popen.wait(PATIENCE_S)
        for reader in self._readers:
            reader.join(PATIENCE_S)
        return code

    def stop(self, number: int = signal.SIGTERM) -> int:
        self.popen.send_signal(number)
        return self.wait()


StartProcess = Callable[..., Process]


@pytest.fixture
def start() -> Iterator[StartProcess]:
    """Start ``zmav ARGUMENTS`` as a process of its own; what still runs at the test's end is killed."""
    started: list[Process] = []

    def start(*arguments: str, program: str = "zmav") -> Process:
        command = (sys.executable, "-m", program, *arguments)
        started.append(Process(*command))
        return started[-1]

    yield start
    for process in started:
        if process.popen.poll() is None:
            process.popen.kill()
        process.wait()


class Told(NamedTuple):
    """How a verb run in this process ended, and what it said."""

    code: int
    out: str
    err: str
    error: BaseException | None

    @property
    def lines(self) -> list[dict[str, Any]]:
        """Its JSON lines."""
        return [json.loads(line) for line in self.out.splitlines()]


def zmav_here(*arguments: str) -> Told:
    """Run a verb in this process; ``error`` is the exception that ``main`` would say."""
    result: Result = CliRunner().invoke(cli.zmav, arguments)
    error = None if isinstance(result.exception, SystemExit) else result.exception
    return Told(result.exit_code, result.stdout, result.stderr, error)


class Here:
    """Runs verbs in this process, all with the same last arguments."""

    def __init__(self, *last: str) -> None:
        self._last = last

    def __call__(self, *arguments: str) -> Told:
        """Run it; it must end well."""
        told = zmav_here(*arguments, *self._last)
        if told.error is not None:
            raise told.error
        assert told.code == 0, told
        return told

    def fails(self, *arguments: str) -> Told:
        """Run it; it must not end well, and must raise nothing that is not said to the user."""
        told = zmav_here(*arguments, *self._last)
        assert told.code == 1, told
        assert told.error is None or isinstance(told.error, zmav.ZmavError), told
        return told

    def misused(self, *arguments: str) -> Told:
        """Run it; its arguments must be refused before anything is done."""
        told = zmav_here(*arguments, *self._last)
        assert told.code == 2, told
        return told


@pytest.fixture
def here() -> type[Here]:
    return Here


class Vehicle(NamedTuple):
    """A simulated copter, and the process of ``zmav up`` beside it."""

    sim: SimVehicle
    world: World
    up: Process
    endpoint: str
    zmav: Here

    def until(self, true: Callable[[VehicleState], bool]) -> VehicleState:
        """Wait for a state."""

        async def wait() -> VehicleState:
            async with zmav.open(connect=[self.endpoint]) as z:
                return await z.vehicle("quad1").wait_until(true, PATIENCE_S)

        return asyncio.run(wait())


@pytest.fixture
def vehicle(shared_vehicle: Vehicle) -> Iterator[Vehicle]:
    """quad1, awake; shared, so leave it as you found it: disarmed on the ground. One that a failed test left in the air
    is brought down, so that the next ones can tell of themselves.
    """
    yield shared_vehicle
    left = shared_vehicle.sim.status()
    if left.armed or left.mode != "STABILIZE":
        shared_vehicle.world.set_speed(SPEED)
        try:
            for order in (("land",), ("set_mode", "mode=STABILIZE")):
                shared_vehicle.zmav("do", "quad1", *order)
            shared_vehicle.until(lambda s: bool(s.ready and not s.armed and s.mode == "STABILIZE"))
        finally:
            shared_vehicle.world.set_speed(1.0)


@pytest.fixture
def hurried(vehicle: Vehicle) -> Iterator[None]:
    """For a test that flies quad1, or waits for many of its frames: eight times as much is simulated, and sent to its
    agent, as the others need.
    """
    vehicle.world.set_speed(SPEED)
    yield
    vehicle.world.set_speed(1.0)


@pytest.fixture(scope="module")  # flying on beside all later tests, it would take a fifth of a core of each worker
def shared_vehicle(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Vehicle]:
    spec = VehicleSpec(params={"DISARM_DELAY": 0.0, "FS_GCS_ENABLE": 1.0})
    with World([spec], endpoint="tcp:0", ready_s=0.5) as world:
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        cache = ("--cache", str(tmp_path_factory.mktemp("cache")))
        link = ("--link", world.urls[0], "-l", endpoint)
        up = Process(sys.executable, "-m", "zmav", "up", *link, *cache, "--origin", *PLACE)
        try:
            up.expect("demo/quad1: ")
            found = Vehicle(world.vehicles[0], world, up, endpoint, Here("-e", endpoint))
            found.until(lambda s: bool(s.ready and s.attitude and s.uid))
            yield found
        finally:
            up.popen.terminate()
            up.wait()


Saying = bytes | None | Callable[[], bytes]


class Speaker:
    """Puts what it is given fifty times a second until the test's end; None deletes. ``zmav`` runs verbs beside it."""

    def __init__(self, session: zenoh.Session, endpoint: str) -> None:
        self.session, self.endpoint, self.zmav = session, endpoint, Here("-e", endpoint)
        self._sayings: dict[str, Saying] = {}
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._speak)
        self._thread.start()

    def say(self, key: str, what: Saying) -> None:
        self._sayings[key] = what

    def _speak(self) -> None:
        while not self._over.wait(0.02):
            for key, what in list(self._sayings.items()):
                if what is None:
                    self.session.delete(key)
                else:
                    self.session.put(key, what if isinstance(what, bytes) else what())

    def close(self) -> None:
        self._over.set()
        self._thread.join()


@pytest.fixture
def speaker(net: Net) -> Iterator[Speaker]:
    """What only a vehicle in trouble says, said without one, in a router of its own."""
    speaker = Speaker(*net.router())
    yield speaker
    speaker.close()


@pytest.fixture
def patience(monkeypatch: pytest.MonkeyPatch) -> Patience:
    """Give up a vehicle that does not answer after so many seconds: a verb opens its client itself."""
    return lambda seconds: monkeypatch.setattr(zmav.Vehicle, "give_up", seconds)
