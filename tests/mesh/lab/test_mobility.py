"""Where hosts are, and what that does to their links."""

from __future__ import annotations

import asyncio
import math

import pytest

from mesh.lab.mobility import Mobility, Track, reach
from mesh.lab.network import Network, Reach
from mesh.lab.scenario import Range
from tests.mesh.lab.conftest import StartLab, scenario
from zmav.errors import BadConfig

RANGE = Range(free=100.0, cut=200.0)


def test_a_range_has_three_parts() -> None:
    assert reach(RANGE, 0.0) == reach(RANGE, 100.0) == Reach()
    assert reach(RANGE, 150.0) == Reach(loss=0.24)
    assert reach(RANGE, 199.0).loss == pytest.approx(0.98)
    assert reach(RANGE, 200.0) == reach(RANGE, 1e6) == reach(RANGE, math.nan) == Reach(heard=False)


def test_a_track_goes_round() -> None:
    track = Track((0.0, 0.0), [(0.0, 30.0), (40.0, 30.0)], 10.0)  # 30 + 40 + 50 m
    assert track.at(0.0) == (0.0, 0.0)
    assert track.at(1.5) == pytest.approx((0.0, 15.0))
    assert track.at(7.0) == pytest.approx((40.0, 30.0))
    assert track.at(9.5) == pytest.approx((20.0, 15.0))
    assert track.at(12.0 + 1.5) == pytest.approx((0.0, 15.0))
    assert Track((5.0, 6.0), [], 1.0).at(100.0) == (5.0, 6.0)
    assert Track((5.0, 6.0), [(5.0, 6.0)], 1.0).at(100.0) == (5.0, 6.0)
    assert Track(None, [], 1.0).at(0.0) is None


@pytest.mark.root
def test_driving_away_cuts_what_a_hand_has_not(able: None) -> None:
    clock = [0.0]
    found = scenario(
        hosts={"h1": {"position": [0, 0]}, "h2": {"position": [0, 0], "waypoints": [[0, 1000]], "speed": 10}, "h3": {}},
        media=[{"kind": "radio", "name": "air", "range": {"free": 100, "cut": 200}, "loss": 0.5}],
    )
    with Network(found) as network:
        mobility = Mobility(network, lambda: clock[0])
        edge = next(edge for edge in network.links() if edge.name == "h1-h2")
        seen = []
        for clock[0] in (0.0, 15.0, 25.0, 190.0):
            mobility.update()
            seen.append((network.state(edge.ab).up, network.state(edge.ba).loss))
        assert seen == [(True, 0.5), (True, pytest.approx(1 - 0.5 * 0.76)), (False, 0.5), (True, 0.5)]
        network.cut("1-2")
        mobility.update()
        assert not network.state(edge.ab).up
        clock[0] = 25.0
        mobility.update()
        network.heal("1-2")
        assert not network.state(edge.ab).up  # it is still far away
        mobility.move("h1", 0.0, 250.0)
        assert network.state(edge.ab).up
        assert mobility.positions == {"h1": (0.0, 250.0), "h2": (0.0, 250.0)}
        other = next(edge for edge in network.links() if edge.name == "h1-h3")
        assert network.state(other.ab).loss == 0.5  # h3 has no place: it is near to all
        with pytest.raises(BadConfig, match="no host 'h9'"):
            mobility.move("h9", 0.0, 0.0)
        with pytest.raises(BadConfig, match="metres north and east"):
            mobility.move("h1", math.nan, 0.0)


@pytest.mark.root
async def test_a_host_is_where_its_simulated_vehicle_is(start_lab: StartLab) -> None:
    lab = await start_lab(
        hosts={
            "box": {"position": [0, 0], "program": "none"},
            "rover": {
                "vehicle": "rover",
                "program": "none",
                "follow": True,
                "sim": {"start_ned_m": [30.0, 400.0, 0.0]},
            },
        },
        media=[{"kind": "radio", "name": "air", "range": {"free": 100, "cut": 200}}],
    )
    (edge,) = lab.network.links()
    assert lab.network.state(edge.ab).up  # nobody knows yet where it is

    async def out_of_range() -> None:
        while lab.network.state(edge.ab).up:
            await asyncio.sleep(0.05)

    await asyncio.wait_for(out_of_range(), 60.0)
    assert lab.mobility.positions["rover"] == pytest.approx((30.0, 400.0), abs=1.0)


@pytest.mark.root
async def test_hosts_move_by_themselves(start_lab: StartLab) -> None:
    lab = await start_lab(
        programs=False,
        hosts={"h1": {"position": [0, 0]}, "h2": {"position": [0, 0], "waypoints": [[0, 1e6]], "speed": 1e5}},
        media=[{"kind": "radio", "name": "air", "range": {"free": 100, "cut": 200}}],
    )
    (edge,) = lab.network.links()

    async def out_of_range() -> None:
        while lab.network.state(edge.ab).up:
            await asyncio.sleep(0.02)

    await asyncio.wait_for(out_of_range(), 30.0)
    assert lab.mobility.positions["h1"] == (0.0, 0.0)
    assert math.dist(lab.mobility.positions["h2"], (0.0, 0.0)) >= 200.0
