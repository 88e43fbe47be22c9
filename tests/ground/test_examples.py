"""The example scripts as processes of their own, beside three simulated copters: judged by what the vehicles did."""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import signal
import sys
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import NamedTuple

import pytest
import pytest_asyncio
import zenoh

import zmav
from ground.ros2.face import Face
from tests.conftest import endpoint_of
from tests.waiting import until
from zmav import keys, wire
from zmav.onboard import Onboard, OnboardSettings
from zmav.session import SessionSettings, open_session
from zmav.sim import SimVehicle, VehicleSpec, World

pytestmark = pytest.mark.asyncio(loop_scope="module")
PATIENCE_S = 40.0
ROOT = Path(__file__).resolve().parent.parent.parent
EXAMPLES = ROOT / "ground" / "examples"
NAMES = ("quad1", "quad2", "quad3")
ORIGIN = wire.Origin(lat_deg=-35.363261, lon_deg=149.165230, alt_amsl=584.09)


class Script:
    """A running example, with all it has said."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process = process
        self.lines: list[str] = []

    async def said(self, words: str) -> str:
        """The next line with these words."""
        assert self.process.stdout is not None
        while line := (await asyncio.wait_for(self.process.stdout.readline(), PATIENCE_S)).decode():
            self.lines.append(line.rstrip())
            if words in line:
                return line.rstrip()
        raise AssertionError(f"{words!r} was never said: {self.lines}")

    async def end(self, number: int | None = None) -> int:
        """Its exit code; ``number``: the signal it is sent before."""
        assert self.process.stdout is not None
        if number is not None:
            self.process.send_signal(number)
        rest = await asyncio.wait_for(self.process.stdout.read(), PATIENCE_S)
        self.lines += rest.decode().splitlines()
        assert "Traceback" not in "\n".join(self.lines), self.lines
        return await self.process.wait()


class Fleet(NamedTuple):
    z: zmav.Client
    world: World
    sims: dict[str, SimVehicle]
    endpoint: str

    def at(self, name: str) -> tuple[float, float, float]:
        """Where it truly is: m, NED."""
        north, east, down = self.sims[name].status().ned_m
        return north, east, down

    def places(self) -> list[tuple[float, float, float]]:
        """Where all truly are, at one moment, from west to east."""
        return sorted(self.world.call(lambda: [self.at(name) for name in NAMES]), key=lambda place: place[1])

    async def until(self, true: Callable[[], bool], what: str) -> None:
        await until(true, lambda: f"{what}; {[self.at(name) for name in NAMES]}", PATIENCE_S)

    async def run(self, name: str, *arguments: str) -> Script:
        environment = {k: v for k, v in os.environ.items() if not k.startswith("ZMAV_")}
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            str(EXAMPLES / f"{name}.py"),
            *arguments,
            self.endpoint,
            cwd=ROOT,
            env=environment,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
        )
        return Script(process)

    async def down(self) -> None:
        """All on the ground, disarmed, nobody's."""

        async def one(name: str) -> None:
            vehicle = self.z.vehicle(name)
            if self.sims[name].status().armed:
                await vehicle.land()
            await vehicle.wait_until(lambda s: bool(s.ready and not s.armed and s.lease is None), PATIENCE_S)

        await asyncio.gather(*(one(name) for name in NAMES))


@pytest_asyncio.fixture(loop_scope="module")
async def fleet(copters: Fleet) -> AsyncIterator[Fleet]:
    """On the ground before and after each test, so that one that fails does not fail the others."""
    yield copters
    await copters.down()


@pytest_asyncio.fixture(loop_scope="module", scope="module")
async def copters(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Fleet]:
    """Three copters six metres apart, each agent a client of one router."""
    cache = str(tmp_path_factory.mktemp("cache"))
    quick = {"DISARM_DELAY": 0.0, "LAND_SPEED": 150.0}  # cm/s
    specs = [VehicleSpec(params=quick) for _ in NAMES]
    async with contextlib.AsyncExitStack() as stack:
        world = stack.enter_context(World(specs, endpoint="tcp:0", speed=8.0, ready_s=0.5, spacing_m=6.0))
        router, endpoint = _router(stack)
        for name, url in zip(NAMES, world.urls, strict=True):
            session = router if name == "quad1" else stack.enter_context(_client(endpoint))
            settings = OnboardSettings(link=url, name=name, origin=ORIGIN, cache=cache)
            await stack.enter_async_context(Onboard(session, settings))
        z = await stack.enter_async_context(zmav.open(connect=[endpoint]))
        found = Fleet(z, world, dict(zip(NAMES, world.vehicles, strict=True)), endpoint)
        await found.down()
        yield found


