"""Routes: shapes that are what they are called, waypoints from files, refusals that name field, value and what fits."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.navigator.files import find, load
from agents.navigator.routes import SIZES, Route, Waypoint, shape, through
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
    name=st.sampled_from(["ev3", "square", "circle", "lemniscate", "steps"]),
    heading=st.floats(-math.pi, math.pi),
    rounding=st.sampled_from([0.0, 1.0]),
)
def test_every_shape_is_closed_and_only_turned_by_its_heading(name: str, heading: float, rounding: float) -> None:
    plain, route = shape(name, rounding=rounding), shape(name, CENTRE, heading, rounding=rounding)
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


def test_rounded_corners_are_cut_and_not_stopped_at() -> None:
    sharp, route = shape("square", side=10.0), shape("square", side=10.0, rounding=2.0)
    assert [stage.dwell for stage in route.stages].count(None) == len(route.stages) - 1
    assert route.length < sharp.length
    corners = sharp.at(sharp.corners[1:-1])[0]
    away = np.linalg.norm(route.at(route.corners[1:-1])[0] - corners, axis=1)
    assert (away > 0.3).all()
    assert (away < 2.0).all()


def test_it_stops_at_corners_and_passes_what_lies_on_the_way() -> None:
    places = [(0.0, 0.0, -5.0), (4.0, 0.0, -5.0), (9.0, 0.0, -5.0), (9.0, 3.0, -5.0), (5.0, 3.0, -5.0)]
    route = through("tour", [Waypoint(place) for place in places])
    assert [stage.dwell for stage in route.stages] == [None, 0.0, 0.0, 0.0]
    assert route.corners == pytest.approx([0.0, 9.0, 12.0, 16.0])
    dwelling = through("tour", [Waypoint(place, dwell=2.0 if place[0] == 4.0 else 0.0) for place in places])
    assert dwelling.stages[0].dwell == 2.0


def test_what_is_left_of_a_route_is_its_end() -> None:
    for name, done in (("ev3", 23.0), ("circle", 7.0), ("lemniscate", 30.0), ("square", 10.0)):
        route = shape(name, CENTRE)
        left = route.after(done)
        assert left is not None
        assert left.length == pytest.approx(route.length - done, abs=1e-6)
        ways = np.linspace(0.0, left.length, 50)
        assert left.at(ways)[0] == pytest.approx(route.at(ways + done)[0], abs=1e-4)
        assert left.corners[1:] + done == pytest.approx(route.corners[route.corners > done + 1e-6])
    assert shape("square").after(40.0) is None


def test_the_way_to_a_route_does_not_count() -> None:
    route = shape("square", CENTRE)
    joined = route.reached_from((0.0, 0.0, -5.0), 0.5, 2.0)
    assert joined.length == pytest.approx(route.length)
    assert joined.corners - joined.begins == pytest.approx(route.corners, abs=1e-9)
    assert joined.at(np.zeros(1))[0][0] == pytest.approx((0.0, 0.0, -5.0))
    assert joined.stages[0].dwell == 2.0
    assert route.reached_from(tuple(route.at(np.zeros(1))[0][0]), 0.0) is route


def test_a_yaw_is_turned_the_short_way_along_the_leg() -> None:
    points = [Waypoint((0, 0, 0), yaw=3.0), Waypoint((10, 0, 0), yaw=-3.0), Waypoint((10, 10, 0), yaw=0.0)]
    yaw = through("tour", points).yaw(np.array([0.0, 5.0, 10.0, 15.0]))
    assert yaw is not None
    assert np.cos(yaw) == pytest.approx(np.cos([3.0, math.pi, -3.0, -1.5]))
    assert np.sin(yaw) == pytest.approx(np.sin([3.0, math.pi, -3.0, -1.5]), abs=1e-9)


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"name": "octagon"}, "route"),
        ({"name": "ev3", "side": 0.1}, "side"),
        ({"name": "ev3", "side": math.nan}, "side"),
        ({"name": "circle", "height": 5.0}, "height"),
        ({"name": "square", "heading": math.inf}, "heading"),
        ({"name": "square", "centre": (0.0, 1e9, 0.0)}, "east"),
        ({"name": "square", "rounding": -1.0}, "rounding"),
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
        assert shape(name, (0.0, 0.0, 0.0), 0.0, rounding=0.0, dwell=0.0, **smallest).length > 0.0


TOML = """
rounding = 0.0
[[waypoint]]
pos = [0.0, 0.0, -5.0]
[[waypoint]]
pos = [10.0, 0.0, -5.0]
speed = 0.5
dwell = 2.0
[[waypoint]]
pos = [10.0, 5.0, -6.0]
"""
CSV = "north, east, down, speed, dwell\n0,0,-5,,\n10,0,-5,0.5,2\n10,5,-6,,\n"


def test_both_kinds_of_files_say_the_same(tmp_path: Path) -> None:
    (tmp_path / "one.toml").write_text(TOML)
    (tmp_path / "two.csv").write_text(CSV)
    routes = [load(find(name, tmp_path)) for name in ("one", "two")]
    for route in routes:
        assert ends(route) == pytest.approx(np.array([(0, 0, -5), (10, 0, -5), (10, 5, -6)], dtype=float))
        assert [stage.speed for stage in route.stages] == [0.5, math.inf]
        assert [stage.dwell for stage in route.stages] == [2.0, 0.0]
    assert [route.name for route in routes] == ["one", "two"]
    moved = load(tmp_path / "two.csv", (1.0, 2.0, 0.0), math.pi / 2)
    assert ends(moved)[1] == pytest.approx((1.0, 12.0, -5.0))


@pytest.mark.parametrize(
    ("file", "text", "field"),
    [
        ("a.toml", "waypoint = 3", "waypoint"),
        ("a.toml", "[[waypoint]]\npos = [0, 0]", "waypoint"),
        ("a.toml", "[[waypoint]]\npos = [0, 0, 0]\nheight = 3", "waypoint"),
        ("a.toml", "[[waypoint]]\npos = [0, 0, 0]", "waypoints"),
        ("a.toml", "not toml", "file"),
        ("a.csv", "north,east\n1,2\n", "columns"),
        ("a.csv", "north,east,down,colour\n1,2,3,4\n", "columns"),
        ("a.csv", "north,east,down\n1,2,-3\n1,two,-3\n", "line 3, east"),
        ("a.csv", "north,east,down\n1,2,\n", "line 2, down"),
        ("a.csv", "north,east,down\n1,2,3,4\n", "line 2"),
        ("a.csv", "north,east,down\n1,2,-3\n1,2,-3\n", "waypoint[1].pos"),
        ("a.csv", "north,east,down,speed\n1,2,-3,\n4,2,-3,0\n", "waypoint[1].speed"),
        ("a.csv", "north,east,down,yaw\n1,2,-3,1\n4,2,-3,\n", "waypoint[1].yaw"),
        ("a.csv", "north,east,down\n1,2,nan\n4,2,-3\n", "waypoint[0].down"),
        ("a.txt", "", "file"),
    ],
)
def test_a_bad_file_is_refused_by_name_and_field(tmp_path: Path, file: str, text: str, field: str) -> None:
    (tmp_path / file).write_text(text)
    with pytest.raises(BadInput, match=r"a\.\w+") as refused:
        load(tmp_path / file)
    assert field in str(refused.value.detail["field"])


def test_a_route_that_is_not_there_is_refused_naming_those_that_are(tmp_path: Path) -> None:
    (tmp_path / "tour.csv").write_text(CSV)
    with pytest.raises(BadInput, match="tour"):
        find("../etc/passwd", tmp_path)
