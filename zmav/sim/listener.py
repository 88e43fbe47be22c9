"""The simulator's end of its control socket: what it can be asked, and who answers; see :mod:`zmav.sim.remote`.

Every connection has a thread of its own, in which requests are answered in turn. All that a world is asked here any
thread may.
"""

from __future__ import annotations

import contextlib
import fcntl
import inspect
import math
import os
import socket
import stat
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path
from socketserver import StreamRequestHandler, ThreadingMixIn, UnixStreamServer
from typing import Any, get_type_hints

import msgspec

from zmav.errors import BadConfig, BadInput, PortInUse, ZmavError
from zmav.sim.faults import FaultStatus, make_fault
from zmav.sim.remote import Failure, Reply, Request, answers
from zmav.sim.status import WorldStatus
from zmav.sim.world import World

LONGEST_LINE = 1 << 20


class Requests:
    """What a simulator can be asked: each public method by its name, with its parameters as arguments. One that needs
    time gives a future.
    """

    def __init__(self, world: World) -> None:
        self._world = world

    def status(self) -> WorldStatus:
        return self._world.status()

    def pause(self) -> WorldStatus:
        self._world.pause()
        return self._world.status()

    def resume(self) -> WorldStatus:
        self._world.resume()
        return self._world.status()

    def speed(self, times: float) -> WorldStatus:
        """``times`` real time; 0: as fast as it goes."""
        self._world.set_speed(times if times != 0.0 else math.inf)
        return self._world.status()

    def step(self, seconds: float) -> Future[WorldStatus]:
        return self._world.advance(seconds)

    def stop(self) -> None:
        self._world.stop()

    def fault(
        self, vehicle: str, kind: str, for_s: float | None = None, parameters: dict[str, Any] | None = None
    ) -> list[FaultStatus]:
        return self._world.put_fault(vehicle, make_fault(kind, parameters or {}), for_s)

    def clear(self, vehicle: str | None = None, kind: str | None = None) -> int:
        return self._world.clear(vehicle, kind)

    def faults(self) -> list[FaultStatus]:
        return self._world.faults()

    def pilot(self, vehicle: str, mode: str | None = None, channels: dict[int, int] | None = None) -> WorldStatus:
        self._world.take(vehicle, mode, channels or {})
        return self._world.status()


VERBS = tuple(name for name in vars(Requests) if not name.startswith("_"))


def _arguments(method: Callable[..., Any]) -> type[msgspec.Struct]:
    """What a request has to give, strictly."""
    hints, empty = get_type_hints(method), inspect.Parameter.empty
    fields = [
        (p.name, hints[p.name]) if p.default is empty else (p.name, hints[p.name], p.default)
        for p in inspect.signature(method).parameters.values()
    ]
    return msgspec.defstruct(method.__name__, fields, forbid_unknown_fields=True)


class Listener:
    """Listens at ``path`` for its owner alone, until :meth:`close`.

    What an ended simulator left at ``path`` is replaced. Raises :class:`PortInUse` where another one listens there,
    :class:`BadConfig` where something else stands, or nothing can be made.
    """

    def __init__(self, path: Path, world: World) -> None:
        self.path = path
        self._server = _Server(str(path), _Caller, bind_and_activate=False)
        self._server.requests = Requests(world)
        try:
            # The mode of the socket's file: set before there is one, so that there is no moment when others may.
            os.fchmod(self._server.fileno(), 0o600)
            with _alone_in(path.parent):
                _make_room(path)
                self._server.server_bind()
                self._server.server_activate()
                self._made = _identity(path)
        except OSError as e:
            self._server.server_close()
            raise BadConfig(
                f"no control socket at {path}: {e.strerror or e}",
                field="control",
                value=str(path),
                expected="a path in a directory that is there and may be written to",
            ) from e
        except ZmavError:
            self._server.server_close()
            raise
        self._thread = threading.Thread(target=self._server.serve_forever, name="zmav-sim-control", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End all connections and remove the socket's file, unless it is another's by now."""
        self._server.shutdown()
        self._thread.join()
        with contextlib.suppress(OSError), _alone_in(self.path.parent):
            if _identity(self.path) == self._made:
                self.path.unlink()
        self._server.server_close()
        for connection in list(self._server.connections):
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)


class _Server(ThreadingMixIn, UnixStreamServer):
    daemon_threads = True
    block_on_close = False
    request_queue_size = 128  # who cannot connect takes the simulator for dead
    requests: Requests

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.connections: set[socket.socket] = set()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A caller that vanishes is nobody's error."""


class _Caller(StreamRequestHandler):
    server: _Server

    def handle(self) -> None:
        self.server.connections.add(self.connection)
        try:
            while line := self.rfile.readline(LONGEST_LINE):
                if not line.endswith(b"\n"):
                    return  # too long, or cut off
                if line.strip():
                    self.wfile.write(msgspec.json.encode(self._answer(line)) + b"\n")
        finally:
            self.server.connections.discard(self.connection)

    def _answer(self, line: bytes) -> Reply:
        """A defect in doing a request is an answer, too, and no end of the world."""
        try:
            result = self._do(line)
            return Reply(result.result() if isinstance(result, Future) else result)
        except ZmavError as e:
            error = e
        except Exception as e:
            error = ZmavError(f"a defect of the simulator: {e!r}")
        return Reply(error=Failure(error.code, error.message, {k: str(v) for k, v in error.detail.items()}))

    def _do(self, line: bytes) -> Any:
        try:
            request = msgspec.json.decode(line, type=Request)
            if request.verb not in VERBS:
                known = ", ".join(VERBS)
                text = f"no request {request.verb!r}; there are {known}"
                raise BadInput(text, field="verb", value=request.verb, expected=known)
            method = getattr(self.server.requests, request.verb)
            found = msgspec.convert(request.args, _arguments(method), str_keys=True)
        except msgspec.ValidationError as e:
            raise BadInput(str(e), field="args", value=line.decode(errors="replace")[:200], expected=str(e)) from e
        except msgspec.DecodeError as e:
            raise BadInput(f"not a JSON request: {e}", field="request", expected="one JSON object a line") from e
        return method(**msgspec.structs.asdict(found))


@contextlib.contextmanager
def _alone_in(directory: Path) -> Iterator[None]:
    """While it lasts no other simulator makes or removes a control socket in ``directory``."""
    descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _make_room(path: Path) -> None:
    """Remove what a simulator that was killed left at ``path``."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(mode):
        raise BadConfig(f"{path} is there, and is no socket", field="control", value=str(path), expected="a free path")
    if answers(path):
        raise PortInUse(f"another simulator has the control socket {path}; give another --control", path=str(path))
    path.unlink()


def _identity(path: Path) -> tuple[int, int]:
    found = path.lstat()
    return found.st_dev, found.st_ino
