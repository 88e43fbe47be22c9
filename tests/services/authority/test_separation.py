"""The last resort, flown: two copters that are sent through each other's place, with nobody to plan for them."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import TYPE_CHECKING, NamedTuple

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

import zmav
from zmav import keys, wire
from zmav.config import Separation
from zmav.sim import SimVehicle, VehicleSpec, World
from zmav.wire.swarm import Beacon

if TYPE_CHECKING:
    from tests.conftest import Net, StartOnboard

PATIENCE_S = 30.0
NAMES = ("quad1", "quad2")
ORIGIN = wire.Origin(lat_deg=-35.363261, lon_deg=149.165230, alt_amsl=584.09)
KEPT = 0.75 * 2.0
"""m: the share of the radii that is kept by default"""


class Pair(NamedTuple):
    z: zmav.Client
    sims: list[SimVehicle]
    world: World
    places: list[wire.Vector]

    def apart(self) -> NDArray[np.float64]:
        """(3,) m from one to the other, the height as it counts."""
        one, other = (np.array(sim.status().ned_m) for sim in self.sims)
        apart: NDArray[np.float64] = (one - other) / np.array([1.0, 1.0, 1.5])
        return apart


StartPair = Callable[[bool], Awaitable[Pair]]


@pytest.fixture
async def hover(net: Net, onboard: StartOnboard) -> AsyncIterator[StartPair]:
    """Two copters 14 m apart that hover level, the world then at its own speed."""
    async with contextlib.AsyncExitStack() as stack:

        async def start(on: bool) -> Pair:
            specs = [VehicleSpec(params={"DISARM_DELAY": 0.0}) for _ in NAMES]
            world = stack.enter_context(World(specs, endpoint="tcp:0", speed=8.0, ready_s=0.5, spacing_m=14.0))
            session, endpoint = net.router()
            for name, url in zip(NAMES, world.urls, strict=True):
                await onboard(session, url, name=name, origin=ORIGIN, separation=Separation(on=on))
            z = await stack.enter_async_context(zmav.open(connect=[endpoint]))
            await z.wait_for(*NAMES, timeout=PATIENCE_S)
            await asyncio.gather(*(_rise(z.vehicle(name)) for name in NAMES))
            world.set_speed(1.0)
            return Pair(z, world.vehicles, world, [z.vehicle(name).local for name in NAMES])

        yield start


async def _rise(vehicle: zmav.Vehicle) -> None:
    await vehicle.arm()
    await vehicle.takeoff(8.0)


async def cross(pair: Pair, *, segments: bool) -> float:
    """Each to the other's place at once; the least distance of the two on the way, by the simulator."""
    seconds = 6.0
    nearest, apart = float("inf"), pair.apart()
    async with contextlib.AsyncExitStack() as held:
        leases = [await held.enter_async_context(pair.z.vehicle(name).lease("test")) for name in NAMES]
        start, end = time.time(), pair.world.time_s + seconds + 1.0
        for lease, here, there in zip(leases, pair.places, reversed(pair.places), strict=True):
            if segments:
                lease.segment(
                    [
                        wire.SegmentPoint(t=start, pos=here),
                        wire.SegmentPoint(t=start + seconds, pos=_level(here, there)),
                    ]
                )
        while pair.world.time_s < end:  # on a busy machine its time is the slower one
            for lease, here, there in zip(leases, pair.places, reversed(pair.places), strict=True):
                if not segments:
                    lease.setpoint(pos=_level(here, there))
            before, apart = apart, pair.apart()
            moved = before - apart  # in however long: a busy machine looks seldom
            share = np.clip(before @ moved / max(float(moved @ moved), 1e-9), 0.0, 1.0)
            nearest = min(nearest, float(np.linalg.norm(before - share * moved)))
            await asyncio.sleep(0.05)
    return nearest


def _level(here: wire.Vector, there: wire.Vector) -> wire.Vector:
    return there[0], there[1], here[2]


