"""The vehicle's own place where it comes late, in another order, seldom, or no more."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from agents.follower.place import IN_TIME, SILENT, TOO_OLD, Here
from tests.agents.follower.virtual import DECK, World
from zmav.errors import Stale
from zmav.flying import PATIENCE
from zmav.vehicle.vehicle import Place


def said(t: float, north: float = 0.0) -> Place:
    return Place(t, (north, 0.0, -5.0), (1.0, 0.0, 0.0))


def test_it_is_carried_on_until_it_is_old() -> None:
    here = Here(10.0)
    with pytest.raises(Stale, match=r"no GLOBAL_POSITION_INT of its autopilot has come for 0\.3 s"):
        here.check(1000.0, 10.3)
    assert here.at(1000.0) is None
    assert here.feed(said(1000.0), 1000.0, 10.3)
    assert here.check(1000.2, 10.5) == said(1000.0)
    assert here.at(1000.2) == pytest.approx((0.2, 0.0, -5.0))
    with pytest.raises(Stale, match=r"said 0\.6 s ago where it is"):
        here.check(1000.6, 10.3 + SILENT + 0.1)


def test_a_place_that_comes_much_too_late_is_none() -> None:
    here = Here(10.0)
    here.feed(said(1000.0), 1000.0, 13.0)
    with pytest.raises(Stale, match=r"where it was 3\.0 s ago is heard only now"):
        here.check(1003.0, 13.0)
    assert here.at(1003.0) == pytest.approx((TOO_OLD, 0.0, -5.0))


@pytest.mark.parametrize(
    ("says", "late", "words"),
    [
        (False, 0.0, "no GLOBAL_POSITION_INT of its autopilot has come"),
        (True, 0.0, "s ago where it is"),
        (True, 5.0, "s ago is heard only now"),
    ],
)
def test_without_new_places_it_is_told_why_for_a_while_and_then_raised(says: bool, late: float, words: str) -> None:
    here = Here(10.0)
    if says:
        here.feed(said(1000.0), 1000.0, 10.0)
        assert here.known(1000.0, 10.0) == ""
    for k in range(6, 100):
        if late:
            here.feed(said(1000.0 + 0.1 * k - late), 1000.0 + 0.1 * k, 10.0 + 0.1 * k)
        assert words in here.known(1000.0 + 0.1 * k, 10.0 + 0.1 * k)
    assert pytest.approx(10.0) == PATIENCE
    with pytest.raises(Stale, match=words):
        here.known(1010.1, 20.1)


def test_a_vehicle_of_which_nothing_is_heard_may_be_silent_for_longer() -> None:
    here = Here(10.0)
    here.unheard(18.0)
    assert here.known(1000.0, 27.9)
    with pytest.raises(Stale):
        here.known(1000.0, 28.1)


def test_a_place_from_after_now_is_none() -> None:
    here = Here(10.0)
    here.feed(said(1000.0), 1000.0, 10.0)
    assert here.check(999.8, 10.0) == said(1000.0)
    with pytest.raises(Stale, match="the hosts' clocks disagree"):
        here.check(999.6, 10.0)


def test_one_that_was_overtaken_is_left_out_until_a_clock_must_have_been_set() -> None:
    here = Here(0.0)
    assert here.feed(said(100.0), 100.0, 0.0)
    assert not here.feed(said(99.7, 7.0), 99.7, 0.1)
    assert not here.feed(said(100.0, 7.0), 100.0, 0.2)
    assert here.last == said(100.0)
    assert here.feed(said(60.0, 7.0), 60.0, SILENT), "nothing newer came for so long: its clock was set back"


def test_how_late_it_is_does_not_count_the_time_between_two() -> None:
    here = Here(0.0)
    assert here.late == 0.0
    for k in range(40):
        late = 0.0 if k < 10 else 0.1
        here.feed(said(100.0 + 0.25 * k), 100.0 + 0.25 * k + IN_TIME + late, 0.25 * k)
        if k < 10:
            assert here.late == pytest.approx(0.0)
    assert 0.09 < here.late < 0.1


def over_the_pad(until: Callable[[World], bool]) -> World:
    world = World(lambda t: (0.0, 0.0)).run(10.0)
    world.guide.land()
    world.run(30.0, until)
    assert until(world)
    return world


@pytest.mark.parametrize("phase", ["descend", "touch"])
def test_it_does_not_land_on_an_old_place(phase: str) -> None:
    """Its places stop while its states and what it sees go on, and a gust carries it off."""
    world = over_the_pad(lambda w: w.guide.phase == phase and DECK - float(w.pos[2]) < 1.5)
    world.place_late = lambda t: math.inf
    world.run(SILENT + 0.1)
    height = DECK - float(world.pos[2])
    for k in range(200):
        world.vel[1] += 0.12 if k < 60 else 0.0
        world.step()
        assert not world.command.land
    assert world.old_places > 190
    assert DECK - float(world.pos[2]) > height - 0.15, "it sinks by an old place"
    world.pos[:2], world.place_late = 0.0, lambda t: 0.02
    world.run(90.0, lambda w: w.command.land)
    assert world.command.land
    assert world.off[-1] < 0.15


def test_it_does_not_go_on_down_unseen_after_it_was_not_flown() -> None:
    world = over_the_pad(lambda w: w.guide.phase == "touch")
    world.place_late = lambda t: math.inf
    world.run(1.5)
    world.place_late = lambda t: 0.02
    resumed = len(world.phases)
    world.run(0.3)
    assert world.phases[resumed:] == ["descend"]
    world.run(90.0, lambda w: w.command.land)
    assert world.command.land
    assert world.off[-1] < 0.15


def test_places_that_overtake_each_other_are_no_drift() -> None:
    def flown(late: Callable[[float], float]) -> World:
        world = World(lambda t: (1.0 * t, 0.0))
        world.place_late = late
        return world.run(40.0)

    jumbled = flown(lambda t: 0.02 if round(t / 0.1) % 3 else 0.35)
    assert math.hypot(*jumbled.guide.drift.at(40.0)) < 0.05
    assert np.mean(jumbled.off[600:]) < 0.25
    assert jumbled.old_places < 10, "some are always in time"


def test_nothing_is_added_by_a_place_that_is_late() -> None:
    """Held 0.5 m off by the wind: what is added against it fades as its place comes later, whatever its states do."""

    def added(late: float) -> float:
        world = World(lambda t: (0.0, 0.0)).run(12.0)
        world.push, world.place_late = 0.6, lambda t: late
        world.run(6.0)
        return float(world.command.vel[0])

    assert added(0.0) > 0.3
    assert abs(added(0.4)) < 0.1


def test_what_is_added_does_not_saw_between_seldom_places() -> None:
    """Four a second: each is a quarter of a second old before the next one comes."""
    world = World(lambda t: (0.0, 0.0))
    world.push, world.place_every = 0.6, 5
    world.run(20.0)
    world.off.clear()
    flown = []
    for _ in range(200):
        world.step()
        flown.append(float(world.command.vel[0]))
    assert np.abs(np.diff(flown)).max() < 0.6, "more than what the sights' noise makes of it"
    assert np.mean(world.off) < 0.08
