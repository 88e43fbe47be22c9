"""The geofence and the limits: what is within, what is not, and which of them says so."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zmav import geo, wire
from zmav.autopilots import Target
from zmav.config import Geofence, Limits
from zmav.errors import BadConfig, BadInput
from zmav.services.authority.limits import LOOKAHEAD, Fence, Here, check
from zmav.services.authority.targets import resolve

ORIGIN = wire.Origin(lat_deg=-35.0, lon_deg=149.0, alt_amsl=600.0)
HOME = 600.0
SQUARE = [(100.0, 100.0), (100.0, -100.0), (-100.0, -100.0), (-100.0, 100.0)]
BAY = [(100.0, 100.0), (100.0, -100.0), (-100.0, -100.0), (-100.0, 100.0), (-100.0, 20.0), (50.0, 0.0), (-100.0, 40.0)]
"""north and east; it is checked below that this one crosses itself"""
HORSESHOE = [
    (100.0, 100.0),
    (100.0, -100.0),
    (-100.0, -100.0),
    (-100.0, -20.0),
    (50.0, -20.0),
    (50.0, 20.0),
    (-100.0, 20.0),
    (-100.0, 100.0),
]
"""open to the south: its two legs are joined in the north only"""


def fence(corners: list[tuple[float, float]] | None = None, origin: wire.Origin = ORIGIN, **more: Any) -> Fence:
    polygon = [geo.to_global(origin, (n, e, 0.0))[:2] for n, e in corners or []]
    return Fence(Geofence(polygon=polygon, **more), origin, ground=False)


def at(north: float, east: float, up: float = 10.0, origin: wire.Origin = ORIGIN, **more: Any) -> Target:
    point = wire.Setpoint(lease="", seq=0, deadline=0.0, pos=(north, east, -up), **more)
    return resolve(point, origin)


def here(north: float, east: float, up: float = 10.0, vel: wire.Vector = (0.0, 0.0, 0.0)) -> Here:
    lat, lon, _ = geo.to_global(ORIGIN, (north, east, 0.0))
    return Here(lat, lon, up, vel)


def refused(target: Target, which: Fence | None, limits: Limits | None = None, **more: Any) -> str | None:
    """What counts the refusal; None: it is let through."""
    try:
        check(target, which, limits, HOME, **{"here": None, **more})
    except BadInput as e:
        assert e.detail["field"]
        wire.error_body(e)
        return str(e.detail["count"])
    return None


@pytest.mark.parametrize(
    ("north", "east", "within"),
    [
        (0.0, 0.0, True),
        (99.9, -99.9, True),
        (100.0, 0.0, True),
        (100.0, 100.0, True),
        (0.0, -100.0, True),
        (100.1, 0.0, False),
        (0.0, 100.1, False),
        (-100.1, -100.1, False),
        (5000.0, 0.0, False),
    ],
)
def test_a_polygon_with_its_edge(north: float, east: float, within: bool) -> None:
    for corners in (SQUARE, SQUARE[::-1], [*SQUARE, SQUARE[0]]):
        assert (refused(at(north, east), fence(corners)) is None) is within


@given(st.floats(-150, 150), st.floats(-150, 150))
def test_a_polygon_with_a_bay(north: float, east: float) -> None:
    bay = -100.0 <= north <= 50.0 and -20.0 <= east <= 20.0
    within = max(abs(north), abs(east)) <= 100.0 and not bay
    edges = fence(HORSESHOE)
    if edges.to_edge(north, east) > 0.05:
        assert (refused(at(north, east), edges) is None) is within


@given(st.floats(0, 2 * math.pi), st.floats(0, 300), st.integers(3, 12))
def test_a_regular_polygon(course: float, away: float, corners: int) -> None:
    """Against the apothem: within it is within, beyond the corners' circle is outside."""
    circle = [(100 * math.cos(i * math.tau / corners), 100 * math.sin(i * math.tau / corners)) for i in range(corners)]
    target = at(away * math.cos(course), away * math.sin(course))
    if away < 100 * math.cos(math.pi / corners) - 0.05:
        assert refused(target, fence(circle)) is None
    elif away > 100.05:
        assert refused(target, fence(circle)) == "fence"