def _router(stack: contextlib.AsyncExitStack) -> tuple[zenoh.Session, str]:
    how = SessionSettings(mode="router", listen=["tcp/127.0.0.1:0"], cfg=("scouting/delay:0",))
    session = stack.enter_context(open_session(how))
    return session, endpoint_of(session)


def _client(endpoint: str) -> zenoh.Session:
    return open_session(SessionSettings(connect=[endpoint]))


async def test_telemetry_prints_every_vehicle(fleet: Fleet) -> None:
    script = await fleet.run("telemetry")
    for name in NAMES:
        assert "degrees" in await script.said(f"{name}: roll")
    assert await script.end(signal.SIGINT) == 130


async def test_a_square_is_flown_and_landed(fleet: Fleet) -> None:
    start = fleet.at("quad1")
    track: list[tuple[float, float, float]] = []

    async def follow() -> None:
        while True:
            track.append(fleet.at("quad1"))
            await asyncio.sleep(0.005)

    following = asyncio.create_task(follow())
    script = await fleet.run("square")
    for _ in range(4):
        await script.said("corner")
    assert await script.end() == 0
    following.cancel()
    passed = []
    for north, east in ((12.0, 0.0), (12.0, 12.0), (0.0, 12.0)):
        corner = (start[0] + north, start[1] + east, start[2] - 8.0)
        away = [math.dist(place, corner) for place in track]
        assert min(away) < 2.0
        passed.append(away.index(min(away)))
    assert passed == sorted(passed)
    assert math.dist(fleet.at("quad1"), start) < 1.0
    assert not fleet.sims["quad1"].status().armed


async def test_two_fly_a_square_by_ros_2_alone(fleet: Fleet) -> None:
    starts = {name: fleet.at(name) for name in ("quad1", "quad2")}
    async with Face(fleet.z, 0, {}, print, may_order=True):
        script = await fleet.run("ros2/square")
        for _ in range(8):
            await script.said("corner")
        assert await script.end() == 0
        for name, start in starts.items():
            await fleet.until(lambda name=name: not fleet.sims[name].status().armed, "landed")  # type: ignore[misc]
            assert math.dist(fleet.at(name), start) < 1.5


async def test_ctrl_c_in_a_square_holds(fleet: Fleet) -> None:
    start = fleet.at("quad1")
    script = await fleet.run("square")
    await fleet.until(lambda: fleet.at("quad1")[0] > start[0] + 2.0, "on its first leg")
    assert await script.end(signal.SIGINT) == 130
    await fleet.z.vehicle("quad1").wait_until(lambda s: bool(s.velocity and math.hypot(*s.velocity) < 0.2), PATIENCE_S)
    assert fleet.sims["quad1"].status().armed
    assert fleet.at("quad1")[0] < start[0] + 11.5  # short of the corner


async def test_all_take_off_but_one_that_another_commands(fleet: Fleet) -> None:
    async with fleet.z.vehicle("quad3").lease("rival"):
        script = await fleet.run("takeoff")
        assert "rival commands quad3" in await script.said("quad3: ")
        assert "2 of 3 are 10 m up" in await script.said(" of 3")
        assert await script.end() == 1
    assert [round(-fleet.at(name)[2]) for name in NAMES] == [10, 10, 0]
    assert [fleet.sims[name].status().armed for name in NAMES] == [True, True, False]


async def test_a_formation_keeps_its_shape_while_it_moves_and_holds_on_ctrl_c(fleet: Fleet) -> None:
    script = await fleet.run("formation")
    await script.said("gathered")
    begun = fleet.places()[1]
    for moved in (2.0, 5.0, 8.0):
        await fleet.until(lambda moved=moved: fleet.places()[1][0] > begun[0] + moved, f"{moved} m north")  # type: ignore[misc]
        west, tip, east = fleet.places()
        for place, slot in ((west, (-6.0, -6.0, 0.0)), (east, (-6.0, 6.0, 0.0))):
            assert math.dist(place, [a + b for a, b in zip(tip, slot, strict=True)]) < 2.0
    assert await script.end(signal.SIGINT) == 130
    for name in NAMES:
        vehicle = fleet.z.vehicle(name)
        await vehicle.wait_until(lambda s: bool(s.velocity and math.hypot(*s.velocity) < 0.2), PATIENCE_S)
        assert (vehicle.state.lease, vehicle.state.armed) == (None, True)
    assert fleet.places()[1][0] < begun[0] + 30.0  # well before the end of the way


