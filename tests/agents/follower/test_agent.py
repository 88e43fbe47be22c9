"""The agent itself above a pad that a test says is seen: its places stop, its landing is ended."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest

import zmav
from agents.follower.agent import Follower, FollowerSettings
from tests.waiting import until
from zmav import keys, wire
from zmav.errors import Refused, Stale
from zmav.flying import PATIENCE
from zmav.sim import VehicleSpec, World
from zmav.subscription import Subscription
from zmav.vehicle.vehicle import Place, Progress

if TYPE_CHECKING:
    from tests.conftest import Net, StartOnboard

PATIENCE_S = 60.0
ORIGIN = wire.Origin(lat_deg=-35.363261, lon_deg=149.165230, alt_amsl=584.09)


class Places:
    """Those of a vehicle, as long as they are heard."""

    def __init__(self, said: Subscription[Place], quad: Quad) -> None:
        self._said, self._quad = said, quad

    async def __aenter__(self) -> Places:
        await self._said.__aenter__()
        return self

    async def __aexit__(self, *error: object) -> None:
        await self._said.__aexit__(*error)

    async def __aiter__(self) -> AsyncIterator[Place]:
        async for place in self._said:
            if self._quad.says_places:
                yield place


class Quad(zmav.Vehicle):
    says_places = True

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.orders: list[str] = []

    async def land(self, *, progress: Progress | None = None) -> None:
        self.orders.append("land")
        try:
            await super().land(progress=progress)
        finally:
            self.orders.append("land no more")

    async def hold(self) -> None:
        self.orders.append("hold")
        await super().hold()

    def places(self, hz: float, depth: int = 200) -> Any:
        return Places(super().places(hz, depth), self)


class Noted(Follower):
    """Its status is looked at."""

    def __init__(self, *args: Any) -> None:
        self.said: list[str] = []
        super().__init__(*args)

    def status(self, state: str, text: str = "", **detail: Any) -> None:
        self.said.append(text)
        super().status(state, text, **detail)


class Scene(NamedTuple):
    follower: Noted
    quad: Quad

    @property
    def phase(self) -> str:
        return self.follower.guide.phase if self.follower.guide is not None else ""

    async def track(self, height: float) -> asyncio.Task[None]:
        """Have it follow at ``height`` until it sees the pad; its flight."""
        await self.quad.tell("follower", "follow", height=height)
        assert self.follower.flight is not None
        await until(lambda: self.phase == "track", "it does not see the pad", PATIENCE_S)
        return self.follower.flight


@pytest.fixture
async def scene(net: Net, onboard: StartOnboard) -> AsyncIterator[Scene]:
    async with contextlib.AsyncExitStack() as stack:
        world = stack.enter_context(World([VehicleSpec(name="quad1")], endpoint="tcp:0", ready_s=0.5))
        session, endpoint = net.router()
        await onboard(session, world.urls[0], name="quad1", origin=ORIGIN)
        z = await stack.enter_async_context(zmav.open(connect=[endpoint]))
        (quad,) = await z.wait_for("quad1", timeout=PATIENCE_S)
        await quad.wait_until(lambda s: s.ready is True and s.local is not None, PATIENCE_S)
        follower = Noted(z, "quad1", FollowerSettings())
        follower.vehicle = quad = Quad(z, "quad1", "demo")
        await stack.enter_async_context(follower)

        async def see() -> None:
            """A pad, north of where it stands and so high up that the last landing of all takes seconds."""
            key = keys.DETECTION.key("demo", "quad1", camera="down")
            place = (1.0, 0.0, quad.local[2] - 3.0)
            pad = wire.Detection(symbol="H", u=0.0, v=0.0, scale_px=20.0, heading=0.0, score=0.9, pos=place)
            for seq in range(10_000):
                sight = wire.Detections(
                    t=time.time(),
                    camera="down",
                    seq=seq,
                    width=640,
                    height=480,
                    detector="test",
                    took=0.0,
                    delay=0.0,
                    found=[pad],
                )
                z.put(keys.DETECTION, key, sight)
                await asyncio.sleep(0.1)

        running = [asyncio.create_task(each) for each in (follower.run(), see())]
        yield Scene(follower, quad)
        for task in running:
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)


async def test_without_new_places_it_gives_the_vehicle_back_and_one_that_somebody_else_lands_too(scene: Scene) -> None:
    """What is no new place: see test_place.py."""
    follower, quad = scene
    flight = await scene.track(3.0)
    quad.says_places, words = False, "s ago where it is"
    stopped = time.monotonic()
    await until(lambda: any(words in text for text in follower.said), "it does not say so")
    await quad.wait_until(lambda s: s.mover != "stream", PATIENCE_S)
    assert not flight.done()
    await until(flight.done, "it waits for ever", PATIENCE_S)
    assert time.monotonic() - stopped > PATIENCE - 0.5, "by when the last place came"
    assert isinstance(flight.exception(), Stale)
    assert words in follower.said[-1]
    await quad.wait_until(lambda s: s.lease is None, PATIENCE_S)

    quad.says_places = True
    flight = await scene.track(2.0)
    await quad.land()
    await until(flight.done, "it goes on for ever", PATIENCE_S)
    assert follower.said[-1] == "landed"
    await quad.wait_until(lambda s: s.lease is None, PATIENCE_S)


async def test_a_hold_ends_a_landing_on_the_pad_unless_it_is_down(scene: Scene) -> None:
    follower, quad = scene
    await scene.track(2.0)
    landing = asyncio.create_task(quad.tell("follower", "land"))
    await until(lambda: "on the pad" in follower.said, "it does not land", PATIENCE_S)
    await quad.tell("follower", "hold")
    with pytest.raises(Refused, match="it does not land: it was told otherwise"):
        await landing
    await until(lambda: scene.phase == "hold", "it goes on landing")
    assert quad.orders == ["land", "land no more", "hold"]
    state = await quad.wait_until(lambda s: s.mover == "stream", PATIENCE_S)
    assert state.local is not None
    await asyncio.sleep(1.0)  # it would sink by more than that meanwhile
    assert quad.local[2] == pytest.approx(state.local[2], abs=0.3)
    assert not quad.state.landed
    assert quad.state.armed
    assert follower.flying
    assert follower.said[-1].startswith("hold")

    await scene.track(2.0)
    landing = asyncio.create_task(quad.tell("follower", "land"))
    await quad.wait_until(lambda s: s.mover != "stream" and s.landed is True, PATIENCE_S)
    assert quad.state.armed
    await quad.tell("follower", "hold")
    await landing
    assert not quad.state.armed
    assert follower.said[-1] == "landed"
