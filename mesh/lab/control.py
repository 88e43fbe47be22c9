"""The lab's end of its control socket: see :mod:`mesh.lab.remote`."""

from __future__ import annotations

import asyncio
import contextlib
import inspect
from collections.abc import Callable
from typing import Any

import msgspec

from mesh.lab.door import serving
from mesh.lab.lab import Lab
from mesh.lab.remote import SOCKET
from mesh.lab.status import status_of
from mesh.lab.values import ask_from
from zmav.errors import BadInput, ZmavError
from zmav.sim.remote import Failure, Reply, Request

_LONGEST_LINE = 1 << 20


class OnLink(msgspec.Struct, forbid_unknown_fields=True):
    """A link by name; see :meth:`mesh.lab.wiring.Wiring.find`."""

    link: str


class SetArgs(OnLink, forbid_unknown_fields=True):
    """And what is to hold on it."""

    conditions: dict[str, Any]


class OnHost(msgspec.Struct, forbid_unknown_fields=True):
    """A host's router, or the simulator, by name."""

    host: str


class Nothing(msgspec.Struct, forbid_unknown_fields=True):
    """No arguments."""


class Room(msgspec.Struct):
    """Where a program of a host's runs, and with what environment."""

    namespace: str
    pid: int
    """of the relay: when it has ended, the lab has"""
    environment: dict[str, str]


class Control:
    """Serves a lab's socket while it is open (``async with``). ``down`` is set when somebody asks the lab to end."""

    def __init__(self, lab: Lab) -> None:
        self._lab = lab
        self.down = asyncio.Event()
        self._offers: dict[str, tuple[type[msgspec.Struct], Callable[[Any], Any]]] = {
            "status": (Nothing, lambda _: status_of(lab)),
            "cut": (OnLink, lambda args: lab.cut(args.link)),
            "heal": (OnLink, lambda args: lab.heal(args.link)),
            "set": (SetArgs, lambda args: lab.network.set(args.link, ask_from(args.conditions))),
            "start": (OnHost, lambda args: lab.start(args.host)),
            "stop": (OnHost, lambda args: lab.stop(args.host)),
            "kill": (OnHost, lambda args: lab.kill(args.host)),
            "room": (OnHost, self._room),
            "down": (Nothing, lambda _: self.down.set()),
        }
        """what can be asked: its arguments, and what does it, at once or to be awaited"""
        self._stack = contextlib.AsyncExitStack()

    async def __aenter__(self) -> Control:
        path = self._lab.directory / SOCKET
        await self._stack.enter_async_context(
            serving(lambda enter: asyncio.start_unix_server(enter, path, limit=_LONGEST_LINE), self._serve)
        )
        path.chmod(0o600)  # and nobody else could get into its directory meanwhile
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._stack.aclose()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while line := await reader.readline():
            writer.write(msgspec.json.encode(await self._answer(line)) + b"\n")
            await writer.drain()

    async def _answer(self, line: bytes) -> Reply:
        try:
            request = msgspec.json.decode(line, type=Request)
            if request.verb not in self._offers:
                known = ", ".join(self._offers)
                raise BadInput(f"no verb {request.verb!r}; there are {known}", field="verb", value=request.verb)
            kind, do = self._offers[request.verb]
            result = do(msgspec.convert(request.args, kind))
            return Reply(result=msgspec.to_builtins(await result if inspect.isawaitable(result) else result))
        except ZmavError as e:
            return Reply(error=Failure(e.code, e.message, e.detail))
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as e:
            return Reply(error=Failure(BadInput.code, f"not a request: {e}"))

    def _room(self, args: OnHost) -> Room:
        network = self._lab.network
        return Room(str(network.namespace(args.host)), network.pid, self._lab.environment(args.host))
