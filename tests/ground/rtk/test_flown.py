"""From a caster to autopilots: pygnssutils' caster, ``zmav rtk``, a router between, and vehicles of the simulator."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator
from typing import TYPE_CHECKING

import pytest

from ground.corrections import LISTEN_S
from ground.rtk.options import Caster as Where
from ground.rtk.options import Recording
from ground.rtk.program import Rtk, RtkSettings
from tests.ground.rtk.casters import MOUNTPOINT, STREAM, Caster, hangs, hostile, sends
from tests.rtcm import base_at, message, satellites
from tests.services.conftest import peer  # noqa: F401  (a fixture)
from tests.waiting import until
from zmav import keys, wire
from zmav.mavlink.rtcm import Joiner
from zmav.sim import VehicleSpec, World

if TYPE_CHECKING:
    from pathlib import Path

    from tests.conftest import Net, StartOnboard
    from tests.ground.rtk.conftest import Fleet
    from tests.services.conftest import Peer, StartPeer

VEHICLES = 4


def joined(one: Peer) -> bytes:
    joiner = Joiner()
    told = [each.fields for each in one.heard("GPS_RTCM_DATA")]
    return b"".join(joiner.add(f["flags"], f["len"], bytes(f["data"])) for f in told)


class Radio:
    """A link between two routers, by which every byte is kept that goes to the far one."""

    def __init__(self, near: str) -> None:
        self._near, self.carried, self.endpoint = near, bytearray(), ""
        self._server: asyncio.AbstractServer | None = None
        self._tasks: set[asyncio.Task[None]] = set()

    async def __aenter__(self) -> Radio:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.endpoint = f"tcp/127.0.0.1:{self._server.sockets[0].getsockname()[1]}"
        return self

    async def __aexit__(self, *_: object) -> None:
        assert self._server is not None
        self._server.close()
        for task in self._tasks:
            task.cancel()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        host, _, port = self._near.partition("/")[2].rpartition(":")
        near, back = await asyncio.open_connection(host, int(port))
        for source, to, kept in ((near, writer, self.carried), (reader, back, bytearray())):
            self._tasks.add(asyncio.create_task(self._carry(source, to, kept)))

    async def _carry(self, source: asyncio.StreamReader, to: asyncio.StreamWriter, kept: bytearray) -> None:
        while data := await source.read(4096):
            kept += data
            to.write(data)


@pytest.fixture
async def stack() -> AsyncIterator[contextlib.AsyncExitStack]:
    async with contextlib.AsyncExitStack() as one:
        yield one


async def test_each_radio_is_crossed_once_however_many_vehicles_hear_it(
    fleet: Fleet,
    net: Net,
    onboard: StartOnboard,
    peer: StartPeer,  # noqa: F811
    stack: contextlib.AsyncExitStack,
) -> None:
    """The ground's router, one in the field with a link to it, and vehicles behind that: the link is the radio."""
    radio = await stack.enter_async_context(Radio(fleet.endpoint))
    _, endpoint = await asyncio.to_thread(net.router, radio.endpoint)
    peers = [await peer(number) for number in range(1, VEHICLES + 1)]
    for number, one in enumerate(peers, 1):
        router, _ = net.router(endpoint)
        await onboard(router, one.url, f"quad{number}")
    caster = Caster()
    where = Where(host="127.0.0.1", port=caster.port, mountpoint=MOUNTPOINT, user="me", password="secret")
    epochs = [base_at() + satellites(1074, t_ms=1000 * t) + message(1087, size=300, seed=t) for t in range(5)]
    async with fleet.client() as z, Rtk(z, RtkSettings(where=where, name="gs"), fleet.said.append) as rtk:
        running = asyncio.ensure_future(rtk.run())
        await net.linked(z.session, keys.RTCM.key("demo"))
        await until(lambda: caster.clients == 1, "client of the caster")
        await asyncio.sleep(LISTEN_S + 0.1)
        for t, epoch in enumerate(epochs):
            caster.send(epoch)
            await until(lambda: rtk.publisher.numbers[1087] == t + 1, "the caster's")  # noqa: B023
            await asyncio.sleep(0.2)
        for one in peers:
            await until(lambda one=one: joined(one) == b"".join(epochs), "corrections at an autopilot")  # type: ignore[misc]
        state, text, detail = rtk.status()
        running.cancel()
    caster.close()
    assert len(fleet.samples.items) == 5
    assert [radio.carried.count(each) for each in epochs] == [1] * 5
    assert (state, detail["in_charge"], detail["station"]) == ("in-charge", True, 1234)
    assert "B/s from ntrip://127.0.0.1" in text
    assert detail["base"]["lat_deg"] == pytest.approx(-35.363262)


