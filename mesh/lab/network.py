"""The lab's namespaces and links, without programs in them: made, changed while they run, and gone with this process.

with Network(scenario) as network:
    network.set("2-3", loss=0.2, rate="1M")
    network.cut("1-2")
    with network.inside("quad1"):
        s = socket.socket()     # is in quad1's namespace for as long as it is open

Zenoh's threads belong to the process and stay in the namespace where its first session was opened: a session inside a
namespace needs a process of its own (:meth:`Network.popen`).
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import select
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from mesh.lab import kernel, messages
from mesh.lab.channel import Conditions, Counters
from mesh.lab.scenario import Scenario, check
from mesh.lab.values import Ask, ask_from, conditions
from mesh.lab.wiring import Wiring, wire
from zmav import rundir
from zmav.errors import BadConfig, ZmavError

T = TypeVar("T")
ANSWER_S = 30.0
_NEEDS = "the lab makes network namespaces and TAP interfaces: it needs root and /dev/net/tun"


class LabError(ZmavError):
    """The lab cannot be made, or has broken."""


def check_able() -> None:
    """Raise :class:`LabError` that says what is missing where no lab can be made."""
    if not sys.platform.startswith("linux"):
        raise LabError(f"{_NEEDS}; this is not Linux")
    if os.geteuid() != 0:
        raise LabError(f"{_NEEDS}; you are user {os.geteuid()}: run it with sudo")
    if lacking := kernel.lacking():
        raise LabError(f"{_NEEDS}; root lacks {', '.join(lacking)} here: start the container with --privileged")
    if not Path(kernel.TUN).exists():
        raise LabError(f"{_NEEDS}; there is no {kernel.TUN}: 'modprobe tun', or give the container the device")


class Network:
    """Open it with ``with``. Raises :class:`LabError` where it cannot be made (:func:`check_able` says what for);
    its methods raise :class:`BadConfig` for names and conditions there are not, and :class:`LabError` once the relay
    has died.
    """

    def __init__(self, scenario: Scenario, directory: Path | None = None, keep: Sequence[int] = ()) -> None:
        """``directory``: is removed when the lab ends, however it ends. ``keep``: descriptors that the relay holds."""
        self.scenario = check(scenario)
        self.wiring: Wiring = wire(self.scenario)
        self._directory, self._keep = directory, keep
        self._conditions = list(self.wiring.begin.channels)
        self._lock = threading.Lock()
        self._relay: subprocess.Popen[bytes] | None = None
        self._connection: Connection[Any, Any] | None = None
        self._begun = messages.Begun(0, [])
        self._started: list[subprocess.Popen[Any]] = []
        self._sockets: tempfile.TemporaryDirectory[str] | None = None

    # ---- its life

    def __enter__(self) -> Network:
        check_able()
        self._sockets = tempfile.TemporaryDirectory(prefix="zmav-run-")  # a socket's path is short
        self._connection, theirs = Pipe()
        with theirs:
            command = [sys.executable, "-m", "mesh.lab.relay", str(theirs.fileno())]
            self._relay = subprocess.Popen(
                command, pass_fds=[theirs.fileno(), *self._keep], start_new_session=True, stdin=subprocess.DEVNULL
            )
        left = [str(each) for each in (self._directory, self._sockets.name) if each is not None]
        try:
            begun = self._ask(msgspec.structs.replace(self.wiring.begin, directories=left))
        except BaseException:
            self.close()
            raise
        assert isinstance(begun, messages.Begun)
        self._begun = begun
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End everything in the namespaces, and them; returns when all of it is gone."""
        if self._connection is not None:
            self._connection.close()
        for process in self._started:  # a PID namespace ends when all in it are waited for
            process.wait()
        if self._relay is not None:
            self._relay.wait()
        if self._sockets is not None:
            self._sockets.cleanup()

    def sockets(self, host: str | None) -> str:
        """The folder of a host's unix sockets: hosts share the file system, and each has its own. None: nobody's."""
        if host is None or self._sockets is None:
            return os.devnull
        return str(Path(self._sockets.name, host))

    @property
    def pid(self) -> int:
        """The relay's process: when it is gone, everything is."""
        return self._begun.pid

    @property
    def alive(self) -> bool:
        """Whether the relay is: its end of our socket closes before anything dies of its death."""
        if self._connection is None or self._connection.closed:
            return False
        poll = select.poll()
        poll.register(self._connection, select.POLLHUP)
        return not poll.poll(0)

    async def ended(self) -> None:
        """Return when the relay has died, which ends everything."""
        assert self._relay is not None
        await exit_of(self._relay)

    def _ask(self, request: messages.Request) -> messages.Answer:
        assert self._connection is not None
        with self._lock:
            try:
                self._connection.send(request)
                if not self._connection.poll(ANSWER_S):
                    raise TimeoutError("it does not answer")
                answer: messages.Answer = self._connection.recv()
            except (OSError, EOFError) as e:
                self._connection.close()  # what comes after all would be taken for the next answer
                raise LabError(f"the lab's relay has died: {e}") from e
        if isinstance(answer, OSError):
            raise LabError(answer.strerror or str(answer), errno=answer.errno or 0)
        return answer

    # ---- hosts

    def namespace(self, host: str) -> Path:
        """A path that ``nsenter --net=PATH`` and :func:`os.open` take, as long as the lab lasts."""
        if host not in self.wiring.hosts:
            known = ", ".join(self.wiring.hosts)
            raise BadConfig(f"no host {host!r} in the lab; it has {known}", field="host", value=host, expected=known)
        return Path(f"/proc/{self.pid}/fd/{self._begun.networks[self.wiring.hosts.index(host)]}")

    def address(self, host: str) -> str:
        """The host's first address."""
        self.namespace(host)
        found = next((each.address for each in self.wiring.interfaces if each.host == host), None)
        if found is None:
            raise BadConfig(f"{host} is on no medium", field="host", value=host, expected="a host on one")
        return found

    @contextlib.contextmanager
    def inside(self, host: str) -> Iterator[None]:
        """This thread is in the host's namespace: sockets and processes made here are and stay in it."""
        with _opened(self.namespace(host)) as there, _opened(Path("/proc/thread-self/ns/net")) as here:
            kernel.setns(there, kernel.CLONE_NEWNET)
            try:
                yield
            finally:
                kernel.setns(here, kernel.CLONE_NEWNET)

    def popen(self, host: str | None, command: Sequence[str], **options: Any) -> subprocess.Popen[Any]:
        """Start a program in the host's namespace (None: in ours) that ends with the lab; ``options`` are Popen's."""
        env = {**(options.pop("env", None) or os.environ), rundir.VARIABLE: self.sockets(host)}
        options = {"stdin": subprocess.DEVNULL, "start_new_session": True, "env": env, **options}

        def start() -> subprocess.Popen[Any]:
            with _opened(Path(f"/proc/{self.pid}/ns/pid")) as processes:
                kernel.setns(processes, kernel.CLONE_NEWPID)
            if host is None:
                return subprocess.Popen(command, **options)
            with self.inside(host):
                return subprocess.Popen(command, **options)

        started = _in_thread(start)  # of which only its children are in the PID namespace
        self._started = [process for process in self._started if process.poll() is None] + [started]
        return started

    # ---- links

    def state(self, number: int) -> Conditions:
        """What holds in that channel now."""
        return self._conditions[number]

    def set(self, link: str, ask: Ask | None = None, **values: Any) -> None:
        """Change conditions of a link, both ways or one (``a>b``), of a medium, or of ``all``; what is not said stays.

        ``values``: as in a scenario, ``loss=0.2, rate="1M"``.
        """
        wanted = ask or ask_from(values)
        numbers = [number for _, channels in self.wiring.find(link) for number in channels]
        new = {number: conditions(self._conditions[number], wanted) for number in numbers}
        self._ask(messages.Set(new))
        for number, value in new.items():
            self._conditions[number] = value

    def cut(self, link: str) -> None:
        """Nothing crosses any more; what is under way is lost, too. The interfaces stay up."""
        self.set(link, up=False)

    def heal(self, link: str) -> None:
        """Undo :meth:`cut`."""
        self.set(link, up=True)

    def counted(self) -> messages.Counted:
        """All counters at one moment."""
        answer = self._ask(messages.Set())
        assert isinstance(answer, messages.Counted)
        return answer

    def counters(self, link: str) -> list[Counters]:
        """Of each of the link's channels: first the one from ``edge.a`` to ``edge.b``, or only the one asked for."""
        counted = self.counted()
        return [counted.channels[number] for _, channels in self.wiring.find(link) for number in channels]


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[int]:
    fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        yield fd
    finally:
        os.close(fd)


def _in_thread(do: Callable[[], T]) -> T:
    """What ``do`` gives, or raises, in a thread that ends with it."""
    done: list[T] = []
    failed: list[BaseException] = []

    def run() -> None:
        try:
            done.append(do())
        except BaseException as e:
            failed.append(e)

    thread = threading.Thread(target=run, name="zmav-lab")
    thread.start()
    thread.join()
    if failed:
        raise failed[0]
    return done[0]


async def exit_of(process: subprocess.Popen[Any]) -> int:
    """The code a process ends with. Waits without a thread: its descriptor is readable when it has ended."""
    loop, over = asyncio.get_running_loop(), asyncio.Event()
    if process.poll() is None:
        fd = os.pidfd_open(process.pid)
        loop.add_reader(fd, over.set)
        try:
            await over.wait()
        finally:
            loop.remove_reader(fd)
            os.close(fd)
    return process.wait()
