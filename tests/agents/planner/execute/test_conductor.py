"""Histories of a bad network, in virtual time: whatever is lost, late, doubled or dead, what is flown stays apart.

Every vehicle here takes segments by the rules of the real one and flies the real one's curves, and clocks are off by as
much as was not known of them. More histories: tests/bench/plan_execute.py --histories.
"""

from __future__ import annotations

import asyncio
from typing import cast

import numpy as np
import pytest

import zmav
from agents.planner.execute.conductor import Conductor
from agents.planner.execute.executor import Executor
from agents.planner.execute.following import Following
from agents.planner.execute.track import CommonClock
from agents.planner.execute.vehicle_command import Clock
from agents.planner.model.problem import Floats, Motion, MovingObstacle
from agents.planner.model.separation import separation
from tests.agents.planner.execute.virtual import History, carousel, crossing, line, slower

ENDS = ("done", "stuck", "halted")


def ended(history: History) -> bool:
    return history.conductor.phase(history.now) in ENDS


def plan(seed: int) -> dict[str, Motion]:
    rng = np.random.default_rng(seed)
    if seed % 3 == 0:
        return crossing(rng, 5, 12.0, 2.8)
    return slower(crossing(rng, 4, 11.0, 2.8), 5.0) if seed % 3 == 1 else carousel(5, 4.0, turn=6.0, speed=2.0)


def span(motions: dict[str, Motion]) -> float:
    return max(float(motion[-1, 0]) for motion in motions.values())


def check(history: History) -> None:
    assert history.least() > 0.0
    assert max(craft.jump for craft in history.crafts.values()) < 0.25


@pytest.mark.parametrize("seed", range(4))
def test_a_good_network_flies_the_plan_in_its_own_time(seed: int) -> None:
    motions = plan(seed)
    history = History(motions, np.random.default_rng(seed), loss=0.0, delay=(0.01, 0.05))
    history.run(300.0, ended)
    assert history.conductor.phase(history.now) == "done"
    assert history.away() < 0.02
    assert history.now - 1000.0 < span(motions) + 4.5
    check(history)


@pytest.mark.parametrize("seed", range(4))
def test_loss_and_bursts_delay_and_harm_nobody(seed: int) -> None:
    history = History(plan(seed), np.random.default_rng(seed), loss=0.3 + 0.05 * (seed % 4))
    history.network.cut = lambda now, who: (now + seed) % 9.0 < 2.0
    history.run(400.0, ended)
    assert history.conductor.phase(history.now) == "done"
    assert history.away() < 0.02
    check(history)


def test_two_seconds_without_a_network_do_not_stop_a_long_plan() -> None:
    """Vehicles are told far enough ahead."""
    motions = slower(crossing(np.random.default_rng(7), 4, 11.0, 2.8), 6.0)
    history = History(motions, np.random.default_rng(7), loss=0.3)
    history.network.cut = lambda now, who: 1008.0 < now < 1010.0 or 1020.0 < now < 1022.0
    history.run(400.0, ended)
    assert history.conductor.phase(history.now) == "done"
    assert history.now - 1000.0 < span(motions) + 7.0


@pytest.mark.parametrize("seed", range(1, 7))
def test_a_planner_that_dies_leaves_everybody_at_rest_and_apart(seed: int) -> None:
    motions = plan(seed)
    rng = np.random.default_rng(seed)
    history = History(motions, rng)
    history.run(float(rng.uniform(0.5, span(motions))), ended)
    history.alive = False
    history.run(30.0)
    at_rest = history.places[-1]
    history.run(5.0)
    assert np.abs(history.places[-1] - at_rest).max() < 1e-6
    check(history)


