"""Patrols: evenly spread, at one speed, lap after lap; and routes on which that cannot be."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from agents.planner.goals.goals import resolve
from agents.planner.goals.steps import Fly, PlanTo, unroll
from agents.planner.model.scene import Box, Scene
from agents.planner.model.separation import separation
from tests.agents.planner.goals.crew import DOWNWASH, crew, fly_all, ground, judge_fly
from zmav import wire
from zmav.errors import BadInput
from zmav.wire.base import Vector

SQUARE: list[Vector] = [(0.0, 0.0, -15.0), (0.0, 80.0, -15.0), (60.0, 80.0, -20.0), (60.0, 0.0, -15.0)]


def patrol(count: int, route: list[Vector] = SQUARE, world: Scene | None = None, laps: int = 0) -> tuple[PlanTo, Fly]:
    fleet = crew(count)
    goal = wire.swarm.Patrol(vehicles=list(fleet.vehicles), route=route, laps=laps)
    entry, fly = resolve(goal, fleet, ground() if world is None else world)
    assert isinstance(entry, PlanTo) and isinstance(fly, Fly)
    return entry, fly


def test_all_fly_around_evenly_spread_at_one_speed() -> None:
    _, fly = patrol(5, laps=3)
    assert fly.laps == 3 and fly.loop is not None
    begin, end = fly.loop
    tracks = np.stack([m[(m[:, 0] >= begin) & (m[:, 0] <= end)] for m in fly.motions.values()], axis=1)
    speed = np.linalg.norm(np.diff(tracks[:, :, 1:], axis=0), axis=2) / np.diff(tracks[:, :, 0], axis=0)
    assert np.ptp(speed[:, 0]) < 0.05 * speed.mean()
    first = tracks[0, :, 1:]
    for track in np.moveaxis(tracks, 1, 0):
        near = np.linalg.norm(track[:, None, 1:] - first[None], axis=2)
        when = np.sort(track[np.argmin(near, axis=0), 0])
        assert np.diff(when) == pytest.approx((end - begin) / 5.0, abs=0.25), "each place, one after another, evenly"


def test_any_number_of_laps_keeps_the_rules() -> None:
    fleet, (_, fly) = crew(4), patrol(4)
    assert fly.loop is not None
    laps = unroll(fly, 3)
    assert judge_fly(fly, fleet, ground()).ok
    report = judge_fly(fly, fleet, ground(), laps)
    assert report.ok, report.faults[:3]
    assert report.makespan == pytest.approx(fly.makespan + 2.0 * (fly.loop[1] - fly.loop[0]), abs=0.01)
    for one, other in itertools.combinations(laps.values(), 2):
        assert separation(one, other, DOWNWASH)[0] > 15.0


def test_the_route_is_entered_by_a_plan_and_kept_near_its_points() -> None:
    fleet, (entry, fly) = crew(4), patrol(4)
    assert entry.labelled
    assert fly_all([entry, fly], fleet, ground()) > fly.makespan
    flown = np.concatenate([motion[:, 1:] for motion in fly.motions.values()])
    for north, east, down in SQUARE:
        assert np.linalg.norm(flown - [east, north, -down], axis=1).min() < 2.1


def test_what_stands_on_the_route_is_flown_around() -> None:
    world = ground([Box(min=(30.0, -10.0, 0.0), max=(45.0, 10.0, 40.0))])
    fleet, (_, fly) = crew(3), patrol(3, world=world)
    report = judge_fly(fly, fleet, world)
    assert report.ok, report.faults[:3]


def test_too_many_are_refused_with_how_many_fit() -> None:
    small: list[Vector] = [(0.0, 0.0, -15.0), (0.0, 20.0, -15.0), (20.0, 20.0, -15.0)]
    with pytest.raises(BadInput, match=r"need 2\.10 m; (\d+) would fit") as e:
        patrol(40, small)
    assert e.value.detail["field"] == "vehicles"
    fits = int(e.value.detail["expected"].split()[0])
    assert 15 < fits < 32
    assert judge_fly(patrol(fits, small)[1], crew(fits), ground()).ok


def test_a_crossing_where_two_would_meet_is_refused() -> None:
    eight: list[Vector] = [(0.0, 0.0, -15.0), (0.0, 80.0, -15.0), (60.0, 0.0, -15.0), (60.0, 80.0, -15.0)]
    with pytest.raises(BadInput, match="would fit"):
        patrol(4, eight)


def test_one_flies_to_and_fro_and_several_do_not() -> None:
    line: list[Vector] = [(0.0, 0.0, -15.0), (0.0, 40.0, -15.0)]
    _, fly = patrol(1, line)
    report = judge_fly(fly, crew(1), ground(), unroll(fly, 2))
    assert report.ok, report.faults[:3]
    with pytest.raises(BadInput, match="to and fro"):
        patrol(2, line)
    with pytest.raises(BadInput, match="at one place"):
        patrol(1, [(0.0, 0.0, -15.0), (0.1, 0.0, -15.0), (0.0, 0.05, -15.0)])
    with pytest.raises(BadInput, match="two points"):
        patrol(1, [(0.0, 0.0, -15.0), (0.0, 0.0, -15.0)])
