"""Talking to a running simulator by its control socket: ``zmav sim pause`` and its like do, and so may scripts.

with Remote() as sim:
    sim.pause()
    sim.step(2.5)
    print(sim.status().vehicles[0].mode)

The socket is a Unix socket that only its owner may open, one for each simulator, in a directory of the user's own. It
takes JSON, one request a line: ``{"verb": "speed", "args": {"times": 4}}``. Each is answered in turn by one line:
``{"result": ...}``, or ``{"error": {"code": ..., "message": ..., "detail": {...}}}`` with a code of :mod:`zmav.errors`.
"""

from __future__ import annotations

import contextlib
import os
import socket
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from zmav.errors import BadConfig, LinkDown, TimedOut, from_code
from zmav.process import own_directory
from zmav.sim.faults import FaultStatus
from zmav.sim.status import WorldStatus

T = TypeVar("T")
C = TypeVar("C", bound="ControlClient")

SUFFIX = ".sock"
LONGEST_PATH = 107  # bytes of a Unix socket's address
CONNECT_S = 2.0


class Request(msgspec.Struct, forbid_unknown_fields=True):
    """One line to the simulator."""

    verb: str
    args: dict[str, Any] = {}


class Failure(msgspec.Struct):
    """Why a request was not done, with a code of :mod:`zmav.errors`."""

    code: str
    message: str
    detail: dict[str, Any] = {}


class Reply(msgspec.Struct, omit_defaults=True):
    """One line from the simulator: a result, or why there is none."""

    result: Any = None
    error: Failure | None = None


def control_directory() -> Path:
    """Where this user's simulators have their control sockets; raises :class:`BadConfig` where nobody should."""
    return own_directory("zmav-sim", "give --control PATH")


def control_path(text: str | None = None) -> Path:
    """The control socket called ``text``: a path, or a name in :func:`control_directory` (None: this process's own)."""
    if text == "":
        raise BadConfig("an empty control socket", field="control", value=text, expected="a path or a name")
    name = f"{os.getpid()}" if text is None else text
    path = Path(name) if "/" in name else control_directory() / f"{name}{SUFFIX}"
    if len(os.fsencode(path)) > LONGEST_PATH:
        raise BadConfig(
            f"the control socket's path {path} is too long; give a shorter --control PATH",
            field="control",
            value=str(path),
            expected=f"at most {LONGEST_PATH} bytes",
        )
    return path


def answers(path: Path) -> bool:
    """Whether a simulator listens there."""
    with socket.socket(socket.AF_UNIX) as probe:
        probe.settimeout(CONNECT_S)
        try:
            probe.connect(str(path))
        except OSError:
            return False
        return True


def running() -> list[Path]:
    """The control sockets of this user's simulators that run now, but for those at paths of their own."""
    return [path for path in sorted(control_directory().glob(f"*{SUFFIX}")) if answers(path)]


class ControlClient:
    """A connection to a control socket; ``what`` is at the other end, in words. It has no lock of its own: use one for
    each thread. Raises :class:`OSError` where nobody listens.
    """

    def __init__(self, path: Path, what: str, timeout: float) -> None:
        self.path, self._what, self._timeout = path, what, timeout
        self._socket = socket.socket(socket.AF_UNIX)
        self._rest = b""
        try:
            self._socket.settimeout(CONNECT_S)
            self._socket.connect(str(path))
        except OSError:
            self._socket.close()
            raise

    def __enter__(self: C) -> C:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def close(self) -> None:
        self._socket.close()

    def call(self, verb: str, *, timeout: float | None = None, **args: Any) -> Any:
        """Have the other end do ``verb``; gives its answer as JSON has it, and raises what it says,
        :class:`TimedOut` where it does not answer in time, and :class:`LinkDown` when it ends.
        """
        wait = self._timeout if timeout is None else timeout
        try:
            self._socket.settimeout(wait)
            self._socket.sendall(msgspec.json.encode(Request(verb, args)) + b"\n")
            reply = msgspec.json.decode(self._line(), type=Reply)
        except TimeoutError:
            self.close()  # what comes after all would be taken for the next answer
            raise TimedOut(f"{self._what} did not answer {verb!r} within {wait:g} s") from None
        except OSError as e:
            raise LinkDown(f"{self._what} has ended: {e.strerror or e}") from e
        if reply.error is not None:
            raise from_code(reply.error.code, reply.error.message, reply.error.detail)
        return reply.result

    def _line(self) -> bytes:
        while b"\n" not in self._rest:
            data = self._socket.recv(65536)
            if not data:
                raise LinkDown(f"{self._what} has ended")
            self._rest += data
        line, _, self._rest = self._rest.partition(b"\n")
        return line