async def test_two_that_are_sent_through_each_other_stay_apart(hover: StartPair) -> None:
    pair = await hover(True)
    for segments in (False, True):
        async with pair.z.subscribe(
            keys.EVENT.key("demo", "*"), lambda s: wire.decode(s.payload.to_bytes(), wire.Event, "event")
        ) as events:
            before = [pair.z.vehicle(name).state.setpoints.get("aside", 0) for name in NAMES]
            assert await cross(pair, segments=segments) > KEPT
            while (event := await events.get()).kind != "separation":
                pass
        assert "moving aside for quad" in event.text
        pair.places.reverse()
    # The end of a segment may be taken: it holds where it went.
    states = [pair.z.vehicle(name).state for name in NAMES]
    assert any(s.segment is None and s.setpoints["aside"] > b for s, b in zip(states, before, strict=True))


async def test_without_it_they_would_have_met(hover: StartPair) -> None:
    assert await cross(await hover(False), segments=True) < KEPT


async def test_what_a_beacon_says_and_that_none_is_believed_that_cannot_be(net: Net, hover: StartPair) -> None:
    pair = await hover(True)
    key = keys.BEACON.key("demo", "quad1")
    async with pair.z.subscribe(key, lambda s: wire.decode(s.payload.to_bytes(), Beacon, "beacon")) as beacons:
        beacon = await beacons.get()
        assert beacon.pos[:2] == pytest.approx(pair.places[0][:2], abs=0.5)
        assert (beacon.radius, beacon.ahead) == (1.0, [])
        pos = pair.places[0]
        coming = Beacon(t=time.time(), pos=(pos[0] + 8.0, *pos[1:]), vel=(-3.0, 0.0, 0.0), radius=1.0)
        good = wire.encode(coming)
        many = wire.encode(msgspec.structs.replace(coming, ahead=[pos] * 9))
        endless, vast, negative = (good.replace(b'"radius":1.0', b'"radius":' + r) for r in (b"1e999", b"1e9", b"-1.0"))
        async with pair.z.vehicle("quad1").lease("test") as lease:
            now = time.time()
            lease.segment([wire.SegmentPoint(t=now, pos=pos), wire.SegmentPoint(t=now + 30.0, pos=pos)])
            await pair.z.vehicle("quad1").wait_until(lambda state: state.segment is not None, PATIENCE_S)
            for k, text in enumerate((b"{}", b"x", many, endless, vast, negative)):
                pair.z.put(keys.BEACON, keys.BEACON.key("demo", f"ghost{k}"), text)
            late = keys.BEACON.key("demo", "late")
            pair.z.put(keys.BEACON, late, wire.encode(msgspec.structs.replace(coming, t=now, pos=(500.0, 0.0, 0.0))))
            while (held := time.time() - now) < 2.5:
                await beacons.get()
            # It came by long ago: only its word of that was held up.
            gone = msgspec.structs.replace(coming, t=now + 0.1, vel=(-3.0 - 8.0 / held, 0.0, 0.0))
            pair.z.put(keys.BEACON, late, wire.encode(gone))
            for _ in range(3):
                await beacons.get()
            assert pair.z.vehicle("quad1").state.segment is not None
            pair.z.put(
                keys.BEACON, keys.BEACON.key("demo", "ghost"), wire.encode(msgspec.structs.replace(coming, t=0.0))
            )
            await pair.z.vehicle("quad1").wait_until(lambda state: state.segment is None, PATIENCE_S)


async def test_a_beacon_is_sent_where_the_last_one_does_not_tell_it_already(net: Net, hover: StartPair) -> None:
    pair = await hover(True)
    key, came = keys.BEACON.key("demo", "quad1"), list[float]()
    async with pair.z.subscribe(key, lambda s: wire.decode(s.payload.to_bytes(), Beacon, "beacon")) as beacons:
        await beacons.get()
        for _ in range(3):  # it hovers: that is known
            came.append((await beacons.get()).t)
        assert came[-1] - came[0] > 1.0  # and not two ticks of 0.2 s
        async with pair.z.vehicle("quad1").lease("test") as lease:
            pos, start = pair.places[0], time.time()
            lease.segment([wire.SegmentPoint(t=start, pos=pos), wire.SegmentPoint(t=start + 9.0, pos=_up(pos, 10.0))])
            while (beacon := await beacons.get()).ahead == []:
                pass
            assert beacon.ahead[-1][2] < pos[2] - 1.5
            assert beacon.t - start < 0.5, "at once: its neighbours could not know"


def _up(pos: wire.Vector, metres: float) -> wire.Vector:
    return pos[0], pos[1], pos[2] - metres
