"""Ways home: within what the vehicle can do, around what stands, and clear of whatever anybody may have stored."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from agents.planner.execute.commit import Part
from agents.planner.execute.offset import Offset
from agents.planner.execute.rows import standing
from agents.planner.execute.track import Track, flown
from agents.planner.model.geometry import segment_clear, world_of
from agents.planner.model.problem import Floats, MovingObstacle
from agents.planner.model.scene import Bounds, Box, Fence, NoFly, Obstacle, Scene
from agents.planner.returning.finder import LANDS_FROM, MOST_TRIES, Clear, Finder, Returner, Surroundings
from agents.planner.returning.futures import Futures, StoredWay
from agents.planner.returning.keeper import ReturnKeeper
from agents.planner.returning.ways import Pace, Way

PACE = Pace(5.0, 3.0, 1.5, 2.5)
HERE, HOME = np.array([40.0, 0.0, 10.0]), (0.0, 0.0, 0.0)
NOW, READY, NEED = 1000.0, 1030.0, 1.2


def anywhere(p: Floats, q: Floats, radius: float) -> bool:
    return True


def among(*obstacles: Obstacle, fence: Fence | None = None) -> Clear:
    bounds = Bounds(min=(-200.0, -200.0, -1.0), max=(200.0, 200.0, 100.0))
    world = world_of(Scene(vehicles=[], obstacles=list(obstacles), bounds=bounds, geofence=fence))
    return lambda p, q, radius: bool(segment_clear(world, p, q, radius))


def part(name: str, place: Floats) -> Part:
    made = Part(name, Track(np.array([[0.0, *place]])), 1.0, 2.5, 0.1, Offset())
    made.entries = [standing(place, NOW)]
    return made


def finder(
    futures: Futures | None = None,
    clear: Clear = anywhere,
    *,
    ceiling: float = 60.0,
    lasts: float = math.inf,
    movers: tuple[MovingObstacle, ...] = (),
    others: tuple[tuple[float, float, float], ...] = (),
    busy: Floats | None = None,
) -> Finder:
    room = Surroundings(clear, movers, 16.0, ceiling, 4.0)
    nobody = np.empty((0, 2)) if busy is None else busy
    one = Returner(HOME, PACE, 13.0, lasts)
    return Finder("v0", one, room, futures or Futures(1.5), NEED, others=others, busy=nobody)


def test_it_goes_up_over_and_down_and_keeps_to_what_the_vehicle_can_do() -> None:
    way = finder().find(HERE, READY, NOW, 0)
    assert way is not None
    assert way.begins == READY
    assert way.corners.tolist() == [[40, 0, 10], [40, 0, 16], [0, 0, 16], [0, 0, LANDS_FROM]]
    motion = flown(way.rows)
    speed = np.diff(motion[:, 1:], axis=0) / np.diff(motion[:, 0])[:, None]
    assert np.linalg.norm(speed, axis=1).max() <= 4.0 + 0.02
    assert speed[:, 2].max() <= 2.4 + 0.02
    assert speed[:, 2].min() >= -1.2 - 0.02
    assert np.abs(np.diff(speed, axis=0) / np.diff(motion[1:, 0])[:, None]).max() < 2.5
    at = np.column_stack([np.interp(motion[:, 0], way.motion[:, 0], way.motion[:, k]) for k in (1, 2, 3)])
    off = np.abs(at - motion[:, 1:])
    assert np.max(off) < 0.02, "what is checked is what is flown"
    later = way.at(READY + 7.0)
    assert np.allclose(later.rows, Way(way.corners, READY + 7.0, PACE).rows)


@pytest.mark.parametrize("length", [0.06, 1.0, 7.9, 8.0, 8.02, 8.3, 9.0, 900.0])
def test_points_are_never_nearer_to_each_other_than_a_vehicle_takes_them(length: float) -> None:
    way = Way(np.array([[0.0, 0.0, 10.0], [length, 0.0, 10.0]]), READY, PACE)
    steps = np.diff(way.rows[:, 0])
    assert 0.1 <= steps.min() <= steps.max() <= 50.0
    speed = np.diff(way.motion[:, 1]) / np.diff(way.motion[:, 0])
    assert speed.max() <= 4.0 + 1e-3
    assert way.rows[-1, 1] == pytest.approx(length)


def test_a_long_leg_has_points_as_often_as_a_vehicle_takes_them() -> None:
    way = Way(np.array([[0.0, 0.0, 10.0], [900.0, 0.0, 10.0]]), READY, PACE)
    assert np.diff(way.rows[:, 0]).max() <= 50.0
    assert way.rows[-1, 1] == 900.0


def test_each_has_a_layer_of_its_own() -> None:
    heights = {finder().find(HERE, READY, NOW, layer).corners[1, 2] for layer in range(5)}  # type: ignore[union-attr]
    assert heights == {16.0, 20.0, 24.0, 28.0, 32.0}


def test_it_goes_around_what_stands_up_to_the_sky() -> None:
    wall = NoFly(polygon=[(18.0, -6.0), (22.0, -6.0), (22.0, 6.0), (18.0, 6.0)], floor=0.0, ceiling=90.0)
    clear = among(wall)
    way = finder(clear=clear).find(HERE, READY, NOW, 0)
    assert way is not None
    assert len(way.corners) == 5
    assert all(clear(a, b, NEED) for a, b in zip(way.corners, way.corners[1:], strict=False))


def test_where_the_fence_leaves_no_layer_there_is_none() -> None:
    fence = Fence(polygon=[(-9.0, -9.0), (60.0, -9.0), (60.0, 9.0), (-9.0, 9.0)], floor=-1.0, ceiling=14.0)
    assert finder(clear=among(fence=fence)).find(HERE, READY, NOW, 0) is None


@pytest.mark.parametrize("ceiling", [15.9, 12.5, 9.0])
def test_no_layer_is_above_the_ceiling(ceiling: float) -> None:
    assert finder(ceiling=ceiling).find(HERE, READY, NOW, 0) is None
    assert finder(ceiling=16.0).find(HERE, READY, NOW, 3).corners[1, 2] == 16.0  # type: ignore[union-attr]


def test_a_way_that_no_vehicle_would_keep_is_none() -> None:
    far = finder()
    assert far.find(np.array([3700.0, 0.0, 10.0]), READY, NOW, 0) is None
    assert "it would take 9" in far.why


def test_where_one_follows_late_it_is_looked_for_where_it_is() -> None:
    corners = np.array([HERE, [40.0, 0.0, 16.0], [0.0, 0.0, 16.0], [0.0, 0.0, LANDS_FROM]])
    punctual, late = Way(corners, READY, PACE), Way(corners, READY, PACE, 0.5)
    assert np.allclose(late.rows, punctual.rows), "it is told the same"
    assert np.allclose(late.motion - punctual.motion, [0.5, 0.0, 0.0, 0.0])
    assert np.allclose(late.at(READY + 9.0).motion - punctual.motion, [9.5, 0.0, 0.0, 0.0])
    assert late.at(READY + 9.0).ends == pytest.approx(punctual.ends + 9.5)


def test_a_battery_that_does_not_last() -> None:
    short = finder(lasts=40.0)
    assert short.find(HERE, READY, NOW, 0) is None
    assert "battery" in short.why


def test_where_its_home_is_built_over_it_lands_beside_it_and_leaves_the_others_homes_to_them() -> None:
    house = Box(min=(-1.0, -1.0, 0.0), max=(1.0, 1.0, 8.0))
    beside = [(2.52, 0.0, 0.0)]  # the first place that would be tried
    way = finder(clear=among(house), others=tuple(beside)).find(HERE, READY, NOW, 0)
    assert way is not None
    pad = way.corners[-1]
    assert 2.0 < math.dist(pad[:2], (0.0, 0.0)) < 6.0
    assert math.dist(pad[:2], beside[0][:2]) >= 2.0 * NEED


def test_nobody_lands_where_another_rests_above_or_a_plan_leads_over() -> None:
    futures = Futures(1.5)
    futures.parts["v1"] = part("v1", np.array([0.0, 0.0, 30.0]))
    way = finder(futures).find(HERE, READY, NOW, 0)
    assert way is not None
    assert math.dist(way.corners[-1][:2], (0.0, 0.0)) > 2.0
    line = np.column_stack((np.linspace(-20.0, 20.0, 81), np.zeros(81)))
    way = finder(busy=line).find(HERE, READY, NOW, 0)
    assert way is not None
    assert abs(way.corners[-1][1]) > 2.0


def test_landing_places_are_apart_over_the_ground_whatever_the_heights_say() -> None:
    """Homes' heights come from barometers, which drift: 9 m of height between two ends would be enough otherwise."""
    futures = Futures(1.5)
    futures.parts["v1"] = part("v1", np.array([0.0, 40.0, 30.0]))
    corners = np.array([[0.0, 40.0, 30.0], [0.0, 40.0, 40.0], [0.5, 0.0, 40.0], [0.5, 0.0, 13.0]])
    futures.stored["v1"] = [StoredWay(Way(corners, READY, PACE), NEED, 0.0, stamps=[(1, 4)])]
    way = finder(futures).find(HERE, READY, NOW, 0)
    assert way is not None
    assert math.dist(way.corners[-1][:2], (0.5, 0.0)) >= 2.0 * NEED


