"""A simulated copter, its agent and the HTTP gateway in a thread of this process, and GNU Octave to use them with."""

from __future__ import annotations

import asyncio
import contextlib
import os
import shutil
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar

import pytest

import zmav
from ground.http.app import make_app
from ground.http.gateway import Gateway
from ground.http.guard import Rules
from ground.http.server import bound, serving
from tests.conftest import endpoint_of
from zmav import wire
from zmav.agent import Tunable
from zmav.errors import Refused
from zmav.onboard import Onboard, OnboardSettings
from zmav.session import SessionSettings, open_session
from zmav.sim import VehicleSpec, World
from zmav.verbs import Access, Verb

HERE = Path(__file__).resolve().parent
TOOLBOX = HERE.parent.parent.parent / "ground" / "matlab"
PLACE = wire.Origin(lat_deg=-35.363261, lon_deg=149.165230, alt_amsl=584.09)
PATIENCE_S = 100.0
TOKEN = "only for those who know it"

Octave = Callable[..., str]


class Count(wire.Order, kw_only=True):
    to: int
    pos: wire.Vector = (0.0, 0.0, 0.0)
    word: str = ""


class Counter(zmav.Agent):
    """An agent that counts when it is told to."""

    name = "counter"
    tunables: ClassVar = {"gain": Tunable(1.0, 0.0, 5.0, "1/s", "how fast"), "roll.kp": Tunable(6.5, 0.0, 20.0)}
    verbs: ClassVar = {
        "count": Verb("count", Count, Access.CHANGE, "count up to a number"),
        "rest": Verb("rest", wire.Order, Access.CHANGE, "do nothing"),
    }

    async def on_count(self, args: Count, report: object, origin: object) -> dict[str, Any]:
        if args.to < 0:
            raise Refused("it counts upwards only", field="to")
        return {"counted": args.to, "pos": args.pos, "word": args.word}

    async def on_rest(self, args: wire.Order, report: object, origin: object) -> dict[str, Any]:
        return {}


class Fleet:
    """quad1 with an agent behind a gateway at ``url``; ``guarded``: the same gateway, which asks there for TOKEN."""

    def __init__(self, cache: str) -> None:
        self.url = self.guarded = ""
        self.track: list[wire.VehicleState] = []
        """every state that quad1 has published"""
        self.world: World
        self._cache, self._ready = cache, threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()), name="fleet")

    def __enter__(self) -> Fleet:
        self._thread.start()
        assert self._ready.wait(PATIENCE_S)
        assert self.url, "the fleet did not start: its thread says why"
        return self

    def __exit__(self, *error: object) -> None:
        self._loop.call_soon_threadsafe(self._end.set)
        self._thread.join(PATIENCE_S)

    async def _run(self) -> None:
        self._loop, self._end = asyncio.get_running_loop(), asyncio.Event()
        try:
            async with contextlib.AsyncExitStack() as stack:
                await self._start(stack)
                self._ready.set()
                await self._end.wait()
        finally:
            self._ready.set()

    async def _start(self, stack: contextlib.AsyncExitStack) -> None:
        spec = VehicleSpec(params={"DISARM_DELAY": 0.0, "LAND_SPEED": 150.0})
        world = self.world = stack.enter_context(World([spec], endpoint="tcp:0", ready_s=0.5))
        how = SessionSettings(mode="router", listen=["tcp/127.0.0.1:0"], cfg=("scouting/delay:0",))
        router = stack.enter_context(open_session(how))
        endpoint = endpoint_of(router)
        settings = OnboardSettings(link=world.urls[0], name="quad1", origin=PLACE, cache=self._cache)
        await stack.enter_async_context(Onboard(router, settings))
        z = await stack.enter_async_context(zmav.open(settings=SessionSettings(connect=[endpoint])))
        gateway = await stack.enter_async_context(Gateway(z))
        await stack.enter_async_context(Counter(z, "quad1"))
        app, guarded = make_app(gateway), make_app(gateway, Rules(token=TOKEN))
        port = await stack.enter_async_context(serving(app, bound("127.0.0.1", 0)))
        guarded_port = await stack.enter_async_context(serving(guarded, bound("127.0.0.1", 0)))
        watching = asyncio.create_task(self._watch(z))
        stack.callback(watching.cancel)
        await z.vehicle("quad1").wait_until(lambda s: bool(s.ready and s.attitude and s.local), PATIENCE_S)
        self.url, self.guarded = f"http://127.0.0.1:{port}", f"http://127.0.0.1:{guarded_port}"

    async def _watch(self, z: zmav.Client) -> None:
        def state(sample: Any) -> wire.VehicleState:
            return wire.decode(sample.payload.to_bytes(), wire.VehicleState, "state")

        async with z.subscribe("quad1", state) as states:
            async for each in states:
                self.track.append(each)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    """Shared by the tests of a file, so leave the copter as you found it: disarmed on the ground, its lease free."""
    with Fleet(str(tmp_path_factory.mktemp("cache"))) as fleet:
        yield fleet


@pytest.fixture(scope="session")
def octave() -> Octave:
    """Runs a script of this folder in Octave, with what it reads from its environment; gives what is said."""
    program = shutil.which("octave-cli")
    if program is None:
        pytest.skip("GNU Octave is not installed (Debian: apt install octave)")

    def run(script: str, path: Path | str = TOOLBOX, **environment: str) -> str:
        command = [program, "--no-gui", "--norc", "--path", str(HERE), "--path", str(path), str(HERE / script)]
        given = {**os.environ, "TOOLBOX": str(TOOLBOX), **environment}
        ran = subprocess.run(command, env=given, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
        assert ran.returncode == 0, f"{script}: {ran.stdout}\n{ran.stderr}"
        return ran.stdout

    return run


@pytest.fixture(scope="session")
def java(octave: Octave) -> str:
    """A JAVA_HOME by which Octave has Java, and so UDP; skipped where there is none."""
    here = [os.environ.get("JAVA_HOME", ""), *sorted(map(str, Path("/usr/lib/jvm").glob("*")))]
    for home in here:
        if home and "jvm" in octave("has_java.m", JAVA_HOME=home):
            return home
    return pytest.skip("Octave finds no Java here (Debian: apt install default-jre-headless)")
