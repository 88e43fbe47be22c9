"""EV3: a square and a vertical rectangle, flown over EV1's cascade in wind and GPS noise: what it misses, it misses
near the corners. A receiver of one frequency makes more noise than that: the one here has corrections (RTK).
"""

from __future__ import annotations

import numpy as np
import pytest

from agents.controllers import Reference
from agents.controllers.ev1 import Ev1
from agents.controllers.stack import Stack
from agents.navigator.routes import shape
from agents.navigator.tracking import Errors, errors, summarise
from agents.navigator.trajectory import Limits, Trajectory
from tests.agents.controllers.flying import Cycles, Flight, Hexarotor, ReferenceAt

ROUTE = shape("ev3", (0.0, 0.0, -8.0), side=6.0, height=3.0)
TRAJECTORY = Trajectory(ROUTE, Limits(speed=1.0))


def along(begin: float) -> ReferenceAt:
    """At the route's beginning until then (s since the takeoff), and along it from then on."""

    def at(t: float) -> Reference:
        moment = TRAJECTORY.at(np.array([max(t - begin, 0.0)]))
        moving = 1.0 if t > begin else 0.0
        return Reference(pos=moment.pos[0], vel=moment.vel[0] * moving, acc=moment.acc[0] * moving)

    return at


def flown(craft: Hexarotor) -> Cycles[Errors]:
    controller, begin = Stack(Ev1()), 10.0
    yield from craft.fly_autopilot(along(begin), 8.0, controller)
    log = yield from craft.fly(controller, along(begin), 2.0 + TRAJECTORY.duration + 1.0)
    return errors(log.t - begin, log.pos, TRAJECTORY)


@pytest.mark.slow
@pytest.mark.timeout(400)  # it computes for a minute, alone
def test_what_it_misses_it_misses_near_the_corners() -> None:
    with Flight(wind=(3.0, 2.0, 0.0), noise="rtk", slow=10, height=8.0, ways=2, alike=False) as both:
        flights = both.together([flown(both[0]), flown(both[1])])
    for flight in flights:
        assert summarise(flight, ROUTE).rms < 0.2
    first = flights[0]
    mean = Errors(first.t, np.mean([flight.off for flight in flights], axis=0), first.along)
    summary = summarise(mean, ROUTE)
    assert len(summary.peaks) >= 3
    assert summary.share_near == 1.0, summary
    assert summary.time_near < 0.8, "nothing is far from a corner"
