"""When a vehicle that returns is home: over a rally point as well, on a wider circle, and where it is to stay above."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import pytest

import zmav
from tests.failsafe.test_px4_flight import HOME
from zmav import geo, wire
from zmav.sim import VehicleSpec, World
from zmav.waiting import within

if TYPE_CHECKING:
    from tests.conftest import Net, StartOnboard
    from tests.services.missions.mission_peer import MissionBench

PATIENCE_S = 100.0
RTL = 6
RALLY = (HOME.lat_deg + 0.0003, HOME.lon_deg + 0.0002)
"""some 33 m north and 18 m east"""


@pytest.mark.parametrize("rally", [True, False])
async def test_a_rover_is_home_where_it_returns_to(net: Net, onboard: StartOnboard, *, rally: bool) -> None:
    with World([VehicleSpec(autopilot="ardurover")], endpoint="tcp:127.0.0.1:0", speed=6.0, ready_s=1.0) as world:
        session, endpoint = net.router()
        await onboard(session, world.urls[0], origin=HOME)
        async with zmav.open(connect=[endpoint]) as z:
            (vehicle,) = await z.wait_for("quad1")
            await vehicle.wait_until(lambda s: bool(s.connected and s.ready), 30.0)
            start = world.vehicles[0].status().ned_m
            await vehicle.arm()
            await vehicle.goto(pos=(18.0, 0.0, 0.0))
            if rally:
                item = wire.MissionItem(command="MAV_CMD_NAV_RALLY_POINT", x=RALLY[0], y=RALLY[1], z=10.0)
                await vehicle.missions.upload([item], kind="rally")
            ended = await within(PATIENCE_S, vehicle.order("rtl", wire.Order()))
            assert ended["away"] <= 5.0 and ended["armed"]
            place = geo.to_ned(HOME, *RALLY, HOME.alt_amsl) if rally else start
            here = world.vehicles[0].status().ned_m  # what it last said may be older
            assert math.dist(here[:2], place[:2]) < 12.0


async def test_a_plane_is_home_on_its_circle_there(net: Net, onboard: StartOnboard) -> None:
    """RTL_RADIUS is another than the one it flies elsewhere."""
    spec = VehicleSpec(autopilot="arduplane", params={"RTL_RADIUS": 200.0})
    with World([spec], endpoint="tcp:127.0.0.1:0", speed=6.0, ready_s=1.0) as world:
        session, endpoint = net.router()
        await onboard(session, world.urls[0], origin=HOME)
        async with zmav.open(connect=[endpoint]) as z:
            (vehicle,) = await z.wait_for("quad1")
            await vehicle.wait_until(lambda s: bool(s.connected and s.ready), 30.0)
            await vehicle.arm()
            await vehicle.takeoff(50.0)
            await vehicle.goto(pos=(400.0, 0.0, -60.0))
            ended = await within(PATIENCE_S, vehicle.order("rtl", wire.Order()))
            assert 104.0 < ended["away"] <= 260.0


async def test_a_copter_that_stays_above_home_is_home_there(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    await b.flying()
    known = {"RTL_ALT_FINAL": 500.0}
    b.vehicle.flight.param = known.get
    lat, lon = int(-35.36e7), int(149.16e7)
    peer.send("HOME_POSITION", latitude=lat, longitude=lon, altitude=600_000)

    def at_rest(told: Any) -> None:
        if peer.mode == RTL:
            peer.send("GLOBAL_POSITION_INT", lat=lat, lon=lon, alt=605_000, relative_alt=5_000)

    peer.on_told = at_rest
    ended = await within(PATIENCE_S, b.ground.do("rtl"))
    assert (ended.result["armed"], round(ended.result["away"])) == (True, 0)
