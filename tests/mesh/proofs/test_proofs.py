"""The mesh's proofs, short: tests/bench/mesh_proofs.py has them at full length."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path

import msgspec
import pytest

import zmav
from mesh.lab.lab import Lab
from mesh.lab.scenario import Scenario
from tests.mesh.proofs import proofs, rigs
from tests.mesh.proofs.tap import Tap
from zmav import keys

pytestmark = pytest.mark.root
Run = Callable[..., AbstractAsyncContextManager[tuple[Lab, zmav.Client]]]


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """``async with run(scenario) as (lab, z)``: its vehicles are heard at the ground."""

    @asynccontextmanager
    async def running(scenario: Scenario) -> AsyncIterator[tuple[Lab, zmav.Client]]:
        async with Lab(scenario, tmp_path / "lab") as lab:
            await lab.ready()
            async with rigs.station(lab) as z:
                await rigs.all_heard(z, lab)
                yield lab, z

    return running


async def test_the_last_of_six_in_a_line_is_heard_and_obeys(run: Run) -> None:
    """Behind four relays that it does not hear beyond, with mutual TLS on every link."""
    async with run(rigs.chain(1, relays=4, credentials=True)) as (lab, z):
        quad = z.vehicle("quad1")
        assert len(await rigs.pings(quad, 5)) == 5
        frames = rigs.Gaps(z, lab.fleet, "quad1")
        await frames.again(time.monotonic())
        await quad.arm(ready_timeout=rigs.PATIENCE)
        await quad.disarm()
        direct = lab.network.counted()
        crossed = [direct.channels[edge.ab].arrived_bytes for edge in lab.network.wiring.edges]
        assert len(crossed) == 5
        assert min(crossed) > 0


async def test_a_ring_outlives_the_cut_of_the_path_in_use(run: Run) -> None:
    async with run(rigs.ring(delay="2 ms", lease=1.0)) as (lab, z):
        await z.vehicle("quad1").arm(ready_timeout=rigs.PATIENCE)
        saw = await proofs.recovery(lab, z, 2, rest=1.0)
    assert len(saw.gaps) == 2
    assert min(saw.gaps) > 0.2  # it was the path in use
    assert saw.orders.lost == []
    assert saw.orders.done > 0


async def test_over_a_relay_what_must_arrive_does_a_lease_outlasts_a_stall_and_nothing_stale_is_flown(
    tmp_path: Path, run: Run
) -> None:
    scenario = rigs.chain(1, relays=1, loss=0.1, delay="20 ms", lease=1.0)
    link = tmp_path / "tap"
    quad = msgspec.structs.replace(scenario.hosts["quad1"], arguments=["--link", str(link)])
    scenario = msgspec.structs.replace(scenario, hosts={**scenario.hosts, "quad1": quad})
    with Tap(tmp_path / "lab" / "quad1.pty", link) as tap:
        async with run(scenario) as (lab, z):
            # Once and in order, though a tenth is lost.
            arrived = await proofs.must_arrive(lab, z, "quad1", 5)
            assert sum(each.lost for each in lab.counters("all")) > 0
            assert arrived.failed == []
            assert len(arrived.given) == 10
            assert arrived.heard == arrived.given

            # There is no other way than the link that stalls.
            lab.set("all", loss=0.0, delay="5 ms")
            vehicle = z.vehicle("quad1")
            await rigs.in_the_air(vehicle, 3.0)
            ended = vehicle.state.lease_end
            async with vehicle.lease("planner", ttl=30.0) as lease:
                await proofs.stream(lease, {}, 1.0)
                lab.cut("ground-relay1")  # the token is missed behind a link that is not the vehicle's own
                await proofs.stream(lease, {}, 2.0)
                lab.heal("ground-relay1")
                streaming, healed = asyncio.create_task(proofs.stream(lease, {}, 5.0)), time.time()
                flies = await vehicle.wait_until(lambda s: s.t > healed + 1.0 and s.mover == "stream", rigs.PATIENCE)
                await streaming
                assert flies.lease is not None
                assert (flies.lease.number, flies.lease_end) == (lease.number, ended)
            await vehicle.wait_until(lambda s: s.lease is None, rigs.PATIENCE)
            tap.heard.clear()  # of setpoints that have the same numbers

            saw = await proofs.partition(lab, z, tap, "relay1-quad1", 3.0)
    assert saw.before > 20
    assert saw.alone > 20
    assert any("holding position" in text for text in saw.said)
    assert saw.during == set()
    assert saw.stale == set()
    assert saw.again > 0
    assert "lease" in saw.lost


async def test_a_segment_of_three_access_points_comes_back_when_its_middle_does(run: Run) -> None:
    async with run(rigs.wds(delay="3 ms", lease=1.0)) as (lab, z):
        states: list[bytes] = []
        z.session.declare_subscriber(keys.STATE.key(lab.fleet, "*"), lambda s: states.append(s.payload.to_bytes()))
        times = rigs.Gaps(z, lab.fleet, "quad2")
        await times.again(time.monotonic())
        for link in rigs.BEHIND_THE_HOP:
            lab.cut(link)
        await asyncio.sleep(2.0)
        healed = time.monotonic()
        for link in rigs.BEHIND_THE_HOP:
            lab.heal(link)
        await times.again(healed)
        assert len(await rigs.pings(z.vehicle("quad2"), 3)) == 3
        assert proofs.states_twice(states) == 0
        assert len(states) > 10
