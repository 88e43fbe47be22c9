"""A network that is torn at any moment: whatever each vehicle had stored by then, all come down apart.

More moments and more vehicles: tests/bench/plan_return.py.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from agents.planner.execute.following import Following
from agents.planner.model.problem import Motion
from tests.agents.planner.execute.virtual import History, carousel, crossing, line, slower
from tests.agents.planner.returning.torn import AFTER, HomeHistory, Torn


def plan(seed: int) -> dict[str, Motion]:
    rng = np.random.default_rng(seed)
    if seed % 3 == 2:
        return carousel(6, 5.0, turn=6.0, speed=2.0)
    return slower(crossing(rng, 5, 14.0, 2.8), 1.0 + 3.0 * (seed % 3))


def ended(history: HomeHistory) -> bool:
    return history.conductor.phase(history.now) in ("done", "stuck", "halted")


def down(history: History) -> bool:
    """All that were ever told to go somewhere stand on the ground: nothing happens any more."""
    assert isinstance(history, HomeHistory)
    told = [craft for craft in history.homers.values() if craft.segment is not None]
    return bool(told) and all(craft.place(history.now)[2] == 0.0 for craft in told)


def moments(history: HomeHistory, rng: np.random.Generator, lands: float = 0.0, most: float = 200.0) -> list[Torn]:
    """Flown to its end; what a tear at some moment of each second would have come to."""
    found = []
    until = history.now + most
    while not ended(history) and history.now < until:
        history.run(float(rng.choice([0.6, 1.3, 2.9])))
        found.append(history.torn(rng, lands))
    return found


@pytest.mark.parametrize("seed", range(6))
def test_at_any_moment_all_fly_home_apart(seed: int) -> None:
    """Messages are lost, late and doubled, and clocks are off by what is not known of them."""
    rng = np.random.default_rng(seed)
    history = HomeHistory(plan(seed), rng, loss=0.3)
    found = moments(history, rng)
    assert history.conductor.phase(history.now) == "done"
    assert min(torn.least for torn in found) > 0.0
    assert found[-1].home == len(history.parts)
    assert sum(torn.home for torn in found) > 0.9 * sum(torn.vehicles for torn in found[2:])


@pytest.mark.parametrize("seed", range(6))
def test_those_that_follow_late_do_so_on_their_ways_home_too(seed: int) -> None:
    rng = np.random.default_rng(seed)
    history = HomeHistory(plan(seed), rng, loss=0.2, margin=0.25, late=[0.9, 0.0, 0.9, 0.0, 0.9, 0.0])
    for part in history.parts:
        following = Following()
        following.late = history.crafts[part.id].late
        part.follows(following)
    found = moments(history, rng)
    assert min(torn.least for torn in found) > 0.0
    assert sum(torn.home for torn in found) > 0.8 * sum(torn.vehicles for torn in found[2:])
    for part in history.parts:
        assert history.keeper.last[part.id].late == pytest.approx(part.late, abs=0.06)


@pytest.mark.parametrize("seed", range(3))
def test_the_plan_is_flown_as_soon_as_without_ways_home(seed: int) -> None:
    """What is only for the worst case holds nobody up for long."""
    motions = plan(seed)
    history = HomeHistory(motions, np.random.default_rng(seed), loss=0.0, delay=(0.01, 0.05))
    history.run(300.0, ended)  # type: ignore[arg-type]
    assert history.conductor.phase(history.now) == "done"
    assert history.now - 1000.0 < max(float(motion[-1, 0]) for motion in motions.values()) + 6.0
    assert history.least() > 0.0


@pytest.mark.parametrize("seed", range(3))
def test_who_cannot_fly_home_after_all_lands_where_it_rests_and_the_others_stay_clear_of_that(seed: int) -> None:
    """It was blown away from where its way begins, or the mode that follows it does not come."""
    rng = np.random.default_rng(seed)
    history = HomeHistory(plan(seed), rng, loss=0.2)
    assert min(torn.least for torn in moments(history, rng, lands=0.4)) > 0.0


def test_one_that_never_got_a_way_lands_and_the_others_stay_clear_of_that() -> None:
    rng = np.random.default_rng(3)
    history = HomeHistory(plan(3), rng, loss=0.2)
    del history.homes["v0"]
    found = moments(history, rng)
    assert min(torn.least for torn in found) > 0.0
    assert history.homers["v0"].home is None
    assert found[-1].home == len(history.parts) - 1


@pytest.mark.parametrize("age", [4.0, 9.0, 20.0, 45.0])
@pytest.mark.parametrize("seed", range(2))
def test_torn_in_two_halves_with_different_ages_of_the_plan(seed: int, age: float) -> None:
    """One half flies home while the planner flies on with the other; then that one is alone, too."""
    rng = np.random.default_rng(seed)
    history = HomeHistory(plan(seed + 1), rng, loss=0.1)
    history.run(float(rng.uniform(2.5, 8.0)))
    away = {part.id for part in history.parts[:2]}
    history.network.cut = lambda now, who: who in away
    history.run(age)
    assert history.torn(rng).least > 0.0
    history.alive = False
    history.run(150.0, down)
    assert history.least() > 0.0
    assert all(craft.place(history.now)[2] == 0.0 for craft in history.homers.values())


@pytest.mark.parametrize("seed", range(6))
def test_a_planner_that_dies_while_it_sends(seed: int) -> None:
    """Some of what it put last arrives, some late, some not at all."""
    rng = np.random.default_rng(seed)
    history = HomeHistory(plan(seed), rng, loss=0.4, delay=(0.05, 3.0))
    history.run(float(rng.uniform(1.0, 12.0)))
    history.alive = False
    history.run(160.0, down)
    assert history.least() > 0.0
    assert all(craft.place(history.now)[2] == 0.0 for craft in history.homers.values() if craft.segment is not None)


@pytest.mark.parametrize("seed", range(3))
def test_the_network_is_back_in_the_middle(seed: int) -> None:
    """Who flies home by itself goes on, and nobody is sent into its way."""
    rng = np.random.default_rng(seed)
    history = HomeHistory(plan(seed), rng, loss=0.1)
    history.run(4.0)
    first = min(craft.left for craft in history.homers.values())
    cut = history.now
    history.network.cut = lambda now, who: cut < now < first + 8.0
    history.run(200.0)
    assert history.least() > 0.0
    assert any(craft.place(history.now)[2] == 0.0 for craft in history.homers.values())


def test_a_battery_that_does_not_last_is_landed_and_not_flown_home() -> None:
    rng = np.random.default_rng(1)
    history = HomeHistory(plan(1), rng, loss=0.1, lasts={"v1": AFTER + 20.0})
    found = moments(history, rng)
    assert min(torn.least for torn in found) > 0.0
    assert history.homers["v1"].home is None
    assert found[-1].home == len(history.parts) - 1
    history.run(30.0)  # while it hovers, it is told of again and again; somebody hears why it has none
    assert "battery does not last" in history.missing["v1"]


def test_who_was_down_misses_its_way_home_no_sooner_than_anybody_else() -> None:
    rng = np.random.default_rng(1)
    history = HomeHistory(plan(1), rng, loss=0.1, lasts={"v1": AFTER + 20.0})
    moments(history, rng)
    history.run(30.0)
    assert "v1" in history.missing
    history.missing.clear()
    history.keeper.forget("v1")
    history.run(10.0)
    assert not history.missing
    history.run(60.0)
    assert "battery does not last" in history.missing["v1"]


@pytest.mark.parametrize("seed", [0, 1, 3, 4])
def test_one_that_a_pilot_holds_is_not_flown_into(seed: int) -> None:
    """The planner sees where it is; those who were told before that are told again."""
    rng = np.random.default_rng(seed)
    history = HomeHistory(plan(seed), rng, loss=0.1)
    history.run(4.0)
    part, craft = history.parts[1], history.homers["v1"]
    craft.freeze(history.now)
    craft.home = None
    history.conductor.gone(part, "a pilot has it", np.array(craft.place(history.now)))
    history.run(40.0)
    found = history.torn(rng)
    assert found.least > 0.0
    assert found.home == len(history.parts) - 1


def test_a_way_that_is_in_the_way_of_the_plan_gives_way_to_it() -> None:
    """One is to hover where another would land: that one is told of another place to land."""
    stays = line(np.array([0.0, 0.0, 10.0]), np.array([0.0, 3.0, 10.0]))
    comes = line(np.array([30.0, 0.0, 10.0]), np.array([14.0, 0.0, 10.0]), delay=3.0)
    homes = {"v0": (14.0, 0.0, 0.0), "v1": (30.0, 0.0, 0.0)}
    rng = np.random.default_rng(0)
    history = HomeHistory({"v0": stays, "v1": comes}, rng, loss=0.0, homes=homes)
    found = moments(history, rng)
    assert history.conductor.phase(history.now) == "done"
    assert min(torn.least for torn in found) > 0.0
    home = history.homers["v0"].home
    assert home is not None
    end = home.way.local(home.way.end)[0]
    assert 2.0 < math.dist(end[:2], homes["v0"][:2]) < 8.0