async def test_the_caster_hears_where_a_vehicle_is(fleet: Fleet) -> None:
    """It is called once that is known."""
    state = wire.VehicleState(t=time.time(), fleet="demo", name="quad1", instance="a", connected=True)
    with hostile(sends(STREAM, base_at(), then=hangs)) as one:
        where = Where(host="127.0.0.1", port=one.port, mountpoint="VRS")
        settings = RtkSettings(where=where, name="gs", rover="quad1")
        async with fleet.client() as z, Rtk(z, settings, fleet.said.append) as rtk:
            running = asyncio.ensure_future(rtk.run())
            await until(lambda: rtk.status()[0] == "waiting", "to wait for the vehicle's place")
            assert not one.requests
            state.position = wire.GlobalPosition(lat_deg=-35.5, lon_deg=149.25, alt_amsl=600.0, alt_rel=10.0)
            while not one.requests:
                fleet.router.put(keys.STATE.key("demo", "quad1"), wire.encode(state))
                await asyncio.sleep(0.1)
            await until(lambda: rtk.publisher.numbers[1005] == 1, "corrections")
            running.cancel()
    assert b"Ntrip-GGA: $GPGGA," in one.requests[0]
    assert b",3530.00000,S,14915.00000,E,1,15,0.98,600.0,M" in one.requests[0], one.requests[0]


async def test_a_file_is_played_a_moment_a_second(fleet: Fleet, tmp_path: Path) -> None:
    moments = [base_at() + message(1074, seed=t) + message(1084, seed=t) for t in range(3)]
    path = tmp_path / "base.rtcm"
    path.write_bytes(b"".join(moments))
    async with fleet.client() as z, Rtk(z, RtkSettings(where=Recording(path), name="gs"), fleet.said.append) as rtk:
        await net_linked(fleet, z)
        began = time.monotonic()
        await rtk.run()
        assert time.monotonic() - began > 1.8
        assert rtk.status()[:2] == ("ended", f"9 messages were in {path}")
    assert fleet.data == b"".join(moments)
    assert len(fleet.batches) == 3


async def net_linked(fleet: Fleet, z: object) -> None:
    await fleet.net.linked(z.session, keys.RTCM.key("demo"))  # type: ignore[attr-defined]


async def test_its_status_is_told_once_a_second(fleet: Fleet, tmp_path: Path) -> None:
    path = tmp_path / "empty.rtcm"
    path.write_bytes(b"nothing")
    statuses = fleet.net.ground(fleet.endpoint).samples("zmav/demo/gs/agent/rtk/status")
    async with fleet.client() as z, Rtk(z, RtkSettings(where=Recording(path), name="gs"), fleet.said.append) as rtk:
        await rtk.run()
        found = await statuses.object(lambda s: s["state"] == "ended", "status")
    assert found["text"] == f"no RTCM 3 in {path}"
    assert found["detail"]["source"] == str(path)


async def test_a_simulated_copter_has_a_fixed_solution_by_them(fleet: Fleet, onboard: StartOnboard) -> None:
    """Byte for byte at the embedded simulator's own receiver, which fixes after five seconds of them."""
    spec = VehicleSpec(endpoints=("tcp:0",))
    epochs = [base_at() + satellites(1074, t_ms=500 * t) + message(1087, size=800, seed=t) for t in range(14)]
    with World([spec], ready_s=0.5, speed=1.0) as world:
        await onboard(fleet.router, world.urls[0], "quad1")
        states = fleet.net.ground(fleet.endpoint).samples(keys.STATE)
        await states.object(lambda s: s["connected"] and s["position"] is not None, "a position")
        async with fleet.publisher("gs") as one:
            for epoch in epochs:
                one.feed(epoch)
                await asyncio.sleep(0.5)
            state = await states.object(lambda s: (s.get("gps") or {}).get("fix") == "RTK_FIXED", "a fixed solution")
            after = len(states.items)
            state = await states.object(lambda s: bool(s.get("corrections")), "corrections", after)
            (vehicle,) = world.vehicles
            heard = list(vehicle.node.receiver.messages)
    assert b"".join(each.data for each in heard) == b"".join(epochs)
    assert state["corrections"]["source"] == "gs"
    assert state["corrections"]["baseline"] < 100
    assert state["corrections"]["dropped"] == {}
