"""Delays of a mission: a time of day is the next time that it is so late (UTC)."""

from __future__ import annotations

import pytest

from zmav.sim.autopilots.ardupilot.waits import delay
from zmav.sim.autopilots.items import Item

NOON = 20_000 * 86400.0 + 12 * 3600.0 + 30.0  # half a minute past


@pytest.mark.parametrize(
    ("params", "seconds"),
    [
        ((7.0, 0.0, 0.0, 0.0), 7.0),
        ((0.0, 12.0, 1.0, 0.0), 30.0),
        ((0.0, 12.0, 0.0, 0.0), 86370.0),
        ((0.0, -1.0, 0.0, 20.0), 3590.0),
        ((0.0, -1.0, -1.0, 20.0), 50.0),
        ((0.0, -1.0, -1.0, -1.0), 0.0),
    ],
)
def test_a_delay_lasts_so_long(params: tuple[float, float, float, float], seconds: float) -> None:
    p1, p2, p3, p4 = params
    assert delay(Item(command=93, p1=p1, p2=p2, p3=p3, p4=p4), NOON) == pytest.approx(seconds)