@pytest.mark.parametrize("seed", range(3))
def test_half_of_the_fleet_out_of_reach_stays_apart_and_goes_on_when_it_is_back(seed: int) -> None:
    motions = plan(seed)
    history = History(motions, np.random.default_rng(seed))
    away = set(list(motions)[:2])
    history.network.cut = lambda now, who: who in away and 1003.0 < now < 1015.0
    history.run(400.0, lambda h: h.now > 1020.0 and ended(h))
    assert history.conductor.phase(history.now) == "done"
    check(history)


@pytest.mark.parametrize("seed", range(3))
def test_a_pause_brings_all_to_rest_early_and_they_go_on(seed: int) -> None:
    motions = plan(seed)
    history = History(motions, np.random.default_rng(seed))
    history.run(2.0 + 0.3 * span(motions))
    history.conductor.pause()
    history.run(12.0, lambda h: h.conductor.phase(h.now) == "paused")
    assert history.conductor.phase(history.now) in ("paused", "done")
    place = history.places[-1]
    history.run(3.0)
    assert np.abs(history.places[-1] - place).max() < 0.03  # their clocks may be later than we think
    history.conductor.resume()
    history.run(400.0, ended)
    assert history.conductor.phase(history.now) == "done"
    check(history)


@pytest.mark.parametrize("seed", range(3))
def test_one_who_follows_no_more_stops_the_others_apart_from_its_way(seed: int) -> None:
    history = History(plan(seed), np.random.default_rng(seed))
    history.run(5.0)
    craft = history.crafts["v1"]
    craft.freeze(history.now)
    history.run(60.0, ended)
    conductor = history.conductor
    if craft.taken:
        assert conductor.phase(history.now) == "halted"
        assert "v1" in conductor.halting


def test_what_is_told_at_once_is_clear_of_each_other() -> None:
    """Two who would be at one place at one moment, whatever the verifier said: one look does not send both there."""
    motions = {
        "v0": line(np.array([0.0, 0.0, 10.0]), np.array([20.0, 0.0, 10.0])),
        "v1": line(np.array([10.0, -10.0, 10.0]), np.array([10.0, 10.0, 10.0])),
    }
    history = History(motions, np.random.default_rng(0), radius=0.3)
    one, other = (send.entry.samples for send in history.conductor.decide(history.now))
    need = sum(part.need for part in history.parts)
    assert separation(one, other, history.downwash)[0] >= need - 0.01


def test_one_who_is_second_by_the_plan_does_not_go_first_however_late_the_first_one_is() -> None:
    """It would stand in the lane that the first one needs, and neither could go on."""
    first = line(np.array([0.0, 0.0, 10.0]), np.array([20.0, 0.0, 10.0]))
    aside = line(np.array([10.0, 5.0, 10.0]), np.array([10.0, 0.0, 10.0]), delay=5.0)
    back = line(np.array([10.0, 0.0, 10.0]), np.array([0.0, 0.0, 10.0]))
    back[:, 0] += aside[-1, 0]
    history = History({"v0": first, "v1": np.vstack((aside, back[1:]))}, np.random.default_rng(0), loss=0.2)
    history.network.cut = lambda now, who: who == "v0" and 1000.0 < now < 1010.0
    history.run(60.0, ended)
    assert history.conductor.phase(history.now) == "done"
    check(history)


def test_nobody_stops_where_one_who_cannot_be_told_will_pass() -> None:
    """All are to rest, whenever that is asked for; one does not hear of it and flies on across the other's way."""
    first = line(np.array([0.0, 0.0, 10.0]), np.array([20.0, 0.0, 10.0]))
    second = line(np.array([10.0, -12.0, 10.0]), np.array([10.0, 8.0, 10.0]), delay=1.0)
    for k in range(8):
        history = History({"v0": first, "v1": second}, np.random.default_rng(k), loss=0.1)
        history.run(2.5 + 0.4 * k)
        history.network.cut = lambda now, who: who == "v1"
        history.conductor.pause()
        history.run(8.0)
        check(history)


