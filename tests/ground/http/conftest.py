"""A gateway in a thread of its own, on a port of its own, behind a router into which tests put what vehicles say."""

from __future__ import annotations

import asyncio
import http.client
import json
import threading
import time
import urllib.parse
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from typing import Any, NamedTuple, TypeVar

import pytest
import pytest_asyncio
import zenoh
from starlette.applications import Starlette
from starlette.routing import Route, WebSocketRoute

import zmav
from ground.http.app import make_app
from ground.http.gateway import Gateway
from ground.http.guard import Rules
from ground.http.server import Patience, bound, serving
from tests.conftest import endpoint_of, matched
from tests.ground.http.browser import CHROMIUM, Chromium, FakePlanner, Fleet, Tab, chromium
from zmav import keys, wire
from zmav.mavlink import encode, load_dialect
from zmav.session import SessionSettings, open_session

PATIENCE_S = 30.0
FLEET = "demo"
T = TypeVar("T")


class Reply(NamedTuple):
    status: int
    headers: dict[str, str]
    body: bytes

    @property
    def text(self) -> str:
        return self.body.decode()

    @property
    def json(self) -> Any:
        return json.loads(self.body)


class Served:
    """A running gateway: requests from outside by :meth:`get` and its like, its inside by ``gateway`` and :meth:`call`.

    ``session`` is the router's, beside which tests play vehicles: :meth:`vehicle`, :meth:`hear`, and ``tx`` (the frames
    put to vehicles, as (key, bytes)).
    """

    def __init__(self, session: zenoh.Session, endpoint: str, rules: Rules | None, **how: Any) -> None:
        self.session, self.endpoint = session, endpoint
        self._rules, self._how = rules, how
        self._ready = threading.Event()
        self._failed: BaseException | None = None
        self._seq = 0
        self._tokens: list[zenoh.LivelinessToken] = []  # a token lasts no longer than the object
        self.tx: list[tuple[str, bytes]] = []
        self._tx_news = threading.Condition()
        session.declare_subscriber("zmav/*/*/mav/tx/**", self._on_tx)
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), daemon=True)
        self._thread.start()
        assert self._ready.wait(PATIENCE_S)
        if self._failed is not None:
            raise self._failed

    async def _serve(self) -> None:
        self.loop, self._stop = asyncio.get_running_loop(), asyncio.Event()
        stalled, patience = self._how.pop("stalled", 20.0), self._how.pop("patience", Patience())
        settings = SessionSettings(connect=[self.endpoint], credentials=self._how.pop("credentials", None))
        try:
            async with (
                zmav.open(fleet=FLEET, settings=settings) as client,
                Gateway(client, bool(self._rules and self._rules.read_only), **self._how) as self.gateway,
                serving(self._make_app(), bound("127.0.0.1", 0, stalled), patience) as self.port,
            ):
                self._ready.set()
                await self._stop.wait()
        except BaseException as e:
            self._failed = e
            raise
        finally:
            self._ready.set()

    def _make_app(self) -> Starlette:
        self.app = make_app(self.gateway, self._rules)
        return self.app

    def face(self, path: str) -> Any:
        """The object that answers on a route's path, or whose method does."""
        routes = [route for route in self.app.routes if isinstance(route, (Route, WebSocketRoute))]
        endpoint = next(route.endpoint for route in routes if route.path == path)
        return getattr(endpoint, "__self__", endpoint)

    def close(self) -> None:
        if not self.loop.is_closed():
            self.loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(PATIENCE_S)
        assert not self._thread.is_alive()

    def call(self, coroutine: Coroutine[Any, Any, T]) -> T:
        """Run a coroutine on the gateway's loop."""
        return asyncio.run_coroutine_threadsafe(coroutine, self.loop).result(PATIENCE_S)

    def until(self, true: Callable[[], bool], what: str) -> None:
        """Wait until something inside holds; looked at on the gateway's loop."""

        async def look() -> None:
            while not true():
                await asyncio.sleep(0.01)

        async def wait() -> None:
            await asyncio.wait_for(look(), PATIENCE_S)

        try:
            self.call(wait())
        except asyncio.TimeoutError:
            raise AssertionError(f"no {what}") from None

    # As a client.

    def request(self, method: str, path: str, body: bytes | str | None = None, **headers: str) -> Reply:
        """One request; headers' names with ``_`` for ``-``."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE_S)
        try:
            data = body.encode() if isinstance(body, str) else body
            connection.request(method, path, data, {name.replace("_", "-"): text for name, text in headers.items()})
            answer = connection.getresponse()
            return Reply(answer.status, {n.lower(): v for n, v in answer.getheaders()}, answer.read())
        finally:
            connection.close()

    def get(self, path: str, /, **query: Any) -> Reply:
        return self.request("GET", path + ("?" + urllib.parse.urlencode(query) if query else ""))

    def post(self, path: str, body: Any = b"", **headers: str) -> Reply:
        data = body if isinstance(body, (bytes, str)) else json.dumps(body)
        return self.request("POST", path, data, **headers)

    # As the fleet.

    def vehicle(self, name: str, sysid: int = 1, present: bool = True, **more: Any) -> None:
        """Let a vehicle be there: its token (if ``present``) and its state, which are heard when this returns."""
        about = {"role": "vehicle", "sys": sysid, "autopilot": "ardupilot", "uid": "none", "instance": f"{name}1"}
        if present:
            self._tokens.append(self.session.liveliness().declare_token(keys.ALIVE.key(FLEET, name, **about)))
        state = wire.VehicleState(
            t=time.time(),
            fleet=FLEET,
            name=name,
            instance=f"{name}1",
            connected=True,
            sysid=sysid,
            compid=1,
            autopilot="ardupilot",
            kind="copter",
            mode="GUIDED",
            armed=False,
            **more,
        )
        key = keys.STATE.key(FLEET, name)
        self.linked(key)
        self.session.put(key, wire.encode(state))
        self.until(lambda: (s := self.gateway.client.vehicle(name).last_state) is not None and s.t == state.t, name)

    def hear(self, message: str, vehicle: str = "quad1", sysid: int = 1, compid: int = 1, **fields: Any) -> bytes:
        """Put a vehicle's message, which the gateway has kept when this returns; gives the frame."""
        self._seq = (self._seq + 1) & 0xFF
        frame = encode(load_dialect(), message, fields, sysid=sysid, compid=compid, seq=self._seq)
        self.hear_raw(keys.RX.key(FLEET, vehicle, sys=sysid, comp=compid, msg=message), frame)
        return frame

    def hear_raw(self, key: str, frame: bytes) -> None:
        self.linked(key)
        before = kept.counter if (kept := self.gateway.last(key)) is not None else 0
        self.session.put(key, frame)
        self.until(lambda: (kept := self.gateway.last(key)) is not None and kept.counter > before, key)

    def linked(self, key: str) -> None:
        """Wait until the router knows that somebody subscribes to ``key``."""
        matched(self.session.declare_publisher(key))

    def sent(self, count: int) -> list[tuple[str, bytes]]:
        """Wait for so many frames put to vehicles since the last call, and take them."""
        with self._tx_news:
            assert self._tx_news.wait_for(lambda: len(self.tx) >= count, PATIENCE_S), f"{len(self.tx)} of {count}"
            found, self.tx = self.tx, []
        return found

    def _on_tx(self, sample: zenoh.Sample) -> None:
        with self._tx_news:
            self.tx.append((str(sample.key_expr), sample.payload.to_bytes()))
            self._tx_news.notify_all()


