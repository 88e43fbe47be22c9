"""The segments of who follows: each joined to what is flown, wherever in between two of its points."""

from __future__ import annotations

import numpy as np
import pytest

from agents.planner.live.tracking import LEAD, head_of
from zmav.services.authority.trajectory import MIN_STEP

FLOWN = np.array([[0.5 * k, 1.0 * k, 0.0, 8.0, 2.0, 0.0, 0.0] for k in range(20)])
"""t, place, velocity every half second"""


@pytest.mark.parametrize("before", [0.0005, 0.0175, 0.019, 0.021, 0.1, 0.49])
def test_no_point_is_so_near_to_the_next_that_a_vehicle_refuses_it(before: float) -> None:
    d = 5.0 + before
    head = head_of(FLOWN, d, d - LEAD)
    assert len(head) >= 2
    assert head[0, 0] <= d - LEAD
    assert np.diff([*head[:, 0], d]).min() > MIN_STEP
