"""A whole lab: namespaces, links, simulated vehicles, and the router of every host.

async with Lab("deploy/labs/line5.toml") as lab:
    await lab.ready()
    async with zmav.open(fleet=lab.fleet, connect=[await lab.endpoint("ground")]) as z:
        ...
    lab.cut("2-3")
    lab.set("1-2", loss=0.2, delay="100 ms")
    done = await lab.run_in("ground", "zmav", "ls", "--json")

Everything that was made is gone when the block ends, and also when this process is killed.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from mesh.credentials.ca import Authority
from mesh.lab.channel import Counters
from mesh.lab.door import door_of
from mesh.lab.fleetfile import write_fleet
from mesh.lab.network import LabError, Network, exit_of
from mesh.lab.scenario import SIMULATOR, Scenario, load_scenario
from zmav import rundir
from zmav.config import FleetConfig
from zmav.errors import BadConfig, TimedOut
from zmav.session import DEFAULT_PORT
from zmav.trust.certificate import Role

PATIENCE_S = 10.0
_TAIL = 2000


class Program:
    """One program that is to run as long as the lab does; raises :class:`LabError` where it cannot be started."""

    def __init__(
        self, network: Network, name: str, host: str | None, command: Sequence[str], log: Path, env: Mapping[str, str]
    ) -> None:
        self.name, self.host, self.log, self._command = name, host, log, list(command)
        self._network, self._env = network, {**os.environ, **env}
        self._process: subprocess.Popen[bytes] | None = None
        self._ended: Callable[[Program, int], None] | None = None
        self._watch: asyncio.Task[None] | None = None

    def start(self, ended: Callable[[Program, int], None]) -> None:
        """Start it; ``ended`` is called with its code when it ends without having been told to. On the event loop."""
        if self.running:
            raise LabError(f"{self.name} runs already")
        with self.log.open("ab") as log:
            try:
                self._process = self._network.popen(self.host, self._command, stdout=log, stderr=log, env=self._env)
            except OSError as e:
                raise LabError(f"cannot start {self.name}: {e}") from e
        self._ended = ended
        self._watch = asyncio.ensure_future(self._wait(self._process))

    async def _wait(self, process: subprocess.Popen[bytes]) -> None:
        code = await exit_of(process)
        if self._ended is not None:
            self._ended(self, code)

    @property
    def running(self) -> bool:
        return self._process is not None and self._process.poll() is None

    @property
    def pid(self) -> int | None:
        return self._process.pid if self._process is not None and self.running else None

    async def stop(self, signal_number: int = signal.SIGTERM) -> int | None:
        """Have it end; killed when it does not within :data:`PATIENCE_S`. Gives its code, None if it never ran."""
        self._ended = None
        process = self._process
        if process is None:
            return None
        with contextlib.suppress(ProcessLookupError):
            process.send_signal(signal_number)
        try:
            await asyncio.wait_for(asyncio.shield(exit_of(process)), PATIENCE_S)
        except asyncio.TimeoutError:
            process.kill()
            await exit_of(process)
        if self._watch is not None:
            await self._watch
        return process.returncode

    def said(self) -> str:
        """The end of its log."""
        try:
            data = self.log.read_bytes()
        except OSError:
            return ""
        return data[-_TAIL:].decode(errors="replace")


RELAY_DIED = "the lab's relay has died"
READY_S = 60.0
_LOOK_AGAIN_S = 0.05


class Lab:
    """Open it with ``async with``. What is wrong is a :class:`BadConfig` or a :class:`LabError` that says it.

    ``programs``: False for namespaces and links alone. ``directory``: where its files are (logs, fleet file,
    pseudo-terminals, credentials); made here, and removed when the lab ends. None: a new one for temporary files.
    ``keep``: descriptors that the relay keeps open until all of that is done.
    """

    def __init__(
        self,
        scenario: Scenario | str | Path,
        directory: str | Path | None = None,
        *,
        programs: bool = True,
        keep: Sequence[int] = (),
    ) -> None:
        found = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
        self.directory = Path(directory or tempfile.gettempdir() + f"/zmav-lab-{os.getpid()}-{id(self):x}")
        self.network = Network(found, self.directory, keep)
        self.scenario = self.network.scenario
        self.file = FleetConfig()
        """the fleet file, once it runs"""
        self.programs: dict[str, Program] = {}
        """by host; and the simulator"""
        self.failed: asyncio.Future[str] | None = None
        """done, with what happened, when something of the lab ended that was not told to"""
        self._with_programs = programs
        self._doors: dict[str, str] = {}
        self._stack = contextlib.AsyncExitStack()

    # ---- its life

    async def __aenter__(self) -> Lab:
        self.failed = asyncio.get_running_loop().create_future()
        async with contextlib.AsyncExitStack() as stack:
            self._make_directory()
            stack.callback(shutil.rmtree, self.directory, ignore_errors=True)
            await asyncio.to_thread(self.network.__enter__)
            stack.push_async_callback(asyncio.to_thread, self.network.close)
            self.file = write_fleet(self.network, self.directory)
            if self.scenario.credentials:
                await asyncio.to_thread(self._issue)
            watch = asyncio.ensure_future(self._watch_relay())
            stack.callback(watch.cancel)
            if self._with_programs:
                self._make_programs()
                stack.push_async_callback(self._stop_all)
                for name in self.programs:
                    self.start(name)
            self._stack = stack.pop_all()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._stack.aclose()

    def _make_directory(self) -> None:
        try:
            self.directory.mkdir(mode=0o700, parents=True)
        except OSError as e:
            expected = "a directory that is not there yet, in one that may be written to"
            text = f"cannot make the lab's directory {self.directory}: {e.strerror}; expected {expected}"
            raise BadConfig(text, field="directory", value=str(self.directory), expected=expected) from e

    def _issue(self) -> None:
        authority = Authority.create(self.directory / "ca", self.fleet)
        for name, host in self.scenario.hosts.items():
            role = Role.OPERATOR if host.vehicle is None else Role.VEHICLE
            authority.issue(name, role, out=self.credentials(name))
        authority.refresh(*map(self.credentials, self.scenario.hosts))

    def _make_programs(self) -> None:
        (self.directory / "logs").mkdir()
        zmav, file = [sys.executable, "-m", "zmav"], str(self.directory / "fleet.toml")
        if any(host.vehicle for host in self.scenario.hosts.values()):
            self._add(SIMULATOR, None, [*zmav, "sim", "--fleet", file, "--control", str(self.directory / "sim.sock")])
        for name, host in self.scenario.hosts.items():
            if host.program == "router":
                verb = "router" if host.vehicle is None else "up"
                self._add(name, name, [*zmav, verb, "--file", file, "--name", name, *host.arguments])

    def _add(self, name: str, host: str | None, command: list[str]) -> None:
        log = self.directory / "logs" / f"{name}.log"
        self.programs[name] = Program(self.network, name, host, command, log, self.environment(host))

    async def _stop_all(self) -> None:
        await asyncio.gather(*(program.stop() for program in self.programs.values()))

    async def _watch_relay(self) -> None:
        await self.network.ended()
        self._fail(RELAY_DIED)

    def _ended(self, program: Program, code: int) -> None:
        if not self.network.alive:
            self._fail(RELAY_DIED)
            return
        said = program.said().rstrip()
        self._fail(f"{program.name} has ended with code {code}; it said" + (f":\n{said}" if said else " nothing"))

    def _fail(self, text: str) -> None:
        if self.failed is not None and not self.failed.done():
            self.failed.set_result(text)

    # ---- what it has

    @property
    def fleet(self) -> str:
        return self.file.fleet

    @property
    def hosts(self) -> tuple[str, ...]:
        return self.network.wiring.hosts

    def credentials(self, host: str) -> Path:
        """The folder of that member."""
        return self.directory / "credentials" / host

    def environment(self, host: str | None) -> dict[str, str]:
        """What programs in that host find set: the fleet, their credentials, a cache of their own."""
        has = host is not None and self.scenario.credentials
        return {
            "ZMAV_FLEET": self.fleet,
            "ZMAV_CREDENTIALS": str(self.credentials(host)) if host is not None and has else "",
            "XDG_CACHE_HOME": str(self.directory / "cache"),
            rundir.VARIABLE: self.network.sockets(host),
        }

    # ---- its programs

    def program(self, name: str) -> Program:
        """The router of a host, or the :data:`SIMULATOR`; raises :class:`BadConfig` naming those there are."""
        if name not in self.programs:
            known = ", ".join(self.programs) or "none"
            raise BadConfig(f"nothing runs as {name!r}; there are {known}", field="host", value=name, expected=known)
        return self.programs[name]

    def start(self, name: str) -> None:
        """Start it again after :meth:`stop` or :meth:`kill`."""
        self.program(name).start(self._ended)

    async def stop(self, name: str) -> int | None:
        """Have it end in good order."""
        return await self.program(name).stop()

    async def kill(self, name: str) -> None:
        """As if its computer lost power."""
        await self.program(name).stop(signal.SIGKILL)

    async def ready(self, *hosts: str, timeout: float = READY_S) -> None:
        """Return when the routers of these hosts (none: of all) take clients; raises :class:`TimedOut`, or
        :class:`LabError` when something ends meanwhile.
        """
        names = hosts or tuple(name for name in self.programs if name in self.hosts)
        waiting = asyncio.ensure_future(asyncio.gather(*(self._answers(name) for name in names)))
        assert self.failed is not None
        try:
            await asyncio.wait((waiting, self.failed), timeout=timeout, return_when=asyncio.FIRST_COMPLETED)
        finally:
            over, _ = waiting.done(), waiting.cancel()
            (error,) = await asyncio.gather(waiting, return_exceptions=True)
        if self.failed.done():
            raise LabError(self.failed.result())
        if over and isinstance(error, BaseException):  # no such host, or the relay is dying
            raise error
        if not over:
            raise TimedOut(f"the routers of {', '.join(names)} are not up within {timeout:g} s")

    async def _answers(self, host: str) -> None:
        while True:
            with self.network.inside(host):
                probe = socket.socket()
            with probe:
                probe.setblocking(False)
                try:
                    await asyncio.get_running_loop().sock_connect(probe, ("127.0.0.1", DEFAULT_PORT))
                    return
                except OSError:
                    await asyncio.sleep(_LOOK_AGAIN_S)

    async def endpoint(self, host: str) -> str:
        """An endpoint here that leads to the host's router as the host's own programs reach it.

        It is the router's unix socket where the lab has credentials, else a port of our loopback.
        """
        self.network.namespace(host)
        if self.scenario.credentials:
            return f"{rundir.PROTOCOL}/{self.network.sockets(host)}/{DEFAULT_PORT}.sock"
        if host not in self._doors:
            self._doors[host] = await self._stack.enter_async_context(door_of(self.network, host))
        return self._doors[host]

    # ---- programs of yours

    def spawn(self, host: str, *command: str, **options: Any) -> subprocess.Popen[Any]:
        """Start a program in a host; it ends with the lab. ``options`` are those of :class:`subprocess.Popen`."""
        env = {**os.environ, **self.environment(host), **options.pop("env", {})}
        return self.network.popen(host, command, env=env, **options)

    async def run_in(self, host: str, *command: str, timeout: float = 60.0) -> subprocess.CompletedProcess[str]:
        """Run a program in a host to its end; raises :class:`TimedOut` and kills it where it takes longer."""
        process = self.spawn(
            host, *command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, errors="replace"
        )
        try:
            said = await asyncio.to_thread(process.communicate, timeout=timeout)
        except subprocess.TimeoutExpired:
            raise TimedOut(f"{' '.join(command)} in {host} took longer than {timeout:g} s") from None
        finally:
            process.kill()  # what has ended takes no harm
            process.wait()
        return subprocess.CompletedProcess(command, process.returncode, *said)

    # ---- its links: see Network

    def cut(self, link: str) -> None:
        self.network.cut(link)

    def heal(self, link: str) -> None:
        self.network.heal(link)

    def set(self, link: str, **values: Any) -> None:
        self.network.set(link, **values)

    def counters(self, link: str) -> list[Counters]:
        return self.network.counters(link)