def test_the_antimeridian_is_no_edge() -> None:
    origin = wire.Origin(lat_deg=-17.0, lon_deg=179.9999, alt_amsl=600.0)
    square = fence(SQUARE, origin)
    lons = [at(0.0, east, origin=origin).lon_deg for east in (-90.0, 90.0)]
    assert lons[0] is not None and lons[1] is not None and lons[0] > 0.0 > lons[1]
    for east, within in ((-90.0, True), (90.0, True), (-110.0, False), (110.0, False)):
        assert (refused(at(0.0, east, origin=origin), square) is None) is within


def test_radius_ceiling_and_floor() -> None:
    round_one = fence(radius=50.0, ceiling=30.0, floor=2.0)
    assert refused(at(30.0, 40.0), round_one) is None
    assert refused(at(31.0, 40.0), round_one) == "fence"
    for up, within in ((30.0, True), (2.0, True), (30.1, False), (1.9, False)):
        assert (refused(at(0.0, 0.0, up), round_one) is None) is within
        assert (refused(Target(-35.0, 149.0, alt_rel=up), round_one) is None) is within
    with pytest.raises(BadInput, match="over the ceiling of 30 m"):
        check(at(0.0, 0.0, 31.0), round_one, None, HOME, None)
    # The fence counts from home, the fleet's frame from the origin.
    check(at(0.0, 0.0, 40.0), round_one, None, HOME + 15.0, None)
    with pytest.raises(BadInput, match="not known yet"):
        check(at(0.0, 0.0), round_one, None, None, None)
    check(Target(-35.0, 149.0, alt_rel=10.0), round_one, None, None, None)
    check(at(0.0, 0.0, 400.0), round_one, None, None, None, flat=True)
    check(at(0.0, 0.0), fence(SQUARE), None, None, None)


def test_no_fence_and_no_limits_let_everything_through() -> None:
    for nothing in (None, Fence(Geofence(), ORIGIN, ground=False), Fence(Geofence(), None, ground=False)):
        assert refused(at(9e4, 0.0), nothing, Limits()) is None
        assert refused(Target(vel=(999.0, 0.0, 0.0)), nothing, None, here=here(0.0, 0.0)) is None


def test_a_way_that_cuts_a_bay() -> None:
    horseshoe = fence(HORSESHOE)
    west, east, north = (-50.0, -60.0), (-50.0, 60.0), (90.0, -10.0)
    assert refused(at(*east), horseshoe, here=here(*west)) == "fence"
    assert refused(at(*east), horseshoe) is None, "where the vehicle is, is not known"
    assert refused(at(*north), horseshoe, here=here(*west)) is None
    assert refused(at(*east), horseshoe, here=here(90.0, 10.0)) is None
    assert refused(at(-50.0, -20.0), horseshoe, here=here(80.0, -20.0)) is None, "along the edge"
    assert refused(at(*west), horseshoe, here=here(-50.0, 0.0)) is None, "back from outside"
    assert refused(at(*east), fence(SQUARE), here=here(*west)) is None


@pytest.mark.parametrize(
    ("target", "vel"),
    [
        (Target(vel=(5.0, 0.0, 0.0)), (0.0, 0.0, 0.0)),
        (Target(acc=(2.0, 0.0, 0.0)), (3.0, 0.0, 0.0)),
        (Target(attitude=(1.0, 0.0, 0.0, 0.0), thrust=0.5), (5.0, 0.0, 0.0)),
        (Target(rates=(0.0, 0.0, 0.0), thrust=0.5), (5.0, 0.0, 0.0)),
        (Target(manual=wire.ManualControl()), (5.0, 0.0, 0.0)),
        (Target(rc=(1500,)), (5.0, 0.0, 0.0)),
    ],
)
def test_other_levels_are_stopped_before_the_fence(target: Target, vel: wire.Vector) -> None:
    square, reach = fence(SQUARE), 5.0 * LOOKAHEAD
    assert refused(target, square, here=here(100.0 - reach - 1.0, 0.0, vel=vel)) is None
    assert refused(target, square, here=here(100.0 - reach + 1.0, 0.0, vel=vel)) == "fence"
    assert refused(target, square) is None, "where the vehicle is, is not known"


