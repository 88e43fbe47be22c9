"""A host's router and what runs beside it: measuring neighbours, answering measurements, passing the roster on.

Zenoh takes listeners, scouting, timers and access rules only when a session opens. What makes them out of date (a radio
that has come, a new roster) is told by :meth:`Router.outdated`; who runs the router then starts again when it may.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import socket
import threading
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Protocol, runtime_checkable

import msgspec
import zenoh

from mesh.bearer.bearers import Bearers
from mesh.bench.responder import Responder
from mesh.credentials.rosterwatch import RosterWatch, watch_roster
from mesh.endpoint import host_port
from mesh.plan import RouterPlan, is_rendezvous
from mesh.profiles import PROFILES
from mesh.quality.publisher import link_qualities
from mesh.radios import FoundRadio, Interfaces, interfaces
from mesh.scouting import call_oftener
from zmav import keys
from zmav.errors import SessionError
from zmav.rundir import is_held, path_of
from zmav.services.queries.proven import Answers
from zmav.services.queries.questions import Questions
from zmav.services.status.answers import HostService
from zmav.session import SessionSettings, another, open_in_thread
from zmav.trust.gate import anybody
from zmav.waiting import alongside, in_thread


@contextlib.asynccontextmanager
async def present_host(session: zenoh.Session, plan: RouterPlan) -> AsyncIterator[None]:
    """A part of the router: of a host without a vehicle, whose agent would, it says who it is, by a liveliness token
    that holds its name and Zenoh id, and how its computer is.
    """
    if plan.vehicle:
        yield
        return
    zid = str(session.info.zid())
    key = keys.ALIVE.key(plan.fleet, plan.name, role=keys.ROUTER, sys=0, autopilot="-", uid="-", instance=zid)
    token = session.liveliness().declare_token(key)
    questions = Questions(session, Answers(None, None), anybody)
    HostService(questions, zid, plan.fleet, plan.name)
    try:
        yield
    finally:
        questions.close()
        token.undeclare()


PERIOD_S = 1.0


class RadioWatch:
    """Compares the radios of a plan with what there is, every ``period`` seconds."""

    def __init__(self, plan: RouterPlan, look: Callable[[], Interfaces] = interfaces, period: float = PERIOD_S) -> None:
        self._plan, self._radios, self._look, self._period = plan, plan.radios, look, period
        self._scouts = PROFILES[plan.profile].scouting and plan.host.neighbours is None
        self._gone: set[FoundRadio] = set()

    async def outdated(self) -> str:
        """Return when the plan is out of date, with the reason."""
        while True:
            await asyncio.sleep(self._period)
            with contextlib.suppress(OSError, ValueError):  # the system does not say now: it may the next time
                why = self.compare(await asyncio.to_thread(self._look))
                if why:
                    return why

    def compare(self, there: Interfaces) -> str | None:
        """What makes the plan out of date, in words.

        A listener on a known address comes up by itself, and lives through the address's and the interface's absence.
        Not so an address that was not known. Multicast lives through an address that goes and comes back (4 s without,
        linked again 4 s later), but not through an interface that does: to the kernel it is another one.
        """
        return next(filter(None, (self._judge(radio, there) for radio in self._radios)), None)

    def _judge(self, radio: FoundRadio, there: Interfaces) -> str | None:
        interface = radio.radio.interface
        if interface is not None and interface not in there:
            self._gone.add(radio)
            return None
        if radio.fixed and radio.address:
            wanted = radio.address.ip
            here = any(address.ip == wanted for addresses in there.values() for address in addresses)
            late = radio in self._gone or not radio.present
            return f"{radio.name} has come" if here and late and self._scouts else None
        addresses = [str(address.ip) for address in there.get(radio.name, ())]
        if not addresses or not self._matters(addresses):
            return None
        if radio.address is None:
            return f"{radio.name} has come, with {addresses[0]}"
        if str(radio.address.ip) not in addresses:
            return f"{radio.name} has now {addresses[0]}"
        return f"{radio.name} has come back" if radio in self._gone and self._scouts else None

    def _matters(self, addresses: list[str]) -> bool:
        """In the cloud a host calls from whatever address its modem was given; only a rendezvous is called at one."""
        listens = PROFILES[self._plan.profile].listens or self._plan.host.neighbours is not None
        return listens or any(is_rendezvous(self._plan, address) for address in addresses)


@contextlib.asynccontextmanager
async def watch_radios(session: zenoh.Session, plan: RouterPlan) -> AsyncIterator[object]:
    """A part of the router; there is nothing to watch where the fleet file names no radio."""
    yield RadioWatch(plan) if plan.radios else None


Part = Callable[[zenoh.Session, RouterPlan], contextlib.AbstractAsyncContextManager[object]]
"""Something that runs beside the router as long as it does"""
PARTS: tuple[Part, ...] = (present_host, watch_radios, call_oftener, watch_roster, link_qualities, Responder)
CLOSING_S = 1.0
"""how long a session's close is waited for: Zenoh 1.10 spends ten seconds on neighbours that it was calling in vain"""
log = logging.getLogger(__name__)