@pytest.mark.parametrize("at", [0.0, 2.5])
def test_one_who_takes_nothing_is_given_up_and_the_others_come_to_rest(at: float) -> None:
    """Its fence, its limits, an order: anyone who refuses does not say so to us."""
    history = History(plan(2), np.random.default_rng(1))
    history.run(at)
    history.crafts["v2"].refuses = True
    history.run(120.0, ended)
    assert history.conductor.phase(history.now) == "halted"
    assert "v2: it is heard, and has taken no trajectory" in history.conductor.halting
    check(history)


@pytest.mark.parametrize("at", [0.3, 2.5, 6.0])
def test_an_agent_that_is_started_again_does_not_seem_to_fly_what_its_numbers_say(at: float) -> None:
    """A new one counts leases and setpoints from zero again."""
    history = History(plan(2), np.random.default_rng(2))
    history.run(at)
    history.crafts["v0"].restart(history.now)
    history.restart_counting("v0")
    history.run(60.0, ended)
    assert history.conductor.phase(history.now) == "halted"
    assert "v0: its agent was restarted" in history.conductor.halting


def test_one_who_is_lost_is_waited_for_and_then_the_plan_is_given_up() -> None:
    motions = carousel(4, 4.0, turn=6.0, speed=2.0)
    history = History(motions, np.random.default_rng(1))
    history.network.cut = lambda now, who: who == "v2" and now > 1004.0
    history.run(120.0, ended)
    assert history.conductor.phase(history.now) == "stuck"
    assert [part.id for part in history.conductor.parts if part.lost] == ["v2"]
    assert {saying.kind for saying in history.conductor.said} == {"lost"}
    check(history)


class Nobody:
    """A client that hears nobody."""

    fleet = "demo"

    def vehicle(self, name: str) -> Nobody:
        return self

    def heard(self, name: str, fleet: str) -> None:
        return None


class VirtualClock(Clock):
    def __init__(self, history: History) -> None:
        self._history = history

    def now(self) -> float:
        return self._history.now


async def test_an_obstacle_on_the_way_of_one_brings_all_to_rest() -> None:
    motions = slower(carousel(3, 12.0, speed=4.0), 3.0)
    history = History(motions, np.random.default_rng(2), loss=0.1)
    history.run(4.0)
    crane = history.parts[0].track.at(np.array([12.0]))[0][0]

    answers: list[bool] = []

    def clear(p: Floats, q: Floats, radius: float) -> bool:
        answers.append(float(np.linalg.norm(0.5 * (p + q) - crane)) > radius)
        return answers[-1]

    assert [part.is_clear(history.now, clear) for part in history.parts] == [False, True, False]
    offsets = {part.id: part.offset for part in history.parts}
    executor = Executor(cast("zmav.Client", Nobody()), motions, clock=VirtualClock(history), offsets=offsets)
    flying = asyncio.create_task(executor.follow(history.conductor, lambda: True))
    await asyncio.sleep(0)
    executor.obstructed(lambda p, q, radius: True, "nothing")
    assert history.conductor.phase(history.now) == "flying"
    answers.clear()
    executor.obstructed(clear, "a crane")
    assert history.conductor.halting == "a crane in the way of v0"
    assert answers.index(False) == len(answers) - 1, "nobody else is looked at once all come to rest"
    executor.obstructed(clear, "another crane")
    assert answers.count(False) == 1
    history.run(60.0, ended)
    assert await flying == "a crane in the way of v0"
    assert history.conductor.phase(history.now) == "halted"
    assert history.parts[0].stop < 12.0
    check(history)


def test_a_mover_across_the_way_is_waited_for() -> None:
    motions = carousel(2, 10.0, speed=3.0)
    history = History(motions, np.random.default_rng(3), loss=0.1)
    place = motions["v0"][60, 1:4]
    ball = np.array([[1000.0, *place], [1013.0, *place]])
    history.conductor.reserved.movers = [MovingObstacle("ball", ball, 1.0, leaves=True)]
    history.run(120.0, ended)
    assert history.conductor.phase(history.now) == "done"
    near = [float(np.linalg.norm(places[0] - place)) for k, places in enumerate(history.places) if k * 0.1 < 13.0]
    assert min(near) > 2.0
    assert history.now - 1000.0 > span(motions) + 3.0


