"""Routes: shapes that are what they are called, refusals that name field, value and what fits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.navigator.routes import SIZES, Route, shape
from zmav.errors import BadInput

CENTRE = (3.0, -2.0, -8.0)


def ends(route: Route) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """(K + 1, 3): where the stages begin, and the end."""
    return route.at(route.starts)[0]


def test_ev3_is_a_level_square_and_an_upright_rectangle_that_share_a_side() -> None:
    route = shape("ev3", CENTRE, side=10.0, height=5.0)
    places = ends(route)
    square, rectangle = places[:5], places[4:]
    assert route.length == pytest.approx(4 * 10.0 + 2 * (10.0 + 5.0))
    assert np.ptp(square[:, 2]) == 0.0
    assert np.linalg.norm(np.diff(square, axis=0), axis=1) == pytest.approx([10.0] * 4)
    assert square[:4].mean(axis=0) == pytest.approx(CENTRE)
    assert square[0] == pytest.approx(square[4])
    assert np.ptp(rectangle[:, 0]) == 0.0
    assert rectangle[:, 2].min() == CENTRE[2] - 5.0
    assert rectangle[0] == pytest.approx(rectangle[4])
    assert rectangle[:2] == pytest.approx(square[:2])  # the shared side, flown the same way again
    assert route.corners == pytest.approx([0, 10, 20, 30, 40, 50, 55, 65, 70])


@given(
    name=st.sampled_from(["ev3", "square", "circle", "lemniscate"]),
    heading=st.floats(-math.pi, math.pi),
)
def test_every_shape_is_closed_and_only_turned_by_its_heading(name: str, heading: float) -> None:
    plain, route = shape(name), shape(name, CENTRE, heading)
    ways = np.linspace(0.0, route.length, 200)
    places, tangents, _ = route.at(ways)
    assert route.length == pytest.approx(plain.length)
    assert places[0] == pytest.approx(places[-1], abs=1e-6)
    before = plain.at(ways)[0]
    assert np.linalg.norm(places - CENTRE, axis=1) == pytest.approx(np.linalg.norm(before, axis=1), abs=1e-6)
    east = math.sin(heading) * before[:, 0] + math.cos(heading) * before[:, 1]
    assert places[:, 1] - CENTRE[1] == pytest.approx(east, abs=1e-6)
    assert np.linalg.norm(tangents, axis=1) == pytest.approx(np.ones(200))


@pytest.mark.parametrize("name", ["circle", "lemniscate"])
def test_a_curve_is_read_by_its_distance(name: str) -> None:
    route = shape(name)
    ways = np.linspace(0.0, route.length, 2001)
    places, tangents, bends = route.at(ways)
    step = ways[1]
    assert np.linalg.norm(np.diff(places, axis=0), axis=1) == pytest.approx(np.full(2000, step), rel=1e-4)
    assert np.gradient(places, step, axis=0)[1:-1] == pytest.approx(tangents[1:-1], abs=1e-3)
    assert np.gradient(tangents, step, axis=0)[1:-1] == pytest.approx(bends[1:-1], abs=1e-3)
    if name == "circle":
        assert route.length == pytest.approx(math.tau * 5.0)
        assert route.stages[0].piece.bend == pytest.approx(0.2)


def test_the_way_to_a_route_does_not_count() -> None:
    route = shape("square", CENTRE)
    joined = route.reached_from((0.0, 0.0, -5.0), 2.0)
    assert joined.length == pytest.approx(route.length)
    assert joined.corners - joined.begins == pytest.approx(route.corners, abs=1e-9)
    assert joined.at(np.zeros(1))[0][0] == pytest.approx((0.0, 0.0, -5.0))
    assert joined.stages[0].dwell == 2.0
    assert route.reached_from(tuple(route.at(np.zeros(1))[0][0])) is route


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"name": "octagon"}, "route"),
        ({"name": "ev3", "side": 0.1}, "side"),
        ({"name": "ev3", "side": math.nan}, "side"),
        ({"name": "circle", "height": 5.0}, "height"),
        ({"name": "square", "heading": math.inf}, "heading"),
        ({"name": "square", "centre": (0.0, 1e9, 0.0)}, "east"),
        ({"name": "square", "dwell": -1.0}, "dwell"),
    ],
)
def test_a_shape_that_cannot_be_is_refused_by_its_field(arguments: dict[str, object], field: str) -> None:
    with pytest.raises(BadInput, match="expected") as refused:
        shape(**arguments)  # type: ignore[arg-type]
    assert refused.value.detail["field"] == field


def test_sizes_are_told_for_every_shape() -> None:
    for name, sizes in SIZES.items():
        smallest = {size: low for size, (_, low, _) in sizes.items()}
        assert shape(name, (0.0, 0.0, 0.0), 0.0, dwell=0.0, **smallest).length > 0.0
