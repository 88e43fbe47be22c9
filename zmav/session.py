"""Open a Zenoh session the way zmav wants it.

Applications are clients of their own host's router over loopback; only routers relay, so only a vehicle's or a ground
host's router process opens a session in router mode. Multicast scouting is off: endpoints are named, and
everything stays on loopback unless told otherwise. Zenoh's own settings can be given on top, as its tools take them.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import re
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec
import zenoh

from zmav.errors import BadConfig, BadInput, SessionError
from zmav.rundir import sockets_to_call
from zmav.trust.credentials import Credentials

DEFAULT_PORT = 7447
DEFAULT_ROUTER = f"tcp/127.0.0.1:{DEFAULT_PORT}"
ANY_PORT = "tcp/127.0.0.1:0"
CONNECT = "ZMAV_CONNECT"
"""environment variable: the routers that clients look for where nothing else is said, between blanks"""
BLOCKED = "transport/link/tx/queue/congestion_control/block/wait_before_close"
"""Zenoh's setting of how long a link that is full may hold up what goes through a router, in µs"""
LARGEST_MESSAGE = 16 << 20
"""bytes that one message may have; Zenoh leaves out what is larger as it comes in"""
LARGEST_PAYLOAD = LARGEST_MESSAGE - 65_536
"""and the payload in it: beside it are the key and the proof of origin"""
PATIENCE = 1.0
"""s for a router to answer a client: it may just be starting"""
RUNTIME = "ZENOH_RUNTIME"
"""environment variable: Zenoh's threads, read once in a process, as its first session is opened"""
CLIENTS_RUNTIME = "(rx: (handover: app), app: (worker_threads: 2))"
"""a client's one link is read by the thread that waits for it: else each message wakes one that only wakes another"""
Mode = Literal["client", "peer", "router"]


class SessionSettings(msgspec.Struct, kw_only=True, frozen=True):
    """What a session is opened with: the options ``-m -e -l -c --cfg`` of the zenoh tools."""

    mode: Mode | None = None
    """None: client, unless ``file`` says otherwise"""
    connect: Sequence[str] = ()
    listen: Sequence[str] = ()
    file: str | None = None
    """a Zenoh configuration file: it goes before zmav's own defaults, and the other settings here go before it"""
    cfg: Sequence[str] = ()
    """``PATH:VALUE`` pairs, VALUE in JSON5, as the zenoh tools take them"""
    credentials: str | None = None
    """folder of the member we are: mutual TLS on ``tls/`` and ``quic/``, and proofs of origin"""
    values: dict[str, Any] = {}
    """Zenoh configuration paths and values that were worked out for a router: they go before zmav's own defaults"""

    def options(self) -> dict[str, Any]:
        """Zenoh configuration paths and values that were asked for here."""
        asked = {
            "mode": self.mode,
            "connect/endpoints": list(self.connect),
            "listen/endpoints": list(self.listen),
        }
        return {path: value for path, value in asked.items() if value}


def defaults(mode: str) -> dict[str, Any]:
    """What zmav sets, by Zenoh configuration path, where neither the settings nor a file say otherwise."""
    values: dict[str, Any] = {
        "mode": mode,
        "connect/endpoints": _routers() if mode == "client" else [],
        "listen/endpoints": [],
        "scouting/multicast/enabled": False,
        "transport/shared_memory/enabled": False,
        "transport/unicast/open_timeout": 1000,
        "transport/unicast/accept_timeout": 1000,
        "transport/link/rx/max_message_size": LARGEST_MESSAGE,
        "transport/link/tx/lease": 1000,
        "transport/link/tx/keep_alive": 4,
    }
    if mode == "client":
        values["connect/timeout_ms"] = 0  # each endpoint once: with a limit, Zenoh spends all of it on the first
    else:
        # A neighbour that is not there yet is no reason to stop: it is tried for ever.
        values["connect/timeout_ms"] = -1
        values["connect/exit_on_failure"] = False
        values["connect/retry"] = {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 1.5}
    if mode == "router":
        # A neighbour that does not read what it asked for holds up everybody's orders for so long, and is then cut off.
        values[BLOCKED] = 200_000
        values["adminspace/enabled"] = True
        values["adminspace/permissions"] = {"read": True, "write": False}
    return values


def _routers() -> list[str]:
    """The host's own router, by its unix socket where there is one that we may use."""
    named = os.environ.get(CONNECT, "").split()
    return named or [*sockets_to_call(DEFAULT_PORT), DEFAULT_ROUTER]


def config(settings: SessionSettings) -> zenoh.Config:
    """The Zenoh configuration of ``settings``; raises :class:`BadConfig` naming the value Zenoh refuses."""
    built = _from_file(settings.file) if settings.file else zenoh.Config()
    in_file = _in_file(built, settings.values)
    given = settings.options()
    values = defaults(settings.mode or json.loads(in_file.get("mode", "null")) or "client")
    if settings.credentials:
        values.update(Credentials.load(settings.credentials).zenoh())
    values.update(settings.values)
    for path, value in {**{p: v for p, v in values.items() if p not in in_file}, **given}.items():
        _insert(built, path, json.dumps(value))
    for pair in settings.cfg:
        path, colon, text = pair.partition(":")
        if not colon:
            raise BadConfig(f"--cfg {pair!r}: expected PATH:VALUE", field="cfg", value=pair, expected="PATH:VALUE")
        try:
            _insert(built, path, text)
        except BadConfig:
            _insert(built, path, json.dumps(text))  # a bare word: the zenoh tools take it for a string
    return built


