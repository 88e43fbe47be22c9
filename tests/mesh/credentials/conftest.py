"""A fleet's authority, and routers and programs that have its credentials, on loopback."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh
from zenoh import handlers

from mesh.credentials.acl import access_control
from mesh.credentials.ca import Authority
from zmav.config import FleetConfig
from zmav.keys import CHANNELS
from zmav.process import free_port
from zmav.rundir import socket_to_listen
from zmav.session import SessionSettings, open_session
from zmav.trust.certificate import Role

PATIENCE_S = 30.0


class Heard:
    """Keys, in the order in which they came, and waiting for one of them."""

    def __init__(self) -> None:
        self.keys: list[str] = []
        self._changed = threading.Condition()

    def add(self, key: str) -> None:
        with self._changed:
            self.keys.append(key)
            self._changed.notify_all()

    def comes(self, key: str, seconds: float) -> bool:
        """Whether it comes, or has come, within so long."""
        with self._changed:
            return self._changed.wait_for(lambda: key in self.keys, seconds)

    def until(self, key: str) -> set[str]:
        """All that came before ``key``, and it; forgets them."""
        with self._changed:
            assert self._changed.wait_for(lambda: key in self.keys, PATIENCE_S), f"{key} did not come: {self.keys}"
            before = self.keys[: self.keys.index(key)]
            self.keys.clear()
            return set(before)


def direct(call: Callable[[Any], None]) -> Any:
    return handlers.Callback(call, indirect=False)


class Home:
    """A program of the router's own host: it hears what got through the door, and answers what was asked."""

    def __init__(self, session: zenoh.Session) -> None:
        self.session = session
        self.put, self.asked, self.tokens = Heard(), Heard(), Heard()
        wide = dict.fromkeys(c.template.split("/")[1] for c in CHANNELS.values() if "/@" in c.template)
        for space in ("zmav/alpha/**", *(f"zmav/alpha/{chunk}/**" for chunk in wide)):
            # Called in Zenoh's own thread, so that what came first is first.
            session.declare_subscriber(space, direct(lambda sample: self.put.add(str(sample.key_expr))))
            session.liveliness().declare_subscriber(space, direct(lambda sample: self.tokens.add(str(sample.key_expr))))
            session.declare_queryable(space, direct(self._answer))

    def _answer(self, query: zenoh.Query) -> None:
        with query:
            self.asked.add(str(query.key_expr))
            query.reply(query.key_expr, b"home")


class Door:
    """A router with credentials and its rules, and where it listens."""

    def __init__(self, session: zenoh.Session, unix: str, local: str, tls: str, quic: str) -> None:
        self.session, self.unix, self.local, self.tls, self.quic = session, unix, local, tls, quic


class Fleet:
    """``alpha``: one authority, its members by name."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.authority = folder, Authority.create(folder / "ca", "alpha")
        self.first_roster = (folder / "ca" / "roster.json").read_bytes()
        """number 0: of nobody"""
        self.members: dict[str, Path] = {}
        self._stack = contextlib.ExitStack()

    def issue(self, **roles: Role) -> None:
        for name, role in roles.items():
            self.members[name] = self.authority.issue(name, role)

    def rules(self, name: str, file: FleetConfig | None = None) -> dict[str, Any]:
        roster = self.authority.roster().open(self.authority.certificate, "alpha")
        return access_control(file or FleetConfig(fleet="alpha"), "alpha", name, roster)

    def router(self, name: str, *connect: str, file: FleetConfig | None = None, **values: Any) -> Door:
        """Open one: its rules are those of the roster at present."""
        port = free_port(socket.SOCK_STREAM)
        local, unix = f"tcp/127.0.0.1:{port}", socket_to_listen(port)
        assert unix is not None
        tls = f"tls/127.0.0.1:{free_port(socket.SOCK_STREAM)}"
        quic = f"quic/127.0.0.1:{free_port(socket.SOCK_DGRAM)}?mixed_rel=1"
        session = self.open(
            name,
            *connect,
            mode="router",
            listen=[local, unix, tls, quic],
            access_control=self.rules(name, file),
            **values,
        )
        return Door(session, unix, local, tls, quic)

    def open(self, name: str | None, *connect: str, mode: Any = None, listen: Any = (), **values: Any) -> zenoh.Session:
        """A session with that member's credentials, closed at the end of the test."""
        values = {"scouting/delay": 0, **values}
        folder = str(self.members[name]) if name else None
        settings = SessionSettings(mode=mode, connect=connect, listen=listen, credentials=folder, values=values)
        session = open_session(settings)
        self._stack.callback(close, session)
        return session

    def home(self, door: Door) -> Home:
        return Home(self.open(None, door.unix))

    def close(self) -> None:
        self._stack.close()


def close(session: zenoh.Session) -> None:
    with contextlib.suppress(zenoh.ZError):
        session.close()


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Fleet]:
    fleet = Fleet(tmp_path)
    yield fleet
    fleet.close()


@pytest.fixture
def raw_client() -> Iterator[Callable[..., zenoh.Session]]:
    """A Zenoh client that is not ours: ``raw_client(endpoint, **tls)``, with Zenoh's settings of TLS as they are."""
    opened: list[zenoh.Session] = []

    def open_raw(endpoint: str, **tls: Any) -> zenoh.Session:
        built = zenoh.Config()
        settings = {
            "mode": "client",
            "connect/endpoints": [endpoint],
            "scouting/multicast/enabled": False,
            "connect/timeout_ms": 0,
            "transport/unicast/open_timeout": 2000,
            "scouting/delay": 0,
            **{f"transport/link/tls/{name}": value for name, value in tls.items()},
        }
        for path, value in settings.items():
            built.insert_json5(path, json.dumps(value))
        opened.append(zenoh.open(built))
        return opened[-1]

    yield open_raw
    for session in opened:
        close(session)
