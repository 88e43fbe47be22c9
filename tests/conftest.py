"""What every test shares: where the tree is, the recorded data where present, and who may run what."""

from __future__ import annotations

import asyncio
import gc
import json
import os
import signal
import tempfile
import threading
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as zmav itself has it, and before anything imports numpy

import msgspec
import pytest
import zenoh
from hypothesis import HealthCheck, settings

from mesh.lab.network import LabError, Network, check_able
from mesh.lab.scenario import Scenario
from tests.imports import CACHE, Sources
from tests.lossy import open_lossy
from zmav import keys, rundir, wire
from zmav.onboard import Onboard, OnboardSettings
from zmav.session import SessionSettings, open_session

ROOT = Path(__file__).resolve().parent.parent
PATIENCE_S = 30.0  # how long an event may take on a busy machine before the test fails
NEEDS = {
    "flight": {"zmav.sim.World", "zmav.sim.world.World", "agents.hil.sil.sil"},
    "live": {"zmav.session.open_session", "zenoh.open", "zmav.open", "zmav.client.connect"},
    "process": {
        "subprocess",
        "multiprocessing",
        "asyncio.create_subprocess_exec",
        "asyncio.create_subprocess_shell",
        # What starts them for a test.
        "zmav.children.Children",
        "agents.controllers.reloading.ControllerReloader",
        "agents.controllers.worker.Worker",
        "agents.planner.live.solver.Solver",
        "ground.view.screen.Screen",
        "mesh.lab.lab.Lab",
    },
}
"""a test that uses one of these, by its fixtures too, is marked so"""
PLACES = {"flight": ("conformance", "failsafe", "interop"), "process": ("deploy", "interop")}