def test_the_common_clock_is_slowed_for_one_who_does_not_keep_up_and_let_go_again() -> None:
    motions = slower(carousel(3, 12.0, speed=4.0), 3.0)
    history = History(motions, np.random.default_rng(4), loss=0.0)
    history.run(4.0)
    conductor: Conductor = history.conductor
    part = history.parts[0]
    place, _ = part.place_at(history.now)
    off = conductor.strayed(part, history.now, history.now, place + np.array([0.5, 0.0, 0.0]))
    assert off == pytest.approx(0.5, abs=0.02)
    assert conductor.line.pace < 1.0
    history.run(10.0)
    assert conductor.line.pace == 1.0
    assert [saying.kind for saying in conductor.said] == ["slow", "pace"]
    place, _ = part.place_at(history.now)
    conductor.strayed(part, history.now, history.now, place + np.array([4.0, 0.0, 0.0]))
    assert conductor.halting
    assert part.active  # it is led to rest on its way
    history.run(60.0, ended)
    assert conductor.phase(history.now) == "halted"
    check(history)


@pytest.mark.parametrize(
    ("usual", "off", "slowed", "halted"),
    [
        (0.1, 0.45, True, False),
        (0.3, 0.55, False, False),
        (0.3, 0.65, True, False),
        (0.1, 0.8, True, False),
        (0.3, 0.8, True, False),
        (0.1, 1.0, False, True),
        (0.3, 1.0, False, True),
    ],
)
def test_nobody_is_slowed_for_one_who_is_off_its_way_as_it_usually_is(
    usual: float, off: float, slowed: bool, halted: bool
) -> None:
    history = History(slower(carousel(3, 12.0), 3.0), np.random.default_rng(4), loss=0.0, margin=0.3)
    history.run(4.0)
    conductor, part = history.conductor, history.parts[0]
    part.usual = usual
    for now in history.now + np.arange(0.0, 10.0, 0.2):  # however long it is off by so much
        place, _ = part.place_at(now)
        conductor.strayed(part, now, now, place + np.array([0.0, 0.0, off]))
        conductor.decide(now)
        assert bool(conductor.halting) == halted
        assert (conductor.line.pace < 1.0) == slowed


def test_where_it_was_before_its_trajectory_began_says_nothing_of_a_vehicle_that_is_late() -> None:
    history = History(slower(carousel(3, 12.0), 3.0), np.random.default_rng(4), loss=0.0)
    history.run(4.0)
    conductor, part = history.conductor, history.parts[0]
    part.follows(Following("px4"))
    conductor.delay(part, part.late, history.now)
    before = float(part.known.rows[0, 0]) + 0.5 * part.late
    assert conductor.strayed(part, history.now, before, part.place_at(before)[0] + 9.0) == 0.0
    assert (conductor.halting, conductor.line.pace) == ("", 1.0)


def test_nobody_is_slowed_for_one_who_rests() -> None:
    motions = {"v0": np.array([[0.0, 0.0, 0.0, 10.0]]), "v1": line(np.array([9.0, 0, 10]), np.array([40.0, 0, 10]))}
    history = History(motions, np.random.default_rng(4), loss=0.0)
    history.run(5.0)
    conductor, (rests, flies) = history.conductor, history.parts
    off = np.array([0.5, 0.0, 0.0])
    conductor.strayed(rests, history.now, history.now, rests.place_at(history.now)[0] + off)
    assert conductor.line.pace == 1.0
    conductor.strayed(flies, history.now, history.now, flies.place_at(history.now)[0] + off)
    assert conductor.line.pace < 1.0


