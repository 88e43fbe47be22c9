"""The geometry of the last resort: who is about to meet, and the ways out."""

from __future__ import annotations

import math
from itertools import combinations, pairwise, product

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from zmav.services.authority.avoidance import STEP, STEPS, Motion, Other, escape, least, meets, ramp, straight
from zmav.wire import Vector

COPTER = Motion(5.0, 2.5, 2.0, 1.5)
DOWNWASH = 1.5
metres = st.floats(-20, 20)
places = st.tuples(metres, metres, metres)
speeds = st.tuples(st.floats(-4, 4), st.floats(-4, 4), st.floats(-1.5, 1.5))


@given(places, speeds, places, speeds)
def test_the_least_distance_is_that_of_fine_steps(p: Vector, v: Vector, q: Vector, w: Vector) -> None:
    away, when = least(straight(p, v), straight(q, w), DOWNWASH)
    found = math.inf
    for k in range(2501):
        t = k * STEPS * STEP / 2500
        n, e, d = (a + x * t - b - y * t for a, x, b, y in zip(p, v, q, w, strict=True))
        found = min(found, math.hypot(n, e, d / DOWNWASH))
    assert found - 0.02 <= away <= found + 1e-9
    assert 0.0 <= when <= STEPS * STEP


def test_those_that_go_apart_do_not_meet_however_near_they_are() -> None:
    own = straight((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    behind = Other("b", straight((-0.5, 0.0, 0.0), (-1.0, 0.0, 0.0)), 2.0)
    ahead = Other("c", straight((0.5, 0.0, 0.0), (-1.0, 0.0, 0.0)), 2.0)
    assert (meets(own, behind, DOWNWASH), meets(own, ahead, DOWNWASH)) == (False, True)


def test_a_ramp_keeps_to_the_acceleration() -> None:
    track = ramp((0.0, 0.0, 0.0), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0), 2.5)
    speeds = [[(b - a) / STEP for a, b in zip(p, q, strict=True)] for p, q in pairwise(track)]
    assert all(math.dist(a, b) / STEP <= 2.5 + 1e-9 for a, b in pairwise(speeds))
    assert math.dist(speeds[-1], (0.0, 3.0, 0.0)) < 0.4


@given(places, speeds, st.floats(6.0, 9.0), st.floats(0, math.tau), st.floats(-1.0, 1.0))
def test_two_that_fly_at_each_other_stay_apart(p: Vector, v: Vector, away: float, bearing: float, above: float) -> None:
    """Both choose at once and neither knows what the other does: flown for the whole horizon."""
    q = (p[0] + away * math.cos(bearing), p[1] + away * math.sin(bearing), p[2] + above)
    n, e, d = ((b - a) / 2.0 for a, b in zip(p, q, strict=True))
    v = (n, e, d)
    w = (-n, -e, -d)
    assume(math.hypot(*v) <= 5.0)
    distance = 1.5
    one = escape("a", p, v, v, [Other("b", straight(q, w), distance)], COPTER, DOWNWASH, lambda vel: True)
    two = escape("b", q, w, w, [Other("a", straight(p, v), distance)], COPTER, DOWNWASH, lambda vel: True)
    assert least(ramp(p, v, one, 2.5), ramp(q, w, two, 2.5), DOWNWASH)[0] >= distance


@pytest.mark.parametrize(("own", "other", "sign"), [("a", "b", 1.0), ("b", "a", -1.0)])
def test_of_two_that_are_level_the_later_name_goes_up(own: str, other: str, sign: float) -> None:
    against = [Other(other, straight((8.0, 0.0, 0.0), (-4.0, 0.0, 0.0)), 1.5)]
    walls = lambda vel: abs(vel[1]) < 0.1  # noqa: E731  no room beside
    out = escape(own, (0.0, 0.0, 0.0), (4.0, 0.0, 0.0), (4.0, 0.0, 0.0), against, COPTER, DOWNWASH, walls)
    assert out[2] * sign > 0.0


def test_nothing_beyond_what_is_allowed_nor_off_the_ground() -> None:
    against = [Other("b", straight((6.0, 0.0, 0.0), (-3.0, 0.0, 0.0)), 1.5)]
    rover = Motion(2.0, 1.0, 0.5, 0.5, flat=True)
    for name, east in product("ac", (1.0, -1.0)):

        def allowed(vel: Vector, side: float = east) -> bool:
            return vel[1] * side >= 0.0

        out = escape(name, (0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (2.0, 0.0, 0.0), against, rover, DOWNWASH, allowed)
        assert out[2] == 0.0
        assert out[1] * east >= 0.0
        assert out != (2.0, 0.0, 0.0)


def test_five_that_cross_at_one_point_stay_apart_and_come_through() -> None:
    """With perfect control, ten looks a second; without it they would all meet in the middle."""
    names = [f"quad{k}" for k in range(5)]
    pos: list[Vector] = [
        (12.0 * math.cos(k * math.tau / 5), 12.0 * math.sin(k * math.tau / 5), -10.0) for k in range(5)
    ]
    goals = [(-n, -e, d) for n, e, d in pos]
    vel: list[Vector] = [(0.0, 0.0, 0.0)] * 5
    nearest, ticks = math.inf, 0
    while max(math.dist(p, g) for p, g in zip(pos, goals, strict=True)) > 1.0:
        ticks += 1
        assert ticks < 300
        wanted = [_toward(p, g) for p, g in zip(pos, goals, strict=True)]
        chosen = []
        for k, name in enumerate(names):
            own = straight(pos[k], wanted[k])
            others = [Other(names[i], straight(pos[i], vel[i]), 1.5) for i in range(5) if i != k]
            near = any(meets(own, other, DOWNWASH, 1.15) for other in others)
            out = escape(name, pos[k], vel[k], wanted[k], others, COPTER, DOWNWASH, lambda vel: True)
            chosen.append(out if near else wanted[k])
        for k, out in enumerate(chosen):
            share = min(1.0, 0.25 / max(math.dist(out, vel[k]), 1e-9))
            n, e, d = (v + (w - v) * share for v, w in zip(vel[k], out, strict=True))
            vel[k], (x, y, z) = (n, e, d), pos[k]
            pos[k] = (x + 0.1 * n, y + 0.1 * e, z + 0.1 * d)
        for (n, e, d), (x, y, z) in combinations(pos, 2):
            nearest = min(nearest, math.hypot(n - x, e - y, (d - z) / DOWNWASH))
    assert nearest > 1.5


def _toward(p: Vector, goal: Vector) -> Vector:
    away = math.dist(p, goal)
    speed = min(3.0, math.sqrt(3.0 * away))
    n, e, d = ((b - a) * speed / max(away, 1e-9) for a, b in zip(p, goal, strict=True))
    return n, e, d
