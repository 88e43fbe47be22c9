"""Open a Zenoh session the way zmav wants it.

Applications are clients of their own host's router over loopback; only routers relay, so only a vehicle's or a ground
host's router process opens a session in router mode. Multicast scouting is off: endpoints are named, and
everything stays on loopback unless told otherwise. Zenoh's own settings can be given on top, as its tools take them.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec
import zenoh

from zmav.errors import BadConfig, SessionError

DEFAULT_ROUTER = "tcp/127.0.0.1:7447"
Mode = Literal["client", "peer", "router"]


class SessionSettings(msgspec.Struct, kw_only=True, frozen=True):
    """What a session is opened with: the options ``-m -e -l -c --cfg`` of the zenoh tools."""

    mode: Mode = "client"
    connect: Sequence[str] = ()
    listen: Sequence[str] = ()
    file: str | None = None
    """a Zenoh configuration file; what follows is laid over it"""
    cfg: Sequence[str] = ()
    """``PATH:VALUE`` pairs, VALUE in JSON5, as the zenoh tools take them"""

    def values(self) -> dict[str, Any]:
        """Zenoh configuration paths and their values, without ``file`` and ``cfg``."""
        connect = list(self.connect) or ([DEFAULT_ROUTER] if self.mode == "client" else [])
        values: dict[str, Any] = {
            "mode": self.mode,
            "connect/endpoints": connect,
            "listen/endpoints": list(self.listen),
            "scouting/multicast/enabled": False,
            "transport/shared_memory/enabled": False,
            "transport/unicast/open_timeout": 1000,
            "transport/unicast/accept_timeout": 1000,
            "transport/link/tx/lease": 1000,
            "transport/link/tx/keep_alive": 4,
        }
        if self.mode == "client":
            values["connect/timeout_ms"] = 3000
        else:
            # A neighbour that is not there yet is no reason to stop: it is tried for ever.
            values["connect/timeout_ms"] = -1
            values["connect/exit_on_failure"] = False
            values["connect/retry"] = {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 1.5}
        if self.mode == "router":
            values["adminspace/enabled"] = True
            values["adminspace/permissions"] = {"read": True, "write": False}
        return values


def config(settings: SessionSettings) -> zenoh.Config:
    """The Zenoh configuration of ``settings``; raises :class:`BadConfig` naming the value Zenoh refuses."""
    try:
        built = zenoh.Config.from_file(Path(settings.file)) if settings.file else zenoh.Config()
    except zenoh.ZError as e:
        raise BadConfig(
            f"cannot read the Zenoh configuration {settings.file!r}: {reason(e)}", field="config", value=settings.file
        ) from e
    for path, value in settings.values().items():
        _insert(built, path, json.dumps(value))
    for pair in settings.cfg:
        path, colon, text = pair.partition(":")
        if not colon:
            raise BadConfig(f"--cfg {pair!r}: expected PATH:VALUE", field="cfg", value=pair, expected="PATH:VALUE")
        _insert(built, path, text)
    return built


def _insert(built: zenoh.Config, path: str, value: str) -> None:
    try:
        built.insert_json5(path, value)
    except zenoh.ZError as e:
        raise BadConfig(f"Zenoh refuses {path} = {value}: {reason(e)}", field=path, value=value) from e


def open_session(settings: SessionSettings | None = None) -> zenoh.Session:
    """Open a session; close it (``with``) or the process hangs at its exit. Blocks up to about three seconds.

    Raises :class:`SessionError` that says what to do, where no router answers or a listening port is taken.
    """
    settings = settings or SessionSettings()
    built = config(settings)
    try:
        return zenoh.open(built)
    except zenoh.ZError as e:
        raise SessionError(_advice(settings, reason(e)), endpoints=[*settings.connect, *settings.listen]) from e


def reason(error: zenoh.ZError) -> str:
    """Zenoh's words without the places in its sources."""
    return re.sub(r" at \S+\.rs:\d+\.?", "", str(error))


def _advice(settings: SessionSettings, why: str) -> str:
    if settings.mode == "client":
        where = ", ".join(settings.connect) or DEFAULT_ROUTER
        return (
            f"no Zenoh router answers at {where}. Start one ('zmav up' on a vehicle, 'zmav router' on a ground "
            f"station, 'zmav demo' to look around) or name it with -e. ({why})"
        )
    if "in use" in why.lower() or "os error 98" in why.lower():
        ports = ", ".join(settings.listen)
        return f"a listening port of {ports} is in use by another program: choose another with -l. ({why})"
    return f"cannot open a Zenoh session in {settings.mode} mode: {why}"