@pytest.mark.parametrize("both", [True, False], ids=["not known which", "the second known"])
def test_every_way_counts_that_another_may_have_stored(both: bool) -> None:
    """Two versions are aboard another, or one of them: it says which when it names the segment."""
    futures = Futures(1.5)
    futures.parts["v1"] = part("v1", np.array([0.0, 40.0, 10.0]))
    corners = np.array([[0.0, 40.0, 10.0], [0.0, 40.0, 16.0], [0.0, 0.0, 16.0], [0.0, 0.0, 4.0]])
    old = StoredWay(Way(corners, READY, PACE), NEED, 0.0, stamps=[(1, 4)], deadline=NOW + 5.0)
    new = StoredWay(None, NEED, 0.0, stamps=[(1, 5)], deadline=NOW + 9.0)
    futures.stored["v1"] = [old, new]
    futures.heard("v1", (1, 4), NOW + 6.0)
    assert futures.stored["v1"] == [old, new], "the second may still be taken"
    if not both:
        futures.heard("v1", (1, 5), NOW + 7.0)
        assert futures.stored["v1"] == [new]
    way = finder(futures).find(HERE, READY, NOW, 0)
    assert way is not None
    assert (math.dist(way.corners[-1][:2], (0.0, 0.0)) > 2.0) == both


