"""Trajectory segments: smooth from point to point, at rest at their end, held to the fence and the limits all along."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zmav import geo, wire
from zmav.autopilots import Target
from zmav.config import Geofence, Limits
from zmav.errors import BadInput
from zmav.services.authority.limits import Fence, check
from zmav.services.authority.trajectory import MAX_POINTS, Segment

ORIGIN = wire.Origin(lat_deg=-35.0, lon_deg=149.0, alt_amsl=600.0)
HOME = 600.0
NOW = 1_800_000_000.0
ZERO = (0.0, 0.0, 0.0)


def point(t: float, pos: wire.Vector, **more: Any) -> wire.SegmentPoint:
    return wire.SegmentPoint(t=NOW + t, pos=pos, **more)


def segment(*points: wire.SegmentPoint) -> Segment:
    return Segment(list(points), ORIGIN, NOW)


def local(target: Target) -> wire.Vector:
    assert target.lat_deg is not None and target.lon_deg is not None and target.alt_amsl is not None
    return geo.to_ned(ORIGIN, target.lat_deg, target.lon_deg, target.alt_amsl)


def near(a: wire.Vector | None, b: wire.Vector, within: float) -> bool:
    assert a is not None
    return math.dist(a, b) <= within


metres = st.floats(-100, 100)
vectors = st.tuples(metres, metres, metres)
slow = st.none() | st.tuples(st.floats(-5, 5), st.floats(-5, 5), st.floats(-5, 5))


@st.composite
def plans(draw: st.DrawFn) -> list[wire.SegmentPoint]:
    t, points = 0.0, []
    for _ in range(draw(st.integers(2, 6))):
        points.append(point(t, draw(vectors), vel=draw(slow), acc=draw(slow)))
        t += draw(st.floats(0.5, 5.0))
    points[-1].vel = draw(st.sampled_from([None, ZERO]))
    return points


@given(plans())
def test_it_goes_through_its_points(points: list[wire.SegmentPoint]) -> None:
    way = segment(*points)
    assert (way.start, way.end) == (points[0].t, points[-1].t)
    for each in points:
        target = way.at(each.t)
        assert target.level == "trajectory"
        assert near(local(target), each.pos, 1e-4)
        if each.vel is not None and each is not points[-1]:
            assert near(target.vel, each.vel, 1e-3)


@given(plans())
def test_position_and_velocity_never_jump(points: list[wire.SegmentPoint]) -> None:
    """Both sides of every point agree, and the velocity is the position's own slope in between."""
    way, dt = segment(*points), 1e-3
    for piece, after in zip(way.pieces, way.pieces[1:], strict=False):
        end, begin = piece.at(after.start), after.at(after.start)
        assert near(end[0], begin[0], 1e-6)
        assert near(end[1], begin[1], 1e-6)
    for piece in way.pieces:
        for share in (0.1, 0.35, 0.5, 0.9):
            t = piece.start + share * piece.step
            before, now, after_it = piece.at(t - dt), piece.at(t), piece.at(t + dt)
            for slope, value in ((0, now[1]), (1, now[2])):
                difference = tuple((b - a) / (2 * dt) for a, b in zip(before[slope], after_it[slope], strict=True))
                assert near(value, (difference[0], difference[1], difference[2]), 0.05 + 0.01 * math.hypot(*value))


@given(plans(), st.floats(0.001, 1000.0))
def test_before_and_after_it_rests(points: list[wire.SegmentPoint], away: float) -> None:
    way = segment(*points)
    for t, where in ((way.start - away, points[0].pos), (way.end, points[-1].pos), (way.end + away, points[-1].pos)):
        target = way.at(t)
        assert near(local(target), where, 1e-4)
        assert (target.vel, target.acc) == (ZERO, ZERO)
    assert near(way.at(way.end - 1e-6).vel, ZERO, 1e-2), "it comes to rest by itself"


def test_a_straight_line_at_constant_speed_is_one() -> None:
    v = (2.0, 0.0, 0.0)
    way = segment(
        point(0.0, (0.0, 0.0, -5.0), vel=v), point(5.0, (10.0, 0.0, -5.0), vel=v), point(10.0, (15.0, 0.0, -5.0))
    )
    for t in (0.5, 2.0, 4.9):
        target = way.at(NOW + t)
        assert near(local(target), (2.0 * t, 0.0, -5.0), 1e-3)
        assert near(target.vel, v, 1e-6)
        assert near(target.acc, ZERO, 1e-6)


def test_accelerations_make_it_a_quintic() -> None:
    a, b = (1.0, 0.0, 0.0), (0.0, -1.0, 0.0)
    way = segment(point(0.0, ZERO, vel=ZERO, acc=a), point(4.0, (5.0, 5.0, 0.0), vel=ZERO, acc=b))
    assert near(way.at(NOW).acc, a, 1e-9)
    assert near(way.pieces[0].at(NOW + 4.0)[2], b, 1e-6)
    # From rest to rest without them it is 3s² - 2s³ of the way.
    cubic = segment(point(0.0, ZERO), point(4.0, (8.0, 0.0, 0.0)))
    assert near(local(cubic.at(NOW + 1.0)), (8.0 * (3 / 16 - 2 / 64), 0.0, 0.0), 1e-3)
    assert near(cubic.at(NOW + 2.0).vel, (3.0, 0.0, 0.0), 1e-6)


