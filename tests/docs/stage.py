"""Where a page's commands are run as they stand: a folder and a network of its own, so that every port is free."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType

from tests.docs.commands import ROOT
from zmav import rundir
from zmav.sim import Remote

PATIENCE_S = 90.0
"""how long a command may take, or a program to say that it is ready"""
LINKED = ("agents", "deploy", "docs", "ground", "mesh", "tests")
SERVICES: tuple[tuple[str, str], ...] = (
    (r"zmav sim( --.*)?", r"\(system id \d+\): "),
    (r"zmav up .*", r"parameters read"),
    (r"zmav router.*", r"on tcp/|router"),
    (r"zmav swarm planner.*", r"."),
    (r"zmav gcs.*", r"."),
    (r"zmav http.*", r"http://"),
    (r"zmav record.*", r"."),
    (r"zmav agent run .*", r"."),
    (r"zmav camera (run|view) .*", r"."),
    (r"zmav top.*", r"."),
    (r"zmav view( --web.*| --save.*)?", r"."),
    (r"zenoh .* subscribe .*", r"."),
)
"""programs that run until they are ended, and what they have said when the next command may come"""
FLIES = re.compile(
    r"zmav (do \S+ (arm && .*)?(takeoff|land|rtl)|goto|mission start|swarm (takeoff|formation)|agent do hopper)\b.*"
)
"""commands that wait until a vehicle has flown somewhere"""
HURRY = 4.0
"""times real time that simulated vehicles fly meanwhile"""
LOOK_S = 0.1


def namespaced() -> str:
    """Why no network of one's own can be made here; empty where it can."""
    try:
        with Network():
            return ""
    except (OSError, AssertionError) as e:
        return f"no network namespace can be made here: {e}"


