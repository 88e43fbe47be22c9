"""The segments of who follows, and of a plan: each joined to what is flown, at a point of it."""

from __future__ import annotations

import numpy as np
import pytest

from agents.planner.execute.commit import Entry
from agents.planner.execute.conductor import LEAD
from agents.planner.execute.rows import head_of, knot
from agents.planner.execute.track import Profile
from zmav.services.authority.trajectory import MIN_STEP

FLOWN = np.array([[0.5 * k, 1.0 * k, 0.0, 8.0, 2.0, 0.0, 0.0] for k in range(20)])
"""t, place, velocity every half second"""


@pytest.mark.parametrize("before", [0.0005, 0.0175, 0.019, 0.021, 0.1, 0.49, 4.3, 4.8, 30.0])
def test_no_point_is_so_near_to_the_next_that_a_vehicle_refuses_it(before: float) -> None:
    now = 5.0 + before - LEAD
    entry = Entry(Profile.resting(0.0, 9.5), FLOWN, 0.0, 9.5)
    d = knot(entry, now + LEAD)
    head = head_of(entry, d, now)
    assert len(head) >= 2
    assert head[0, 0] <= now
    assert head[-1, 0] == pytest.approx(d) and d >= now + LEAD
    assert np.diff(head[:, 0]).min() > MIN_STEP
