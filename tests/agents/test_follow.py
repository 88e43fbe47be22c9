"""The whole way from a picture to a landing: simulated camera, camera agent, helipad, follower, a rover that moves."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from typing import TYPE_CHECKING

import pytest

import zmav
from agents.camera.agent import CameraAgent
from agents.camera.mjpeg import MjpegSource
from agents.camera.settings import CameraSettings
from agents.follower.agent import Follower, FollowerSettings
from agents.helipad.agent import Helipad, HelipadSettings
from tests.waiting import until
from zmav import keys, wire
from zmav.errors import Refused
from zmav.sim import VehicleSpec, World
from zmav.sim.camera import CameraSpec, PadSpec
from zmav.sim.camera.serve import serve_cameras

if TYPE_CHECKING:
    from tests.conftest import Net, StartOnboard

ORIGIN = wire.Origin(lat_deg=-35.363261, lon_deg=149.165230, alt_amsl=584.09)
LENS = CameraSpec(rate_hz=8.0)
FIELD_OF_VIEW = 2.0 * math.atan(LENS.width / 2.0 / LENS.focal_px)
DECK, PATIENCE_S = 0.31, 60.0
WRONG = 0.5
"""m that the deck is told too high: two autopilots' heights differ by as much"""


async def drive(rover: zmav.Vehicle, speed: float) -> None:
    """North, until cancelled."""
    async with rover.lease("driver") as lease:
        north, east, _ = rover.local
        begun = time.monotonic()
        while True:
            lease.setpoint(pos=(north + speed * (time.monotonic() - begun), east, 0.0), vel=(speed, 0.0, 0.0))
            await asyncio.sleep(0.1)


@pytest.mark.alone  # it must keep up with a rover by pictures, whatever else runs
@pytest.mark.slow
async def test_it_finds_the_rover_follows_it_without_pictures_too_and_lands_on_it(
    net: Net, onboard: StartOnboard
) -> None:
    specs = [
        VehicleSpec(name="quad1", camera=LENS),
        VehicleSpec(name="rover1", autopilot="ardurover", start_ned_m=(4.0, 1.0, 0.0), pad=PadSpec()),
    ]
    async with contextlib.AsyncExitStack() as stack:
        world = stack.enter_context(World(specs, endpoint="tcp:0", ready_s=0.5))
        assert world.cameras is not None
        (pictures,) = serve_cameras(world.cameras, 0).values()
        session, endpoint = net.router()
        for name, url in zip(("quad1", "rover1"), world.urls, strict=True):
            await onboard(session, url, name=name, origin=ORIGIN)
        z = await stack.enter_async_context(zmav.open(connect=[endpoint]))
        quad, rover = await z.wait_for("quad1", "rover1", timeout=PATIENCE_S)
        for vehicle in (quad, rover):
            await vehicle.wait_until(lambda s: s.ready is True and s.local is not None, PATIENCE_S)

        own = CameraSettings(vehicle="quad1", rate=LENS.rate_hz, budget=500e3, offset=LENS.offset_m)
        camera = CameraAgent(z, own, MjpegSource(pictures), FIELD_OF_VIEW)
        await stack.enter_async_context(camera)
        helipad = Helipad(z, "quad1", HelipadSettings(target="rover1", deck_m=DECK + WRONG))
        follower = Follower(z, "quad1", FollowerSettings(deck_m=DECK + WRONG))
        for agent in (helipad, follower):
            await stack.enter_async_context(agent)
        running = [asyncio.create_task(agent.run()) for agent in (helipad, follower)]
        sights: list[wire.Detections] = []
        off_sights: list[float] = []

        async def see() -> None:
            key = keys.DETECTION.key("demo", "quad1", camera="down")
            async with z.subscribe(key, lambda s: wire.decode(s.payload.to_bytes(), wire.Detections, "sight")) as seen:
                async for sight in seen:
                    sights.append(sight)
                    if sight.found and sight.found[0].pos is not None:
                        north, east, _ = world.vehicles[1].status().ned_m
                        off_sights.append(math.hypot(sight.found[0].pos[0] - north, sight.found[0].pos[1] - east))

        running.append(asyncio.create_task(see()))

        with pytest.raises(Refused, match="follows nobody"):
            await quad.tell("follower", "land")
        await rover.arm()
        driving = asyncio.create_task(drive(rover, 0.6))
        await quad.tell("follower", "follow", target="rover1", height=4.0)
        await until(lambda: follower.guide is not None and follower.guide.phase == "track", "it does not see the rover")
        first = next(each for each in off_sights if each < 2.0)  # what is farther is no sight of the pad
        assert first < 0.3, "its level is told wrongly, and the first picture of it does not put that right"
        with pytest.raises(Refused, match="it follows rover1 already"):
            await quad.tell("follower", "follow", target="", height=4.0)

        def off() -> float:
            (a, b, _), (c, d, _) = (vehicle.status().ned_m for vehicle in world.vehicles)
            return math.hypot(a - c, b - d)

        away, headings, begun = list[float](), list[float](), world.time_s
        while (flown := world.time_s - begun) < 6.0:  # of simulated time, which a busy machine lets pass more slowly
            await asyncio.sleep(0.05)
            if flown > 2.0:
                away.append(off())
                assert quad.state.attitude is not None
                headings.append(quad.state.attitude.yaw)
        assert sum(away) / len(away) < 0.4, away
        assert max(headings) - min(headings) < 0.1, "it turns along where it flies"
        assert follower.guide is not None
        assert follower.guide.lost == 0
        drift = math.hypot(*follower.guide.drift.at(time.time()))
        assert 0.0 < drift < 0.5, "it hears no states, or takes what was flown for drift: here there is only rounding"
        assert any(sight.found and sight.found[0].pos is not None for sight in sights)
        (best,) = [sight.found[0] for sight in sights if sight.found][-1:]
        assert best.lat_deg == pytest.approx(ORIGIN.lat_deg, abs=1e-3)
        assert best.covariance is not None
        assert 0.0 < best.covariance[0] < 0.1

        # A picture that stands still has the pad wherever the vehicle goes: it must not be chased.
        lens = world.camera("quad1")
        lens.blackout = "frozen"
        guide = follower.guide
        await until(lambda: guide.lost == 1, "it believes a frozen picture")
        assert helipad._state == "blind"
        assert off() < 5.0  # where the rover says that it is
        lens.blackout = None
        await until(lambda: guide.phase == "track", "it does not find it again")

        driving.cancel()
        await asyncio.gather(driving, return_exceptions=True)
        await quad.tell("follower", "land")
        await quad.wait_until(lambda s: s.armed is False, PATIENCE_S)
        assert off() < 0.3
        assert follower.guide is None
        for task in running:
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)
