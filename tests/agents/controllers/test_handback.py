"""Back to the autopilot at any moment of an aggressive flight: the upset stays within the autopilot's own envelope."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest

from agents.controllers.ev1 import Ev1, Ev1Attitude
from agents.controllers.ev2 import Ev2
from agents.controllers.stack import Stack
from tests.agents.controllers.flying import CYCLE, Cycles, Flight, Hexarotor, circle

LEAN_MOST = math.radians(45.0)
"""MPC_TILTMAX_AIR"""
RATE_MOST = math.radians(220.0)
"""MC_ROLLRATE_MAX, MC_PITCHRATE_MAX"""
SLACK = 1.1
"""the autopilot's own loops overshoot what they ask for"""


TIMES = 5
"""that each is switched back"""
WAYS: tuple[type[Ev1 | Ev2 | Ev1Attitude], ...] = (Ev1,) * 4 + (Ev2,) * 3 + (Ev1Attitude,) * 2
"""what flies"""


def switched_back(craft: Hexarotor, way: int) -> Cycles[float]:
    """Fly it; the most that it leant before a switch, rad."""
    kind, moments, around, leant = WAYS[way], random.Random(way), circle(3.0, 4.0, height=20.0), 0.0
    controller = Stack(kind())
    yield from craft.fly_autopilot(around, 3.0, controller)
    for moment in range(TIMES):
        before = yield from craft.fly(controller, around, moments.uniform(0.3, 1.5))
        leant = max(leant, float(before.lean().max()))
        after = yield from craft.hand_back(2.5)
        upset = f"{kind.__name__}, way {way}, moment {moment}"
        # What it was handed over with is no fault of the autopilot's; from there it only gets better.
        assert after.lean().max() < max(LEAN_MOST, float(before.lean()[-1])) * SLACK, upset
        handed = float(np.abs(before.rates[-1][:2]).max())
        assert np.abs(after.rates[:, :2]).max() < max(RATE_MOST, handed) * SLACK, upset
        assert abs(after.pos[-1, 2] - before.pos[-1, 2]) < 2.0, upset
        fast = float(np.linalg.norm(before.vel[-1]))  # up to 6 m/s, where it chased its circle
        for wait, most in ((1.5, max(1.5, fast - 3.0)), (2.5, 1.5)):
            assert np.linalg.norm(after.vel[round(wait / CYCLE) - 1]) < most, f"{upset}, {wait:g} s later"
    return leant


@pytest.mark.slow
@pytest.mark.timeout(300)  # it computes for 8 s where nothing else runs
def test_switches_back_in_aggressive_flight() -> None:
    weather = {"wind": (4.0, 0.0, 0.0), "gusts": "light", "noise": "typical", "seed": 5}
    with Flight(**weather, slow=10, height=20.0, ways=len(WAYS)) as flight:  # type: ignore[arg-type]
        leant = flight.together([switched_back(flight[way], way) for way in range(len(WAYS))])
    assert min(leant) > math.radians(20.0), "nothing about that flight was aggressive"