# Machines differ in speed and tests run side by side, so an example's time proves nothing.
settings.register_profile("zmav", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("zmav")


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What is fetched from autopilots goes neither to the user's own cache nor to another worker's."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="session", autouse=True)
def own_sockets() -> Iterator[None]:
    """Routers' unix sockets are seen by no other worker, nor by what else runs on this machine."""
    with tempfile.TemporaryDirectory(prefix="zmav-run-") as folder, pytest.MonkeyPatch.context() as patch:
        patch.setenv(rundir.VARIABLE, folder)  # not under tmp_path: the path of a socket is short
        yield


@pytest.fixture(scope="module", autouse=True)
def no_long_collection() -> None:
    """A full garbage collection stops every thread: of what pytest keeps of thousands of tests for 0.1 s and more."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def root() -> Path:
    """The root of the project's tree."""
    return ROOT


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of recordings that lies beside some checkouts; the test is skipped where it does not."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("the recordings (../shared/data) are not beside this checkout")
    return folder


class Samples:
    """What came on a key expression so far, in order, with waits that end on the next sample."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self.items: list[tuple[str, bytes]] = []
        self._changed = threading.Condition()
        session.declare_subscriber(key, self._on_sample)

    def _on_sample(self, sample: zenoh.Sample) -> None:
        with self._changed:
            self.items.append((str(sample.key_expr), sample.payload.to_bytes()))
            self._changed.notify_all()

    async def until(self, true: Callable[[], bool], what: str) -> None:
        """Wait until ``true()`` holds; it is asked again after each sample."""

        def wait() -> bool:
            with self._changed:
                return self._changed.wait_for(true, PATIENCE_S)

        assert await asyncio.to_thread(wait), f"no {what} among {len(self.items)} samples: {self.items[-5:]}"

    def objects(self) -> list[dict[str, Any]]:
        """The samples' JSON."""
        return [json.loads(payload) for _, payload in self.items]

    async def object(self, true: Callable[[dict[str, Any]], bool], what: str, after: int = 0) -> dict[str, Any]:
        """The first sample whose JSON is as wanted among ``items[after:]``, past ones included."""
        found: list[dict[str, Any]] = []

        def there() -> bool:
            found[:] = [body for body in self.objects()[after:] if true(body)][:1]
            return bool(found)

        await self.until(there, what)
        return found[0]


def matched(one: Any) -> None:
    """Wait until there is somebody for a publisher or a querier; then it is declared no more."""
    known = threading.Event()

    def on_match(status: Any) -> None:
        if status.matching:
            known.set()

    listener = one.declare_matching_listener(on_match)
    assert one.matching_status.matching or known.wait(PATIENCE_S), f"nobody is at {one.key_expr}"
    listener.undeclare()
    one.undeclare()


class Ground:
    """A client session as a ground station has it, beside one vehicle's keys."""

    def __init__(self, session: zenoh.Session, fleet: str = "demo", name: str = "quad1") -> None:
        self.session, self.fleet, self.name = session, fleet, name

    def samples(self, what: keys.Channel | str, **chunks: object) -> Samples:
        """Collect what comes on a channel of the vehicle, or on any key expression, from now on."""
        key = what if isinstance(what, str) else what.key(self.fleet, self.name, **chunks)
        return Samples(self.session, key)

    def put(self, channel: keys.Channel, payload: bytes, **chunks: object) -> None:
        """Put on a channel of the vehicle; unlike an agent's, it is never dropped on the way out."""
        options = {**channel.qos.options(), "congestion_control": zenoh.CongestionControl.BLOCK}
        self.session.put(channel.key(self.fleet, self.name, **chunks), payload, **options)

    async def ask(self, key: str, payload: bytes = b"") -> list[zenoh.Reply]:
        return await asyncio.to_thread(lambda: list(self.session.get(key, payload=payload, timeout=PATIENCE_S)))

    async def do(self, verb: str, payload: bytes | None = None, /, **args: Any) -> wire.Outcome:
        """Give an order once; raises what an error reply stands for."""
        data = json.dumps(args).encode() if payload is None else payload
        key = keys.DO.key(self.fleet, self.name, verb=verb)
        if not (replies := await self.ask(key, data)):  # a vehicle's first state may be here before its services are
            await asyncio.to_thread(matched, self.session.declare_querier(key))
            replies = await self.ask(key, data)
        (reply,) = replies
        if reply.ok is None:
            assert reply.err is not None
            raise wire.error_from(reply.err.payload.to_bytes())
        return wire.decode(reply.ok.payload.to_bytes(), wire.Outcome, verb)


def endpoint_of(router: zenoh.Session) -> str:
    """Where a router in this process listens, whichever port it was given."""
    (reply,) = router.get(f"@/{router.info.zid()}/router")
    assert reply.ok is not None
    locators: list[str] = json.loads(reply.ok.payload.to_bytes())["locators"]
    return locators[0]


class Net:
    """Routers and clients on loopback, each router on a port of its own choice; all are closed at the test's end."""

    def __init__(self) -> None:
        self.sessions: list[zenoh.Session] = []

    def router(self, *connect: str, cfg: Sequence[str] = ()) -> tuple[zenoh.Session, str]:
        """A router and where it listens; ``cfg``: more of Zenoh's settings."""
        # Without multicast nobody is found by scouting, so nobody need wait half a second for it.
        how = SessionSettings(mode="router", listen=["tcp/127.0.0.1:0"], connect=connect)
        session = self._open(msgspec.structs.replace(how, cfg=("scouting/delay:0", *cfg)))
        return session, endpoint_of(session)

    def ground(self, endpoint: str, name: str = "quad1", fleet: str = "demo") -> Ground:
        return Ground(self._open(SessionSettings(connect=[endpoint])), fleet, name)

    async def linked(self, session: zenoh.Session, key: str) -> None:
        """Wait until ``session`` knows of a subscriber of ``key``: what is put before is lost."""
        await asyncio.to_thread(matched, session.declare_publisher(key))

    def _open(self, how: SessionSettings) -> zenoh.Session:
        self.sessions.append(open_session(how))
        return self.sessions[-1]


@pytest.fixture
def net() -> Iterator[Net]:
    net = Net()
    yield net
    for session in reversed(net.sessions):
        session.close()


class StartOnboard:
    """Start an Onboard: ``await onboard(session, link, name=..., sysid=...)``; closed at the end, or before."""

    def __init__(self) -> None:
        self.running: list[Onboard] = []
        self.pace = 1.0
        """of their housekeeping"""

    async def __call__(self, session: zenoh.Session, link: str, name: str = "quad1", **more: Any) -> Onboard:
        vehicle = Onboard(session, OnboardSettings(link=link, name=name, **more), open_lossy(link))
        vehicle.tick /= self.pace
        self.running.append(await vehicle.__aenter__())
        return vehicle

    async def close(self, vehicle: Onboard) -> None:
        self.running.remove(vehicle)
        await vehicle.__aexit__(None, None, None)


@pytest.fixture
async def onboard(net: Net) -> AsyncIterator[StartOnboard]:
    onboard = StartOnboard()
    yield onboard
    for vehicle in reversed(onboard.running):
        await vehicle.__aexit__(None, None, None)


def pytest_configure() -> None:
    """Hear SIGINT, as the programs under test must: a shell that starts a job in the background has it ignored."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """What is found stays: to look through it again and again for garbage takes each worker a second."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--affected",
        help="run the unit tests but for those named in this file as long, and of the others those that use a module "
        "named there",
    )


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark each test by what it needs, and leave out what ``--affected`` does not ask for.

    Only where one of them is asked for: it takes each worker some seconds of a core, and two where ``make check`` has
    read the sources beforehand.

    Tests marked ``root`` are skipped for every other user, and where even root may make no network of its own.
    """
    file = config.getoption("--affected")
    if file or config.getoption("-m") not in ("", "alone", "not alone"):  # tests/run.py asks for these two
        _mark_and_select(config, items, file)
    marked = [item for item in items if item.get_closest_marker("root")]
    if marked and (why := _no_network()):
        for item in marked:
            item.add_marker(pytest.mark.skip(reason=why))


def _mark_and_select(config: pytest.Config, items: list[pytest.Item], file: str | None) -> None:
    sources = Sources(ROOT, ["tests"], ROOT / CACHE)
    asked = json.loads(Path(file).read_text("utf-8")) if file else None
    affected, long = (set(asked["modules"]), set(asked["long"])) if asked else (set(), set())
    kept: list[pytest.Item] = []
    left_out: list[pytest.Item] = []
    for item in items:
        reached = reached_by(item, sources)
        for mark in marks(item, reached):
            item.add_marker(mark)
        short = item.get_closest_marker("unit") and item.nodeid not in long
        wanted = not asked or short or not affected.isdisjoint(reached)
        (kept if wanted else left_out).append(item)
    if left_out:
        items[:] = kept
        config.hook.pytest_deselected(items=left_out)


def reached_by(item: pytest.Item, sources: Sources) -> set[str]:
    """The dotted names that a test, its fixtures and their helpers use."""
    parts = {(item.path, item.nodeid.split("::")[1].partition("[")[0])}
    if isinstance(item, pytest.Function):
        fixtures = item._fixtureinfo.name2fixturedefs.values()
        code = [getattr(each[-1].func, "__code__", None) for each in fixtures]
        parts |= {(Path(each.co_filename), each.co_name) for each in code if each is not None}
    found: set[str] = set()
    for path, name in parts:
        if module := sources.modules.get(path):
            found |= sources.reach(module, name)
    return found | {each.rpartition(".")[0] for each in found}


def marks(item: pytest.Item, reached: set[str]) -> list[str]:
    """``flight``, ``live`` and ``process`` as they apply; ``unit`` where none does."""
    folder = item.path.relative_to(ROOT / "tests").parts[0]
    found = [mark for mark, names in NEEDS.items() if not names.isdisjoint(reached) or folder in PLACES.get(mark, ())]
    return found or ([] if item.get_closest_marker("root") else ["unit"])


def _no_network() -> str:
    """Why no network namespace can be made here, in words; empty where one can."""
    if os.geteuid() != 0:
        return "needs root"
    tables = {"hosts": {"a": {}, "b": {}}, "media": [{"kind": "link", "between": ["a", "b"]}]}
    try:
        check_able()
        with Network(msgspec.convert(tables, Scenario)):
            return ""
    except (LabError, OSError) as e:
        return str(e)