class Serve:
    """``serve(rules, stream_timeout=...)``: a gateway behind a router of its own or that of ``endpoint``, as the member
    whose ``credentials`` it is given; all end with the module.
    """

    def __init__(self) -> None:
        self.running: list[Served] = []

    def __call__(self, rules: Rules | None = None, endpoint: str = "", **how: Any) -> Served:
        listening = SessionSettings(mode="router", listen=["tcp/127.0.0.1:0"], cfg=("scouting/delay:0",))
        session = open_session(SessionSettings(connect=[endpoint]) if endpoint else listening)
        self.running.append(Served(session, endpoint or endpoint_of(session), rules, **how))
        return self.running[-1]

    def close(self) -> None:
        for served in self.running:
            served.close()
            served.session.close()


@pytest.fixture(scope="module")
def serve() -> Iterator[Serve]:
    serve = Serve()
    yield serve
    serve.close()


@pytest.fixture(scope="module")
def served(serve: Serve) -> Served:
    """A gateway without a token, quad1 with system id 1 and quad2 with 2; the module's tests share it."""
    served = serve()
    served.vehicle("quad1", 1)
    served.vehicle("quad2", 2)
    return served


@pytest.fixture(scope="session")
def started() -> Iterator[Chromium]:
    if not CHROMIUM:
        pytest.skip("no Chromium is installed (Debian: chromium)")
    with chromium() as started:
        yield started


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def tab(started: Chromium) -> AsyncIterator[Tab]:
    async with started.tab() as tab:
        yield tab


@pytest.fixture(scope="module")
def flying(served: Served) -> Iterator[Fleet]:
    fleet = Fleet(served)
    yield fleet
    fleet.close()


@pytest.fixture
def fleet(flying: Fleet) -> Iterator[Fleet]:
    """The module's fleet, which is as it was when the test ends, also by a failure."""
    yield flying
    flying.names, flying.more, flying.height, flying.charge = ["quad1", "quad2"], {}, 0.0, 0.9
    flying.silent.clear()


@pytest.fixture
def planner(served: Served) -> Iterator[FakePlanner]:
    planner = FakePlanner(served)
    yield planner
    planner.close()