class Remote(ControlClient):
    """A connection to the simulator whose control socket is ``control``, a path or a name (None: the only one that
    runs). It has no lock of its own: use one for each thread.

    Raises :class:`LinkDown` where none runs, :class:`BadConfig` where there are several to choose from. Every method
    raises what the simulator says, :class:`TimedOut` where it does not answer within ``timeout`` seconds, and
    :class:`LinkDown` when it ends.
    """

    def __init__(self, control: str | Path | None = None, *, timeout: float = 10.0) -> None:
        path = _choose(control)
        try:
            super().__init__(path, f"the simulator at {path}", timeout)
        except OSError as e:
            raise LinkDown(f"no simulator listens at {path}: start one with 'zmav sim'") from e

    # ---- what every simulator can be asked

    def status(self) -> WorldStatus:
        """The world and its vehicles."""
        return self._asked(WorldStatus, "status")

    def pause(self) -> WorldStatus:
        """Stand still between two ticks."""
        return self._asked(WorldStatus, "pause")

    def resume(self) -> WorldStatus:
        """Go on after a pause."""
        return self._asked(WorldStatus, "resume")

    def speed(self, times: float) -> WorldStatus:
        """Go on at ``times`` real time; 0: as fast as it goes."""
        return self._asked(WorldStatus, "speed", times=times)

    def step(self, seconds: float, *, timeout: float = 3600.0) -> WorldStatus:
        """Go on for so many simulated seconds and pause then; returns when they are over."""
        return self._asked(WorldStatus, "step", timeout=timeout, seconds=seconds)

    def fault(
        self, vehicle: str, kind: str, *, for_s: float | None = None, **parameters: float | str
    ) -> list[FaultStatus]:
        """Let something go wrong with a vehicle, or with "all": see :meth:`zmav.sim.World.fault`."""
        return self._asked(list[FaultStatus], "fault", vehicle=vehicle, kind=kind, for_s=for_s, parameters=parameters)

    def pilot(self, vehicle: str, mode: str | None = None, channels: dict[int, int] | None = None) -> WorldStatus:
        """The pilot turns the mode switch, or sets channels to pulse widths in us."""
        return self._asked(WorldStatus, "pilot", vehicle=vehicle, mode=mode, channels=channels or {})

    def clear(self, vehicle: str | None = None, kind: str | None = None) -> int:
        """End all faults, or those of one vehicle, of one kind, or of both; gives how many."""
        return self._asked(int, "clear", vehicle=vehicle, kind=kind)

    def faults(self) -> list[FaultStatus]:
        """The faults that are on."""
        return self._asked(list[FaultStatus], "faults")

    def stop(self) -> None:
        """End the simulator."""
        with contextlib.suppress(LinkDown):  # it may end before it answers
            self.call("stop")

    def _asked(self, result: type[T], verb: str, /, *, timeout: float | None = None, **args: Any) -> T:
        return msgspec.convert(self.call(verb, timeout=timeout, **args), result)


def _choose(control: str | Path | None) -> Path:
    if control is not None:
        return control if isinstance(control, Path) else control_path(control)
    found = running()
    if not found:
        raise LinkDown("no simulator runs: start one with 'zmav sim', or name its socket with --control")
    if len(found) > 1:
        names = ", ".join(path.stem for path in found)
        raise BadConfig(
            f"several simulators run: say which with --control ({names})", field="control", value=None, expected=names
        )
    return found[0]