def sources(settings: SessionSettings) -> dict[str, str]:
    """The Zenoh configuration paths that a person gave a value of, each with how: ``-l``, ``--cfg``, ``-c FILE``.

    Raises what :func:`config` does.
    """
    found: dict[str, str] = {}
    if settings.file:
        found = dict.fromkeys(_in_file(_from_file(settings.file), settings.values), f"-c {settings.file}")
    options = {"mode": "-m", "connect/endpoints": "-e", "listen/endpoints": "-l"}
    found.update({path: options[path] for path in settings.options()})
    found.update({pair.partition(":")[0]: "--cfg" for pair in settings.cfg})
    return found


def check_size(key: str, payload: bytes) -> None:
    """Raise :class:`BadInput` for what no session of ours would take: it would be lost, and nobody told."""
    if len(payload) > LARGEST_PAYLOAD:
        text = f"{key}: {len(payload)} bytes are too much for one message; at most {LARGEST_PAYLOAD} go"
        raise BadInput(text, field="payload", value=len(payload), expected=f"at most {LARGEST_PAYLOAD} bytes")


def is_read(publisher: zenoh.Publisher) -> bool:
    """Somebody subscribes to what it puts, wherever: what nobody does need not be made."""
    status: Any = publisher.matching_status  # a bool, say Zenoh's stubs
    return bool(status.matching)


def _from_file(file: str) -> zenoh.Config:
    try:
        return zenoh.Config.from_file(Path(file))
    except zenoh.ZError as e:
        raise BadConfig(f"cannot read the Zenoh configuration {file!r}: {reason(e)}", field="config", value=file) from e


def _in_file(built: zenoh.Config, more: Iterable[str]) -> dict[str, str]:
    """The JSON of what a file changed, among the values that zmav has a default of and ``more``, by path."""
    untouched = zenoh.Config()
    found = {}
    for path in {**defaults("client"), **defaults("router"), **dict.fromkeys(more)}:
        text = built.get_json(path)
        if text != untouched.get_json(path):
            found[path] = text
    return found


def _insert(built: zenoh.Config, path: str, value: str) -> None:
    try:
        built.insert_json5(path, value)
    except zenoh.ZError as e:
        raise BadConfig(f"Zenoh refuses {path} = {value}: {reason(e)}", field=path, value=value) from e


def open_session(settings: SessionSettings | None = None) -> zenoh.Session:
    """Open a session; close it (``with``) or the process hangs at its exit. Blocks while endpoints are tried.

    Raises :class:`SessionError` that says what to do, where no router answers or a listening port is taken.
    """
    built = config(settings or SessionSettings())
    is_client = json.loads(built.get_json("mode")) == "client"
    give_up = time.monotonic() + (PATIENCE if is_client else 0.0)
    while True:
        try:
            with _runtime(CLIENTS_RUNTIME if is_client else ""):
                return zenoh.open(built)
        except zenoh.ZError as e:
            if time.monotonic() > give_up:
                raise _unopened(built, reason(e)) from e
        time.sleep(0.1)


@contextlib.contextmanager
def _runtime(threads: str) -> Iterator[None]:
    """Have a session that is opened meanwhile find :data:`RUNTIME` so, unless somebody set it. It is not left there:
    processes that we start are none of a client's.
    """
    if not threads or RUNTIME in os.environ:
        yield
        return
    os.environ[RUNTIME] = threads
    try:
        yield
    finally:
        os.environ.pop(RUNTIME, None)


async def open_in_thread(settings: SessionSettings) -> zenoh.Session:
    """As :func:`open_session`, from the event loop; a cancellation waits for its end, and leaves nothing open."""
    opening = asyncio.get_running_loop().run_in_executor(None, open_session, settings)
    try:
        return await asyncio.shield(opening)
    except asyncio.CancelledError:
        opening.add_done_callback(_close_opened)  # a second cancellation waits no longer, but leaves it to this
        await asyncio.wait({opening})
        raise


def _close_opened(opening: asyncio.Future[zenoh.Session]) -> None:
    if not opening.cancelled() and opening.exception() is None:
        opening.result().close()


def reason(error: zenoh.ZError) -> str:
    """Zenoh's words without the places in its sources and without its parser's wrapping."""
    text = re.sub(r" at /\S+\.rs:\d+\.?", "", str(error))
    parser = re.search(r'msg: "(.*?)", location', text)
    return parser[1].rpartition("= ")[2] if parser else text


def another(listen: Sequence[str]) -> str:
    """What one does whose port is taken, by a second 'zmav up' for example. ``listen``: where it was to listen."""
    there = next((endpoint for endpoint in listen if endpoint.startswith("tcp/127.")), DEFAULT_ROUTER)
    return f"choose another with -l; or, where that is a router of this computer, join it: -l {ANY_PORT} -e {there}"


def _unopened(built: zenoh.Config, why: str) -> SessionError:
    """The error for a session that does not open, with what to do about it."""
    mode = json.loads(built.get_json("mode"))
    connect, listen = (json.loads(built.get_json(f"{way}/endpoints")) for way in ("connect", "listen"))
    if mode == "client":
        text = (
            f"no Zenoh router answers at {', '.join(connect)}. Start one ('zmav up' on a vehicle, 'zmav router' on a "
            f"ground station, 'zmav demo' to look around) or name it with -e. ({why})"
        )
    elif "in use" in why.lower() or "os error 98" in why.lower():
        text = f"a port of {', '.join(listen)} is in use by another program: {another(listen)}. ({why})"
    else:
        text = f"cannot open a Zenoh session in {mode} mode: {why}"
    return SessionError(text, endpoints=[*connect, *listen])