def test_what_was_not_taken_in_time_counts_no_more() -> None:
    futures = Futures(1.5)
    ways = [StoredWay(None, NEED, 0.0, stamps=[(1, k)], deadline=NOW + k) for k in (1, 2)]
    futures.stored["v1"] = list(ways)
    futures.heard("v1", (1, 1), NOW + 2.2)
    assert futures.stored["v1"] == ways, "a busy vehicle may be about to say so"
    futures.heard("v1", None, NOW + 9.0)
    assert futures.stored["v1"] == ways, "it may fly home by now"
    futures.heard("v1", (1, 1), NOW + 9.0)
    assert futures.stored["v1"] == ways[:1]


def test_what_moves_by_itself_is_waited_for() -> None:
    crosses = np.array([[READY, 20.0, 0.0, 16.0], [READY + 14.0, 20.0, 0.0, 16.0], [READY + 15.0, 20.0, 60.0, 16.0]])
    mover = MovingObstacle("drone", crosses, 1.0)
    way = finder(movers=(mover,), ceiling=16.0).find(HERE, READY, NOW, 0)
    assert way is not None
    assert way.begins > READY


def test_no_way_is_looked_at_after_the_most_that_are() -> None:
    """All but what stands was looked at on, for layers and landing places that could not be taken any more."""
    asked: list[Floats] = []

    def anything(p: Floats, q: Floats, radius: float) -> bool:
        asked.append(p)
        return True

    everywhere = MovingObstacle("cloud", np.array([[NOW, 0.0, 0.0, 0.0]]), 1e4)
    assert finder(clear=anything, movers=(everywhere,)).find(HERE, READY, NOW, 0) is None
    assert len(asked) < MOST_TRIES


def test_the_layer_of_one_that_is_gone_is_given_to_another() -> None:
    """The first layers are the shortest ways home, and there are only so many."""
    crew = {f"v{k}": part(f"v{k}", HERE + np.array([0.0, 20.0 * k, 0.0])) for k in range(4)}
    homes = {
        name: Returner((0.0, float(each.track.pos[0, 1]), 0.0), PACE, 13.0, math.inf) for name, each in crew.items()
    }

    def around(names: Sequence[str], lowest: float, spacing: float) -> Surroundings:
        return Surroundings(anywhere, (), lowest, 100.0, spacing)

    keeper = ReturnKeeper(1.5, lambda: homes, around, lambda vehicle, why: None)

    def height(name: str) -> float:
        keeper.begin([crew[name]], NOW)
        way = keeper.home(crew[name], crew[name].known, READY, NOW)
        assert way is not None
        keeper.sent(crew[name], (1, 1), READY)
        return float(way.corners[:, 2].max())

    first, second = height("v0"), height("v1")
    assert first < second
    keeper.drop("v0")
    assert list(keeper.last) == ["v1"]
    assert [height("v2"), height("v3")] == pytest.approx([first, second + second - first])