class Leader:
    """A rover that only says where it is; ten times a second until it is lost."""

    def __init__(self, z: zmav.Client, local: wire.Vector) -> None:
        self._z, self.local = z, local
        self._task = asyncio.create_task(self._speak())

    async def _speak(self) -> None:
        while True:
            state = wire.VehicleState(
                t=time.time(),
                fleet="demo",
                name="rover1",
                instance="a",
                connected=True,
                kind="rover",
                local=self.local,
                velocity=(0.0, 0.0, 0.0),
            )
            self._z.put(keys.STATE, keys.STATE.key("demo", "rover1"), state)
            await asyncio.sleep(0.1)

    def __enter__(self) -> Leader:
        return self

    def __exit__(self, *_: object) -> None:
        self._task.cancel()


async def test_a_follower_keeps_its_offset_and_holds_when_the_leader_is_lost(fleet: Fleet) -> None:
    north, east, down = fleet.at("quad2")
    goal = (north + 10.0, east + 6.0, down - 6.0)
    with Leader(fleet.z, (north + 10.0, east, down)) as leader:
        script = await fleet.run("follow", "rover1", "quad2")
        await script.said("quad2 follows rover1")
        near = (north + 4.0, east, down - 6.0)
        await fleet.until(lambda: math.dist(fleet.at("quad2"), near) < 1.0, f"at {near}")
        leader.local = (north + 16.0, east + 6.0, down)
        await fleet.until(lambda: math.dist(fleet.at("quad2"), goal) < 1.0, f"at {goal}")
    assert "rover1 was last heard" in await script.said("quad2 holds")
    assert await script.end() == 0
    state = await fleet.z.vehicle("quad2").wait_until(lambda s: s.lease is None, PATIENCE_S)
    assert state.armed
    assert math.dist(fleet.at("quad2"), goal) < 1.5


async def test_an_agent_circles_says_so_and_ends_well(fleet: Fleet) -> None:
    start = fleet.at("quad1")
    centre = (start[0] - 8.0, start[1])
    said: list[wire.AgentStatus] = []
    key = keys.AGENT_STATUS.key("demo", "quad1", agent="orbit")
    async with fleet.z.subscribe(key, lambda s: wire.decode(s.payload.to_bytes(), wire.AgentStatus, "status")) as news:
        script = await fleet.run("agent")
        for angle in (0.5, 1.0, 1.5):
            reached = (centre[0] + 8.0 * math.cos(angle), centre[1] + 8.0 * math.sin(angle))
            await fleet.until(lambda at=reached: math.dist(fleet.at("quad1")[:2], at) < 1.5, f"{angle} rad round")  # type: ignore[misc]
        lease = fleet.z.vehicle("quad1").state.lease
        assert lease is not None and lease.holder == "orbit"
        assert await script.end(signal.SIGTERM) == 0
        while not said or said[-1].state != "ended":
            said.append(await asyncio.wait_for(news.get(), PATIENCE_S))
    assert list(dict.fromkeys(status.state for status in said)) == ["takeoff", "circling", "ended"]
    state = await fleet.z.vehicle("quad1").wait_until(lambda s: s.lease is None, PATIENCE_S)
    assert state.lease_end is not None and state.lease_end.reason == "released"


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
async def test_an_example_is_short_and_stands_on_the_public_face_alone(path: Path) -> None:
    text = path.read_text("utf-8")
    assert len(text.splitlines()) <= 60
    assert "import zmav\n" in text
    assert "from zmav" not in text
    assert "zmav." + "keys" not in text


async def test_a_missing_router_is_said_in_words(fleet: Fleet) -> None:
    script = await fleet._replace(endpoint="tcp/127.0.0.1:1").run("takeoff")
    assert await script.end() == 1
    assert len(script.lines) == 1
    assert script.lines[0].startswith("takeoff: no Zenoh router answers at tcp")