class Network:
    """A network namespace with nothing but loopback, kept by a process."""

    def __enter__(self) -> Network:
        user = [] if os.geteuid() == 0 else ["--user", "--map-root-user"]
        script = "ip link set lo up && echo up && exec sleep infinity"
        self.keeper = subprocess.Popen(
            ["unshare", "--net", *user, "sh", "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        assert self.keeper.stdout is not None and self.keeper.stderr is not None
        if self.keeper.stdout.readline() != "up\n":
            self.keeper.kill()
            raise AssertionError(self.keeper.stderr.read().strip())
        more = ["--user", "--preserve-credentials"] if user else []
        self.enter = ["nsenter", "--target", str(self.keeper.pid), *more, "--net", "--"]
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.keeper.kill()
        self.keeper.communicate()


class Program:
    """A command that runs on, with all it has said."""

    def __init__(self, text: str, process: subprocess.Popen[str]) -> None:
        self.text, self.process = text, process
        self.said = ""
        self._changed = threading.Condition()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            with self._changed:
                self.said += line
                self._changed.notify_all()
        with self._changed:
            self._changed.notify_all()

    def until(self, pattern: str) -> None:
        deadline = time.monotonic() + PATIENCE_S
        with self._changed:
            while not re.search(pattern, self.said):
                ended = not self._reader.is_alive()
                left = deadline - time.monotonic()
                assert not ended and left > 0, f"{self.text}: never said {pattern!r} but:\n{self.said[-3000:]}"
                self._changed.wait(min(left, 0.5))

    def signal(self, number: int) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, number)

    def end(self) -> None:
        """Ctrl-C, as a person ends it."""
        self.signal(signal.SIGINT)
        try:
            code = self.process.wait(20.0)
        except subprocess.TimeoutExpired:
            self.signal(signal.SIGKILL)
            self.process.wait()
            raise AssertionError(f"{self.text}: does not end on Ctrl-C:\n{self.said[-3000:]}") from None
        self._reader.join(5.0)
        assert code in (0, 1, 130, -signal.SIGINT), f"{self.text}: ended with {code}:\n{self.said[-3000:]}"
        assert "Traceback" not in self.said, f"{self.text}:\n{self.said[-3000:]}"


class Hurry:
    """The simulators with control sockets in ``folder`` go faster while one of their vehicles flies, or none is armed
    and one may have to become ready.

    Armed on the ground they go slower: an autopilot would disarm before the next command comes.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._look)

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._over.set()
        self._thread.join()

    def _look(self) -> None:
        with contextlib.ExitStack() as stack:
            simulators = [stack.enter_context(Remote(path)) for path in self._folder.glob("*.sock")]
            for simulator in simulators:
                stack.callback(simulator.speed, 1.0)
            while not self._over.wait(LOOK_S):
                for simulator in simulators:
                    status = simulator.status()
                    armed = [vehicle for vehicle in status.vehicles if vehicle.armed]
                    speed = HURRY if not armed or any(vehicle.flying for vehicle in armed) else 0.5
                    if status.speed != speed:
                        simulator.speed(speed)


class Stage:
    """Runs the commands of a :meth:`part` one after another; those of :data:`SERVICES` stay beside them until it ends.

    The programs ``on`` which it stands run since a part before that stands on them, too, or start with it.
    """

    def __init__(self) -> None:
        self.network = Network()
        self.programs: list[Program] = []
        self._on = 0
        """on so many of them, the first ones, the part stands"""
        self.environment = {k: v for k, v in os.environ.items() if not k.startswith("ZMAV_")}
        self.environment[rundir.VARIABLE] = os.devnull  # namespaces share the file system
        self._runtime = tempfile.TemporaryDirectory(prefix="zmav-docs-")  # short: sockets' paths may have 100 letters
        self.environment |= {
            "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
            "MPLBACKEND": "Agg",
            "PYTHONUNBUFFERED": "1",
            "TERM": "dumb",
        }

    def __enter__(self) -> Stage:
        self.network.__enter__()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        try:
            if kind is None:
                self._clear(())
        finally:
            self._kill()
            self.network.__exit__(kind, error, tb)
            self._runtime.cleanup()

    @contextlib.contextmanager
    def part(self, folder: Path, on: tuple[str, ...] = ()) -> Iterator[None]:
        """What runs in this folder, beside nothing but ``on``; of a part that fails nothing runs on."""
        for name in LINKED:
            (folder / name).symlink_to(ROOT / name)
        (folder / ".venv").symlink_to(sys.prefix)
        self.folder, self._on = folder, len(on)
        self.environment |= {"HOME": str(folder), "XDG_CACHE_HOME": str(folder / ".cache")}
        try:
            self._clear(on)
            if not self.programs:  # those that were killed have left their sockets
                self._runtime.cleanup()
                self._runtime = tempfile.TemporaryDirectory(prefix="zmav-docs-")
                self.environment["XDG_RUNTIME_DIR"] = self._runtime.name
            for text in on[len(self.programs) :]:
                self._start(text, r".")
            yield
            self._clear(on)
        except BaseException:
            self._kill()
            raise

    def _clear(self, on: tuple[str, ...]) -> None:
        """End what runs, the last first, but for what there is of ``on``."""
        kept = 0
        for program, text in zip(self.programs, on, strict=False):
            if program.text != text or program.process.poll() is not None:
                break
            kept += 1
        while len(self.programs) > kept:
            program = self.programs[-1]
            program.end()
            self.programs.pop()

    def _kill(self) -> None:
        while self.programs:
            program = self.programs.pop()
            program.signal(signal.SIGKILL)
            program.process.wait()

    def run(self, line: str, where: str = "") -> None:
        """Run a line of a page; each part of it that ends in ``&`` runs on.

        The exit code must be 0; of ``zmav doctor`` it may be 1, which says that it has found something.
        """
        foreign = re.search(r"\b(sudo|systemctl|apt|apt-get|ssh|scp|git|install\.sh|agent install)\b", line)
        assert foreign is None, f"{where or line}: changes this machine: give a reason in NOT_RUN"
        *behind, last = [part.strip() for part in re.split(r"(?<!&)&(?!&)(?=\s|$)", line)]
        for part in behind:
            self._start(part, r".")
        if not last:
            return
        for program in self.programs[: self._on]:
            if program.text == last:  # the part stands on it
                assert program.process.poll() is None, f"{where or line}: has ended:\n{program.said[-3000:]}"
                return
        for pattern, ready in SERVICES:
            if re.fullmatch(pattern, last):
                self._start(last, ready)
                return
        process = self._open(last)
        hurry = Hurry(Path(self._runtime.name) / "zmav-sim") if FLIES.fullmatch(last) else contextlib.nullcontext()
        try:
            with hurry:
                said, _ = process.communicate(timeout=PATIENCE_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            said, _ = process.communicate()
            raise AssertionError(
                f"{where or line}: not done after {PATIENCE_S:g} s:\n{said[-3000:]}{self._log()}"
            ) from None
        found = line.startswith("zmav doctor") and not re.search(r"^zmav: ", said, re.MULTILINE)
        assert process.returncode in (0, int(found)) and "Traceback" not in said, (
            f"{where or line}: exit code {process.returncode}:\n{said[-3000:]}{self._log()}"
        )

    def _log(self) -> str:
        return "".join(f"\n--- {program.text}\n{program.said[-600:]}" for program in self.programs)

    def _start(self, text: str, ready: str) -> None:
        for pattern, words in SERVICES:
            if re.fullmatch(pattern, text):
                ready = words
        self.programs.append(Program(text, self._open(text)))
        self.programs[-1].until(ready)

    def _open(self, text: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [*self.network.enter, "bash", "-c", text],
            cwd=self.folder,
            env=self.environment,
            text=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
