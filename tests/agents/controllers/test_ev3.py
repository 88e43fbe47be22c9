"""EV3: a square and a vertical rectangle, flown over EV1's cascade in wind and GPS noise: what it misses, it misses
near the corners. A receiver of one frequency makes more noise than that: the one here has corrections (RTK).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from agents.controllers import Reference
from agents.controllers.ev1 import Ev1
from agents.controllers.stack import Stack
from agents.navigator.routes import Route, shape
from agents.navigator.tracking import Errors, errors, summarise
from agents.navigator.trajectory import Limits, Trajectory
from tests.agents.controllers.flying import COARSE_CYCLE, Cycles, Flight, Hexarotor, ReferenceAt

ROUTE = shape("ev3", (0.0, 0.0, -8.0), side=6.0, height=3.0)
HALVES = (
    replace(ROUTE, stages=ROUTE.stages[:4]),
    replace(ROUTE, stages=ROUTE.stages[3:], begins=ROUTE.stages[3].piece.length),
)
"""the square and the rectangle: flown at once, the rectangle from the square's last side on, which counts for nothing
there, so that the corner between them is turned
"""
BEGIN = 7.0
"""s since the takeoff: until then it flies to its first corner, and rests there"""


def along(trajectory: Trajectory) -> ReferenceAt:
    """At the trajectory's beginning until BEGIN, and along it from then on: a table, by cycles."""
    rows = trajectory.at(np.arange(0, round((trajectory.duration + 2.0) / COARSE_CYCLE), dtype=float) * COARSE_CYCLE)

    def at(t: float) -> Reference:
        k = max(round((t - BEGIN) / COARSE_CYCLE), 0)
        moving = 1.0 if k else 0.0
        return Reference(pos=rows.pos[k], vel=rows.vel[k] * moving, acc=rows.acc[k] * moving)

    return at


def flown(craft: Hexarotor, route: Route) -> Cycles[Errors]:
    controller, trajectory = Stack(Ev1()), Trajectory(route, Limits(speed=1.0))
    at = along(trajectory)
    yield from craft.fly_autopilot(at, BEGIN - 2.0, controller)
    log = yield from craft.fly(controller, at, 2.0 + trajectory.duration + 1.0)
    return errors(log.t - BEGIN, log.pos, trajectory)


def joined(square: Errors, upright: Errors) -> Errors:
    """As if one had flown both."""
    return Errors(
        np.concatenate([square.t, upright.t + square.t[-1]]),
        np.concatenate([square.off, upright.off]),
        np.concatenate([square.along, upright.along + HALVES[0].length]),
    )


@pytest.mark.slow
@pytest.mark.timeout(400)  # half a minute alone
def test_what_it_misses_it_misses_near_the_corners() -> None:
    with Flight(wind=(3.0, 2.0, 0.0), noise="rtk", slow=8, height=8.0, ways=4, alike=False, coarse=True) as flight:
        halves = flight.together([flown(flight[way], HALVES[way % 2]) for way in range(4)])
    flights = [joined(*halves[:2]), joined(*halves[2:])]
    for each in flights:
        assert summarise(each, ROUTE).rms < 0.2
    first = flights[0]
    mean = Errors(first.t, np.mean([each.off for each in flights], axis=0), first.along)
    summary = summarise(mean, ROUTE)
    assert len(summary.peaks) >= 3
    assert summary.share_near == 1.0, summary
    assert summary.time_near < 0.8, "nothing is far from a corner"