def test_who_is_outside_may_come_back() -> None:
    square, outside = fence(SQUARE, ceiling=50.0), here(130.0, 0.0)
    assert refused(Target(vel=(-2.0, 0.0, 0.0)), square, here=outside) is None
    assert refused(Target(vel=(0.0, 0.0, 0.0)), square, here=outside) is None
    assert refused(Target(vel=(2.0, 0.0, 0.0)), square, here=outside) == "fence"
    high = here(0.0, 0.0, 60.0)
    assert refused(Target(vel=(0.0, 0.0, 1.0)), square, here=high) is None
    assert refused(Target(vel=(0.0, 0.0, -1.0)), square, here=high) == "fence"
    assert refused(Target(vel=(0.0, 0.0, -1.0)), square, here=high, flat=True) is None


LIMITS = Limits(speed=5.0, climb=3.0, descend=2.0, accel=4.0, tilt=0.5, yaw_rate=1.0)


def tilted(angle: float) -> wire.Quaternion:
    return (math.cos(angle / 2), 0.0, math.sin(angle / 2), 0.0)


@pytest.mark.parametrize(
    ("count", "at_limit", "beyond"),
    [
        ("speed", Target(vel=(3.0, 4.0, 0.0)), Target(vel=(3.0, 4.1, 0.0))),
        ("speed", at(0.0, 0.0, vel=(0.0, -5.0, 0.0)), at(0.0, 0.0, vel=(0.0, -5.1, 0.0))),
        ("climb", Target(vel=(0.0, 0.0, -3.0)), Target(vel=(0.0, 0.0, -3.1))),
        ("descend", Target(vel=(0.0, 0.0, 2.0)), Target(vel=(0.0, 0.0, 2.1))),
        ("accel", Target(acc=(0.0, 0.0, 4.0)), Target(acc=(3.0, 0.0, 3.0))),
        ("tilt", Target(attitude=tilted(0.499), thrust=0.5), Target(attitude=tilted(0.501), thrust=0.5)),
        ("tilt", Target(attitude=(0.0, 0.0, 0.0, 1.0), thrust=0.5), Target(attitude=tilted(math.pi), thrust=0.5)),
        ("yaw_rate", Target(vel=(0.0, 0.0, 0.0), yaw_rate=-1.0), Target(vel=(0.0, 0.0, 0.0), yaw_rate=-1.1)),
        ("yaw_rate", Target(rates=(3.0, 3.0, 1.0), thrust=0.5), Target(rates=(0.0, 0.0, -1.1), thrust=0.5)),
    ],
)
def test_each_limit_counts_by_its_own_name(count: str, at_limit: Target, beyond: Target) -> None:
    assert refused(at_limit, None, LIMITS) is None
    assert refused(beyond, None, LIMITS) == count
    assert refused(beyond, None, Limits()) is None
    with pytest.raises(BadInput, match=f"the limit {count} = "):
        check(beyond, None, LIMITS, None, None)


@pytest.mark.parametrize(
    ("polygon", "words"),
    [
        ([(0.0, 0.0), (0.0, 0.001)], "enclose"),
        ([(0.0, 0.0), (0.0, 0.001), (0.0, 0.002)], "enclose"),
        ([(0.0, 0.0), (0.001, 0.001), (0.001, 0.0), (0.0, 0.001)], "cross|enclose"),
        ([(0.0, 0.0), (0.003, 0.002), (0.001, 0.0), (0.0, 0.001)], "cross"),
        ([(0.0, 0.0), (20.0, 0.0), (0.0, 20.0)], "1000 km"),
    ],
)
def test_polygons_that_are_none(polygon: list[tuple[float, float]], words: str) -> None:
    with pytest.raises(BadConfig, match=words) as caught:
        Fence(Geofence(polygon=polygon), None, ground=False)
    assert caught.value.detail["field"] == "geofence.polygon"


def test_what_a_fence_needs() -> None:
    with pytest.raises(BadConfig, match="about the fleet's"):
        Fence(Geofence(radius=10.0), None, ground=False)
    with pytest.raises(BadConfig, match="cross"):
        fence(BAY)
    without_origin = Fence(
        Geofence(polygon=[geo.to_global(ORIGIN, (n, e, 0.0))[:2] for n, e in SQUARE]), None, ground=False
    )
    assert refused(at(99.0, 0.0), without_origin) is None
    assert refused(at(101.0, 0.0), without_origin) == "fence"
