"""Circles for planes: apart without any clock, whatever comes when."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from agents.planner.solve.loiter import STEADY, Circling, loiter_radius, loiter_slots, loiter_speed
from zmav.config import body_of
from zmav.errors import BadInput

BODY = body_of("plane")


def near(name: str, height: float, wish: float, east: float = 0.0) -> Circling:
    return Circling(name, BODY, (0.0, east, -height), (300.0, east, -wish))


def test_a_circle_is_one_that_the_plane_flies_at_ease() -> None:
    speed = loiter_speed(BODY)
    assert speed**2 / loiter_radius(BODY) <= BODY.accel and BODY.min_speed < speed <= BODY.speed


def test_planes_that_may_meet_get_heights_of_their_own_and_the_others_the_height_they_want() -> None:
    slots = loiter_slots([near("a", 60, 80), near("b", 100, 80), near("c", 70, 80, east=5000.0)], 30.0, 300.0, 1.5)
    heights = {slot.vehicle: -slot.centre_ned[2] for slot in slots}
    assert heights["a"] == 80.0 and heights["c"] == 80.0
    assert heights["b"] - heights["a"] == pytest.approx(1.5 * 8.0 + 2.0 * STEADY)


def test_nobody_passes_anybody_whatever_the_delays() -> None:
    """Every order of events that ``first`` allows: no two planes are ever on heights less than a radius' sum apart."""
    rng = np.random.default_rng(3)
    for _ in range(150):
        count = int(rng.integers(2, 7))
        gap = 1.5 * 8.0 + 2.0 * STEADY
        starts = np.cumsum(rng.uniform(gap, 2.5 * gap, count)) + rng.uniform(0.0, 100.0)
        planes = [near(f"p{k}", starts[k], rng.uniform(20.0, 300.0)) for k in range(count)]
        planes = [planes[k] for k in rng.permutation(count)]
        slots = {slot.vehicle: slot for slot in loiter_slots(planes, 20.0, 600.0, 1.5)}
        at = {plane.vehicle: -plane.pos_ned[2] for plane in planes}
        waiting = set(at)
        while waiting:
            able = [name for name in waiting if not waiting & set(slots[name].first)]
            assert able, "somebody waits for himself"
            name = able[int(rng.integers(len(able)))]
            low, high = sorted((at[name], -slots[name].centre_ned[2]))
            for other, height in at.items():
                assert other == name or height <= low - gap + 1e-6 or height >= high + gap - 1e-6
            at[name] = -slots[name].centre_ned[2]
            waiting.discard(name)
        assert all(abs(a - b) >= gap - 1e-6 for a, b in itertools.combinations(at.values(), 2))


def test_no_room_is_said() -> None:
    with pytest.raises(BadInput, match="do not fit into 50 m") as raised:
        loiter_slots([near(f"p{k}", 40.0 + 25.0 * k, 60.0) for k in range(4)], 30.0, 80.0, 1.5)
    assert raised.value.detail["field"] == "vehicles"