@runtime_checkable
class Watch(Protocol):
    """What a part may give: it sees when the router's settings are out of date."""

    async def outdated(self) -> str:
        """Return when they are, with the reason in words."""


class Router:
    """``async with Router(plan, settings) as router: router.session``; the session closes with it.

    Raises what :func:`zmav.session.open_session` does.
    """

    def __init__(self, plan: RouterPlan, settings: SessionSettings, parts: tuple[Part, ...] = PARTS) -> None:
        self.plan, self._settings, self._parts = plan, settings, parts
        self.bearers = Bearers(plan)
        self._stack = contextlib.AsyncExitStack()
        self._session: zenoh.Session | None = None
        self._watches: list[Watch] = []
        self.running: list[object] = []
        """what the parts gave"""

    @property
    def session(self) -> zenoh.Session:
        if self._session is None:
            raise RuntimeError("the router is not open: use 'async with'")
        return self._session

    async def outdated(self) -> str:
        """Return, with the reason in words, when the router should be opened again with a new plan."""
        if not self._watches:
            await asyncio.Event().wait()
        async with alongside(*(watch.outdated() for watch in self._watches)) as tasks:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            why: str = next(iter(done)).result()
            return why

    async def __aenter__(self) -> Router:
        if self.plan.value("listen/timeout_ms") == -1:
            _check_free(self.plan)
        async with contextlib.AsyncExitStack() as stack:
            await stack.enter_async_context(self.bearers)
            settings, sockets = _with_sockets(self.plan, self.bearers.session(self._settings))
            session = self._session = await open_in_thread(settings)
            stack.push_async_callback(in_thread, _close, session)
            for path in sockets:
                if path.exists():  # where Zenoh tries listeners again it may come later, for its owner alone
                    path.chmod(0o660)  # who may enter the folder may use it
            for part in self._parts:
                entered = await stack.enter_async_context(part(session, self.plan))
                self.running.append(entered)
                if isinstance(entered, Watch):
                    self._watches.append(entered)
            for watch in self.running:
                for each in self.running:
                    if isinstance(watch, RosterWatch) and isinstance(each, Responder):
                        watch.tell(each.take_roster)
            self._stack = stack.pop_all()
        return self

    async def __aexit__(self, *_: object) -> None:
        self._session = None
        await self._stack.aclose()


def _close(session: zenoh.Session) -> None:
    """Close it; where that takes long, go on: the thread is a daemon's, and the process may end without it."""

    def close() -> None:
        try:
            session.close()
        except zenoh.ZError as e:
            log.debug("closing the router's session: %s", e)

    thread = threading.Thread(target=close, name="close", daemon=True)
    thread.start()
    thread.join(CLOSING_S)


def _with_sockets(plan: RouterPlan, settings: SessionSettings) -> tuple[SessionSettings, list[Path]]:
    """Make the folders of the unix sockets that it listens on; without those that another process holds: what flies
    something does not stay away for the sake of a second router's door.
    """
    sockets = [(each, path) for each in plan.listens if (path := path_of(each)) is not None]
    held = [each for each, path in sockets if is_held(path)]
    for each in held:
        log.warning("%s is another router's: programs of this computer come in by TCP", each)
    if held:
        listen = [each for each in plan.listens if each not in held]
        settings = msgspec.structs.replace(settings, values={**settings.values, "listen/endpoints": listen})
    for _, path in sockets:
        path.parent.mkdir(mode=0o750, exist_ok=True)
    return settings, [path for each, path in sockets if each not in held]


def _check_free(plan: RouterPlan) -> None:
    """Where Zenoh waits for listeners that cannot open, one whose port another program holds would say nothing.

    Raises :class:`SessionError` for a port in use; an address that is not there is no fault here.
    """
    for endpoint in plan.value("listen/endpoints") or ():
        if path_of(str(endpoint)) is not None:
            continue
        address, port = host_port(str(endpoint))
        kind = socket.SOCK_STREAM if str(endpoint).startswith(("tcp/", "tls/")) else socket.SOCK_DGRAM
        with socket.socket(socket.AF_INET6 if ":" in address else socket.AF_INET, kind) as probe:
            if kind == socket.SOCK_STREAM:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # a former router's is no other program's
            try:
                probe.bind((address, int(port)))
            except OSError as e:
                if e.errno == errno.EADDRINUSE:
                    text = f"a port of {endpoint} is in use by another program: {another([endpoint])}"
                    raise SessionError(text, endpoints=[endpoint]) from e
            except (ValueError, OverflowError):
                continue  # no plain port: Zenoh says what is wrong with it