def test_who_has_left_its_way_is_not_led_to_the_end_of_it() -> None:
    """It would fly there straight, through whatever is between."""
    history = History(slower(carousel(3, 12.0, speed=4.0), 3.0), np.random.default_rng(4), loss=0.0)
    history.run(4.0)
    conductor, part = history.conductor, history.parts[0]
    there, _ = part.place_at(history.now)
    there = there + np.array([9.0, 0.0, 0.0])
    conductor.strayed(part, history.now, history.now, there)
    assert conductor.halting == "v0 is 9.0 m off its trajectory"
    assert part.active  # and is braked on its way, where it follows
    while not part.resting(history.now):
        history.run(0.5)
    conductor.strayed(part, history.now, history.now, there + np.array([20.0, 0.0, 0.0]))
    assert part.strays  # so it is taken along again from where it holds
    assert not [send for send in conductor.decide(history.now + 30.0) if send.part is part]


def test_who_has_arrived_is_told_to_stay() -> None:
    motions = {"still": np.array([[0.0, 0.0, 0.0, 10.0]]), **slower(carousel(2, 12.0, speed=4.0), 4.0)}
    history = History(motions, np.random.default_rng(5), loss=0.2)
    history.run(45.0)
    segment = history.crafts["still"].segment
    assert segment is not None
    assert segment.end > history.now + history.crafts["still"].clock
    assert history.crafts["still"].place(history.now) == (0.0, 0.0, 10.0)


def test_a_word_that_was_overtaken_changes_nothing() -> None:
    history = History(carousel(2, 10.0), np.random.default_rng(6), loss=0.0)
    history.run(3.0)
    part = history.parts[0]
    known = part.known
    history.conductor.heard(part, history.now, part.said - 1.0, None, None, part.instance)
    assert part.active
    assert part.known is known
    history.conductor.heard(part, history.now, part.said + 1.0, None, None, part.instance)
    assert "no trajectory of ours" in part.off


def test_the_common_clock_goes_on_from_where_it_is() -> None:
    common = CommonClock(10.0, 4.0, 0.5)
    assert common.at(12.0) == 5.0
    assert common.when(5.0) == 12.0


# Vehicles that follow late, and lean in the wind.


def followed(seed: int, late: list[float], lean: float, margin: float, known: str | None) -> History:
    motions = crossing(np.random.default_rng(seed), 5, 22.0, 3.9)
    history = History(
        motions, np.random.default_rng(seed), loss=0.0, delay=(0.01, 0.05), margin=margin, late=late, lean=lean
    )
    for part in history.parts:
        part.follows(Following(known))
    history.run(300.0, ended)
    return history


def stops(history: History) -> list[str]:
    return [said.text for said in history.conductor.said if said.kind == "halt"]


@pytest.mark.parametrize("seed", range(5))
def test_a_fleet_that_is_late_as_its_kind_is_flies_a_swap_without_a_stop(seed: int) -> None:
    history = followed(seed, [0.4, 0.42, 0.45, 0.48, 0.5], 0.3, 0.9, "px4")
    assert history.conductor.phase(history.now) == "done"
    assert stops(history) == []
    assert history.least() > 0.0


@pytest.mark.parametrize("seed", range(5))
def test_a_fleet_of_which_some_are_late_stays_apart_where_it_truly_is(seed: int) -> None:
    history = followed(seed, [0.0, 0.45, 0.1, 0.5, 0.0], 0.1, 0.6, None)
    assert history.least() > 0.0
    for part, late in zip(history.parts, [0.0, 0.45, 0.1, 0.5, 0.0], strict=True):
        assert part.following.late == pytest.approx(late, abs=0.2)


def test_a_lateness_that_is_learnt_in_flight_slows_the_clock_before_it_stops_anybody() -> None:
    history = followed(3, [0.35] * 5, 0.0, 0.6, None)
    said = [each.kind for each in history.conductor.said]
    assert history.conductor.phase(history.now) == "done"
    assert "halt" not in said
    assert history.least() > 0.0
