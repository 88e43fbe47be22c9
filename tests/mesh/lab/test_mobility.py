"""Where hosts are, and what that does to their links."""

from __future__ import annotations

import asyncio
import math

import pytest

from mesh.lab.mobility import Mobility, reach
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


@pytest.mark.root
def test_driving_away_cuts_what_a_hand_has_not(able: None) -> None:
    found = scenario(
        hosts={"h1": {"position": [0, 0]}, "h2": {"position": [0, 0]}, "h3": {}},
        media=[{"kind": "radio", "name": "air", "range": {"free": 100, "cut": 200}, "loss": 0.5}],
    )
    with Network(found) as network:
        mobility = Mobility(network)
        edge = next(edge for edge in network.wiring.edges if edge.name == "h1-h2")
        seen = []
        for east in (0.0, 150.0, 250.0, 100.0):
            mobility.move("h2", 0.0, east)
            seen.append((network.state(edge.ab).up, network.state(edge.ba).loss))
        assert seen == [(True, 0.5), (True, pytest.approx(1 - 0.5 * 0.76)), (False, 0.5), (True, 0.5)]
        network.cut("1-2")
        mobility.update()
        assert not network.state(edge.ab).up
        mobility.move("h2", 0.0, 250.0)
        network.heal("1-2")
        assert not network.state(edge.ab).up  # it is still far away
        mobility.move("h1", 0.0, 250.0)
        assert network.state(edge.ab).up
        assert mobility.positions == {"h1": (0.0, 250.0), "h2": (0.0, 250.0)}
        other = next(edge for edge in network.wiring.edges if edge.name == "h1-h3")
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
    (edge,) = lab.network.wiring.edges
    assert lab.network.state(edge.ab).up  # nobody knows yet where it is

    async def out_of_range() -> None:
        while lab.network.state(edge.ab).up:
            await asyncio.sleep(0.05)

    await asyncio.wait_for(out_of_range(), 60.0)
    assert lab.mobility.positions["rover"] == pytest.approx((30.0, 400.0), abs=1.0)