def test_points_without_a_velocity_pass_with_the_mean() -> None:
    way = segment(point(0.0, ZERO), point(2.0, (4.0, 0.0, 0.0)), point(4.0, (4.0, 8.0, 0.0)))
    assert near(way.at(NOW + 2.0).vel, (1.0, 2.0, 0.0), 1e-6)


def test_yaw_turns_the_short_way() -> None:
    way = segment(point(0.0, ZERO, yaw=3.0), point(2.0, ZERO, yaw=-3.0), point(3.0, ZERO, yaw=-3.0))
    yaws = [way.at(NOW + t).yaw for t in (-1.0, 0.0, 1.0, 2.5, 9.0)]
    assert [math.cos(yaw or 0.0) for yaw in yaws] == pytest.approx([math.cos(y) for y in (3, 3, math.pi, -3, -3)])
    assert yaws[2] == pytest.approx(math.pi)
    assert segment(point(0.0, ZERO), point(2.0, ZERO)).at(NOW).yaw is None


P0, P1 = point(0.0, ZERO), point(1.0, (1.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("points", "field", "words"),
    [
        ([], "segment", "from 2 to"),
        ([P0], "segment", "from 2 to"),
        ([P0] * (MAX_POINTS + 1), "segment", "from 2 to"),
        ([P0, point(0.0, ZERO)], "segment[1].t", "0 s after"),
        ([P0, point(-1.0, ZERO)], "segment[1].t", "-1 s after"),
        ([P0, point(0.01, ZERO)], "segment[1].t", "after the point before"),
        ([P0, P1, point(100.0, ZERO)], "segment[2].t", "99 s after"),
        ([P0, point(math.nan, ZERO)], "segment[1].t", "not finite"),
        ([point(61.0, ZERO), point(62.0, ZERO)], "segment[0].t", "is a clock off"),
        ([point(-6.0, ZERO), P1], "segment[0].t", "-6.0 s from now"),
        ([point(0.0, (math.inf, 0.0, 0.0)), P1], "segment[0].pos", "not finite"),
        ([P0, point(1.0, (0.0, 2e5, 0.0))], "segment[1].pos", "within"),
        ([P0, point(1.0, ZERO, acc=(math.nan, 0.0, 0.0))], "segment[1].acc", "not finite"),
        ([P0, point(1.0, ZERO, vel=(2e3, 0.0, 0.0)), point(2.0, ZERO)], "segment[1].vel", "within"),
        ([P0, point(1.0, ZERO, vel=(0.5, 0.0, 0.0))], "segment[1].vel", "ends at rest"),
        ([P0, point(1.0, ZERO, yaw=1.0)], "segment[1].yaw", "or none"),
        ([point(0.0, ZERO, yaw=math.nan), P1], "segment[0].yaw", "not finite"),
    ],
)
def test_faults_name_their_point(points: list[wire.SegmentPoint], field: str, words: str) -> None:
    with pytest.raises(BadInput, match=words) as caught:
        segment(*points)
    assert caught.value.detail["field"] == field
    wire.error_body(caught.value)


def test_it_needs_an_origin() -> None:
    with pytest.raises(BadInput, match="none is declared"):
        Segment([P0, P1], None, NOW)


def fence(corners: list[tuple[float, float]] | None = None, **more: Any) -> Fence:
    polygon = [geo.to_global(ORIGIN, (n, e, 0.0))[:2] for n, e in corners or []]
    return Fence(Geofence(polygon=polygon, **more), ORIGIN, ground=False)


SQUARE = [(50.0, 50.0), (50.0, -50.0), (-50.0, -50.0), (-50.0, 50.0)]
HORSESHOE = [
    (50.0, 50.0),
    (50.0, -50.0),
    (-50.0, -50.0),
    (-50.0, -20.0),
    (30.0, -20.0),
    (30.0, 20.0),
    (-50.0, 20.0),
    (-50.0, 50.0),
]


def refused(way: Segment, which: Fence | None, limits: Limits | None = None, **more: Any) -> tuple[str, str] | None:
    try:
        way.check(which, limits, HOME, **more)
    except BadInput as e:
        return e.detail["count"], e.detail["field"]
    return None


def test_the_fence_is_held_between_the_points_too() -> None:
    """It swings out beyond the edge between two points that are both within."""
    fast = (15.0, 0.0, 0.0)
    swing = segment(
        point(0.0, (40.0, 0.0, -5.0), vel=fast),
        point(5.0, (40.0, 10.0, -5.0), vel=(-15.0, 0.0, 0.0)),
        point(15.0, (0.0, 10.0, -5.0)),
    )
    assert max(local(swing.at(NOW + i / 10))[0] for i in range(51)) > 51.0
    for each in (fence(SQUARE), fence(HORSESHOE), fence(radius=50.0)):
        assert refused(swing, each) == ("fence", "segment[0..1].pos")
    calm = segment(point(0.0, (40.0, 0.0, -5.0), vel=(2.0, 0.0, 0.0)), point(5.0, (40.0, 10.0, -5.0)))
    assert refused(calm, fence(SQUARE)) is None
    assert refused(calm, fence(HORSESHOE)) is None


def test_a_bay_is_not_crossed() -> None:
    across = segment(point(0.0, (-30.0, -30.0, -5.0)), point(10.0, (-30.0, 30.0, -5.0)))
    around = segment(
        point(0.0, (-30.0, -35.0, -5.0)),
        point(10.0, (40.0, -35.0, -5.0), vel=ZERO),
        point(20.0, (40.0, 35.0, -5.0), vel=ZERO),
        point(30.0, (-30.0, 35.0, -5.0)),
    )
    assert refused(across, fence(SQUARE)) is None
    assert refused(across, fence(HORSESHOE)) == ("fence", "segment[0..1].pos")
    assert refused(around, fence(HORSESHOE)) is None


def test_ceiling_and_floor_count_from_home() -> None:
    hop = segment(point(0.0, (0.0, 0.0, -5.0)), point(3.0, (0.0, 0.0, -9.0), vel=ZERO), point(6.0, (0.0, 0.0, -5.0)))
    assert refused(hop, fence(ceiling=9.0, floor=5.0)) is None
    assert refused(hop, fence(ceiling=8.0)) == ("fence", "segment[0..1].pos")
    assert refused(hop, fence(floor=6.0)) == ("fence", "segment[0..1].pos")
    assert refused(hop, fence(floor=6.0), flat=True) is None
    with pytest.raises(BadInput, match="not known yet"):
        hop.check(fence(ceiling=9.0), None, None)


@pytest.mark.parametrize(
    ("limits", "count", "field"),
    [
        (Limits(speed=2.9), "speed", "segment[0..1].vel"),
        (Limits(climb=1.4), "climb", "segment[0..1].vel"),
        (Limits(descend=0.9), "descend", "segment[1..2].vel"),
        (Limits(accel=3.3), "accel", "segment[0..1].acc"),
        (Limits(yaw_rate=0.2), "yaw_rate", "segment[0..1].yaw"),
    ],
)
def test_limits_hold_between_the_points(limits: Limits, count: str, field: str) -> None:
    """From rest to rest the points themselves are still; the fastest is in the middle: 1.5 times the mean."""
    way = segment(
        point(0.0, ZERO, yaw=0.0),
        point(4.0, (8.0, 0.0, -4.0), vel=ZERO, yaw=1.0),
        point(8.0, (8.0, 0.0, -1.0), yaw=1.0),
    )
    assert refused(way, None, limits) == (count, field)
    wider = Limits(speed=3.0, climb=1.5, descend=1.125, accel=3.4, yaw_rate=0.25)
    assert refused(way, None, wider) is None


@given(plans(), st.floats(1.0, 12.0))
def test_limits_agree_with_a_close_look(points: list[wire.SegmentPoint], speed: float) -> None:
    way, limits = segment(*points), Limits(speed=speed)
    looks = [way.at(way.start + i * (way.end - way.start) / 400).vel or ZERO for i in range(400)]
    fastest = max(math.hypot(v[0], v[1]) for v in looks)
    if fastest > speed * 1.002:
        assert refused(way, None, limits) is not None
    elif fastest < speed * 0.95:
        assert refused(way, None, limits) is None


@given(plans(), st.booleans(), st.floats(20.0, 120.0))
def test_the_fence_agrees_with_a_close_look(points: list[wire.SegmentPoint], bay: bool, size: float) -> None:
    way = segment(*points)
    around = fence([(n * size / 50.0, e * size / 50.0) for n, e in (HORSESHOE if bay else SQUARE)])
    looks = [way.at(way.start + i * (way.end - way.start) / 300) for i in range(301)]
    depths = [around.to_edge(*local(look)[:2]) * (1 if within(look, around) else -1) for look in looks]
    if min(depths) < -0.1:
        assert refused(way, around) is not None
    elif min(depths) > 2.0:
        assert refused(way, around) is None


def within(target: Target, around: Fence) -> bool:
    try:
        check(target, around, None, HOME, None)
    except BadInput:
        return False
    return True


def test_it_rests_from_the_first_point_of_its_last_place_on() -> None:
    here, there = (0.0, 0.0, -10.0), (6.0, 0.0, -10.0)
    assert segment(point(0.0, here), point(4.0, there), point(9.0, there), point(12.0, there)).rests == NOW + 4.0
    assert segment(point(0.0, here), point(4.0, there), point(9.0, here)).rests == NOW + 9.0
    assert segment(point(0.0, here), point(5.0, here)).rests == NOW
