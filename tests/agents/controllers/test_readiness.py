"""The rate at which the autopilot's state comes: enough, less than was asked for, and too little."""

from __future__ import annotations

import pytest

from agents.controllers.estimate import Estimate
from agents.controllers.readiness import check_ready
from zmav import wire
from zmav.errors import Refused

FLYING = wire.VehicleState(
    t=0.0,
    fleet="demo",
    name="quad1",
    instance="i",
    armed=True,
    landed=False,
    position=wire.GlobalPosition(lat_deg=47.0, lon_deg=8.0, alt_amsl=500.0, alt_rel=10.0),
)


def estimate(hz: float) -> Estimate:
    one = Estimate((1, 2, 3, 4))
    zero = {"q1": 1.0, **dict.fromkeys(("q2", "q3", "q4", "rollspeed", "pitchspeed", "yawspeed"), 0.0)}
    one.local({"time_boot_ms": 1000, **dict.fromkeys(("x", "y", "z", "vx", "vy", "vz"), 0.0)})
    for ms in (1000, 1005, 1010):
        one.attitude({"time_boot_ms": ms, **zero})
    one.period = 1.0 / hz
    return one


def test_a_controller_flies_at_the_rate_that_the_link_gives_and_says_so() -> None:
    assert check_ready(FLYING, estimate(249.0), 250.0) == ""
    assert "at 181 Hz" in check_ready(FLYING, estimate(181.0), 250.0)  # as a PX4 in software in the loop gives it
    with pytest.raises(Refused, match="at 100 Hz of 250"):
        check_ready(FLYING, estimate(100.0), 250.0)


def test_places_of_different_moments_are_not_held_against_each_other() -> None:
    """A local position from the ground and a global one from 10 m above it say nothing of where the origins lie."""
    one = Estimate((1, 2, 3, 4))
    one.anchor(wire.GlobalPosition(lat_deg=47.0, lon_deg=8.0, alt_amsl=500.0, alt_rel=0.0), (0.0, 0.0, 0.0))
    still = dict.fromkeys(("x", "y", "z", "vx", "vy", "vz"), 0.0)
    above = {"lat": 470000000, "lon": 80000000, "alt": 510000}
    one.local({"time_boot_ms": 1000, **still})
    one.globally({"time_boot_ms": 6000, **above})
    one.local({"time_boot_ms": 6100, **still, "z": -10.5})
    assert one.state.pos == pytest.approx((0.0, 0.0, -10.5))
    one.globally({"time_boot_ms": 6100, **above})
    assert one.state.pos == pytest.approx((0.0, 0.0, -10.0), abs=1e-6), "what takes over now begins about one origin"
    one.local({"time_boot_ms": 6120, **still, "z": -10.5})
    assert one.state.pos == pytest.approx((0.0, 0.0, -10.0), abs=1e-6)
