"""The simulator's end of its control socket: takes requests in the world's thread and answers them; see
:mod:`zmav.sim.remote`.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import selectors
import socket
import stat
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from zmav.errors import BadConfig, BadInput, PortInUse, ZmavError
from zmav.sim.remote import Failure, Reply, Request, answers

LONGEST_LINE = 1 << 20
MOST_UNREAD = 1 << 20  # bytes of answers that nobody has read: no more is done for such a caller


class Offer(NamedTuple):
    """What a simulator can be asked: the type of its arguments and the function that takes them. A function that
    needs time gives a future, which is set in the world's thread.
    """

    args: type[msgspec.Struct]
    do: Callable[[Any], Any]


class Listener:
    """Listens at ``path`` for its owner alone; ``selector`` calls it in the world's thread.

    What an ended simulator left at ``path`` is replaced. Raises :class:`PortInUse` where another one listens there,
    :class:`BadConfig` where something else stands, or nothing can be made.
    """

    def __init__(self, path: Path, selector: selectors.BaseSelector, offers: Mapping[str, Offer]) -> None:
        self.path = path
        self._selector = selector
        self._offers = offers
        self._callers: list[Caller] = []
        self._socket = socket.socket(socket.AF_UNIX)
        try:
            self._socket.setblocking(False)
            # The mode of the socket's file: set before there is one, so that there is no moment when others may.
            os.fchmod(self._socket.fileno(), 0o600)
            with _alone_in(path.parent):
                _make_room(path)
                self._socket.bind(str(path))
                self._socket.listen()
                self._made = _identity(path)
        except OSError as e:
            self._socket.close()
            raise BadConfig(
                f"no control socket at {path}: {e.strerror or e}",
                field="control",
                value=str(path),
                expected="a path in a directory that is there and may be written to",
            ) from e
        except ZmavError:
            self._socket.close()
            raise
        selector.register(self._socket, selectors.EVENT_READ, self._accept)

    def _accept(self) -> None:
        with contextlib.suppress(OSError):  # it left before it was let in
            connection, _ = self._socket.accept()
            self._callers.append(Caller(connection, self._selector, self._offers, self._callers.remove))

    def close(self) -> None:
        """End all connections and remove the socket's file, unless it is another's by now."""
        for caller in list(self._callers):
            caller.close()
        self._selector.unregister(self._socket)
        with contextlib.suppress(OSError), _alone_in(self.path.parent):
            if _identity(self.path) == self._made:
                self.path.unlink()
        self._socket.close()


class Caller:
    """One connection: requests are answered in turn."""

    def __init__(
        self,
        connection: socket.socket,
        selector: selectors.BaseSelector,
        offers: Mapping[str, Offer],
        gone: Callable[[Caller], None],
    ) -> None:
        self._socket = connection
        self._selector = selector
        self._offers = offers
        self._gone = gone
        self._in, self._out = bytearray(), b""
        self._busy = False
        self._open = True
        connection.setblocking(False)
        selector.register(connection, selectors.EVENT_READ, self._ready)

    @property
    def _deaf(self) -> bool:
        return len(self._out) >= MOST_UNREAD

    def _ready(self) -> None:
        self._flush()
        if not self._open or self._deaf:
            return
        try:
            data = self._socket.recv(65536)
        except BlockingIOError:
            data = None
        except OSError:
            data = b""
        if data == b"" or len(self._in) > LONGEST_LINE:
            self.close()
            return
        self._in += data or b""
        self._next()

    def _next(self) -> None:
        while self._open and not self._busy and not self._deaf:
            end = self._in.find(b"\n")
            if end < 0:
                return
            line = bytes(self._in[:end])
            del self._in[: end + 1]  # which moves nothing, however much waits behind it
            if line.strip():
                self._take(line)

    def _take(self, line: bytes) -> None:
        try:
            result = self._do(line)
        except ZmavError as e:
            self._answer(_refusal(e))
            return
        if isinstance(result, Future):
            self._busy = True
            result.add_done_callback(self._later)
        else:
            self._answer(Reply(result))

    def _do(self, line: bytes) -> Any:
        """Do one request; a defect in doing it is an answer, too, and no end of the world."""
        try:
            request = msgspec.json.decode(line, type=Request)
            offer = self._offers.get(request.verb)
            if offer is None:
                known = ", ".join(sorted(self._offers))
                text = f"no request {request.verb!r}; there are {known}"
                raise BadInput(text, field="verb", value=request.verb, expected=known)
            return offer.do(msgspec.convert(request.args, offer.args, str_keys=True))
        except msgspec.ValidationError as e:
            raise BadInput(str(e), field="args", value=line.decode(errors="replace")[:200], expected=str(e)) from e
        except msgspec.DecodeError as e:
            raise BadInput(f"not a JSON request: {e}", field="request", expected="one JSON object a line") from e
        except ZmavError:
            raise
        except Exception as e:
            raise ZmavError(f"a defect of the simulator: {e!r}") from e

    def _later(self, future: Future[Any]) -> None:
        error = future.exception()
        refused = error if isinstance(error, ZmavError) else ZmavError(f"a defect of the simulator: {error!r}")
        self._busy = False
        self._answer(Reply(future.result()) if error is None else _refusal(refused))
        self._next()

    def _answer(self, reply: Reply) -> None:
        if self._open:
            self._out += msgspec.json.encode(reply) + b"\n"
            self._flush()

    def _flush(self) -> None:
        """Send what the other end takes; the rest when it reads again."""
        try:
            while self._open and self._out:
                self._out = self._out[self._socket.send(self._out) :]
        except BlockingIOError:
            self._watch(selectors.EVENT_WRITE | (0 if self._deaf else selectors.EVENT_READ))
        except OSError:
            self.close()
        else:
            if self._open:
                self._watch(selectors.EVENT_READ)

    def _watch(self, events: int) -> None:
        if self._selector.get_key(self._socket).events != events:
            self._selector.modify(self._socket, events, self._ready)

    def close(self) -> None:
        if self._open:
            self._open = False
            self._selector.unregister(self._socket)
            self._socket.close()
            self._gone(self)


def _refusal(error: ZmavError) -> Reply:
    return Reply(error=Failure(error.code, error.message, {k: str(v) for k, v in error.detail.items()}))


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
