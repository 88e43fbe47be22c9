"""Who is in charge: one of many, whatever is lost, by their words alone."""

from __future__ import annotations

import itertools
import random

import pytest

from agents.planner.live.fleet import Hearing
from agents.planner.live.leadership.election import PATIENCE, SILENCE, LeaderElection, Token
from zmav.tokens import OF_EACH, STRANGERS
from zmav.wire import swarm


def anybody(name: str) -> bool:
    return True


def book(who: LeaderElection, now: float) -> swarm.Book:
    return swarm.Book(t=now, planner=who.name, instance=who.instance, term=who.term)


def test_nobody_heard_for_a_while_and_it_takes_charge() -> None:
    one = LeaderElection("a", "1", anybody)
    assert not one.lost(100.0)
    assert not one.lost(100.0 + PATIENCE)
    assert one.lost(100.1 + PATIENCE)
    assert one.take() is None
    assert one.in_charge
    assert (one.term, one.of) == (1, "a")


def test_the_book_alone_keeps_a_standby_waiting() -> None:
    chief, other = LeaderElection("a", "1", anybody), LeaderElection("b", "2", anybody)
    chief.take()
    for now in range(10):
        assert not other.hear(book(chief, now), float(now))
        assert not other.lost(now + PATIENCE)
    assert other.of == "a"
    assert other.lost(9.1 + PATIENCE)


def test_a_token_without_a_book_is_believed_for_a_while() -> None:
    chief, other = LeaderElection("a", "1", anybody), LeaderElection("b", "2", anybody)
    chief.take()
    assert not other.lost(0.0)
    other.token("a", Token("1", True), True)
    other.hear(book(chief, 0.0), 0.0)
    assert not other.lost(PATIENCE + SILENCE)
    assert other.lost(PATIENCE + SILENCE + 0.1)
    other.token("a", Token("1", True), False)
    assert other.lost(PATIENCE + 0.1)


def test_a_flood_of_tokens_is_bounded_and_takes_none_from_the_planner_in_charge() -> None:
    """A relay forges them, under names that may plan and names that may not."""
    chief, other = LeaderElection("a", "1", anybody), LeaderElection("b", "2", {"a", "b", "c"}.__contains__)
    chief.take()
    for n in range(5000):
        other.token(f"ghost{n}", Token("1", True), True)
    assert not other.lost(0.0) and other.lost(PATIENCE + 0.1), "nobody who may plan is there"
    other.token("a", Token("1", True), True)
    other.hear(book(chief, 0.0), 0.0)
    for n in range(5000):
        other.token("a", Token(f"forged{n}", True), True)
        other.token("c", Token(f"forged{n}", False), True)
    assert len(other.tokens) <= STRANGERS + 2 * OF_EACH
    assert not other.lost(PATIENCE + SILENCE), "the true one is known among them"
    other.token("a", Token("1", True), False)
    assert other.lost(PATIENCE + 0.1), "and what is forged beside it holds nobody off when it is gone"


def test_its_word_alone_keeps_a_standby_waiting_and_what_it_has_of_the_book() -> None:
    chief, other = LeaderElection("a", "1", anybody), LeaderElection("b", "2", anybody)
    chief.take()
    told = book(chief, 0.0)
    other.hear(told, 0.0)
    for now in range(10):
        other.beat(swarm.Charge(t=now, planner="a", instance="1", term=1), float(now))
        assert not other.lost(now + PATIENCE)
    other.beat(swarm.Charge(t=9.0, planner="z", instance="0", term=0), 12.0)  # one that has been put off says nothing
    assert other.lost(9.1 + PATIENCE)
    assert other.take() is told


def with_goals(who: LeaderElection) -> swarm.Book:
    goal = swarm.GoalEntry(id="g1", goal=swarm.Hold(vehicles=["quad1"]), state="flying", t=0.0)
    return swarm.Book(t=0.0, planner=who.name, instance=who.instance, term=who.term, goals=[goal])


def test_one_that_comes_again_with_nothing_does_not_displace_the_book_of_who_stands_by() -> None:
    """Killed and started again at once, it may hear of nobody, and take charge with an empty book of the same term."""
    dead, other = LeaderElection("a", "1", anybody), LeaderElection("b", "2", anybody)
    dead.take()
    told = with_goals(dead)
    other.hear(told, 0.0)
    assert not other.lost(0.0)
    for instance in ("0", "3"):
        again = LeaderElection("a", instance, anybody)
        again.take()
        other.hear(book(again, 1.0), 1.0)
        other.beat(swarm.Charge(t=1.0, planner="a", instance=instance, term=1), 1.0)
        assert other.book is told
        assert other.lost(PATIENCE + 0.1)
        other.hear(book(again, 5.0), PATIENCE + 0.2)
        assert other.book is told
    assert other.take() is told
    other.goals = True
    assert again.hear(with_goals(other), 6.0)


def test_of_two_with_the_same_term_the_one_with_goals_stays() -> None:
    one, two = LeaderElection("a", "1", anybody, goals=True), LeaderElection("b", "2", anybody)
    one.take(), two.take()
    assert not one.hear(book(two, 0.0), 0.1)
    assert two.hear(with_goals(one), 0.1)


def test_who_has_no_book_waits_for_those_who_may_have_it() -> None:
    newcomer = LeaderElection("c", "3", anybody)
    assert not newcomer.lost(0.0)
    newcomer.token("b", Token("2", False), True)
    assert not newcomer.lost(PATIENCE + SILENCE)
    assert newcomer.lost(PATIENCE + SILENCE + 0.1)
    newcomer.token("b", Token("2", False), False)
    assert newcomer.lost(PATIENCE + 0.1)


def test_who_takes_over_has_the_book_and_a_higher_term() -> None:
    chief, other = LeaderElection("a", "1", anybody), LeaderElection("b", "2", anybody)
    chief.take()
    told = book(chief, 0.0)
    other.hear(told, 0.0)
    assert other.take() is told
    assert other.term == 2
    assert chief.hear(book(other, 10.0), 10.0)
    assert not chief.in_charge
    assert chief.of == "b"


def test_of_two_with_the_same_term_one_stands_by() -> None:
    one, two = LeaderElection("a", "1", anybody), LeaderElection("b", "2", anybody)
    one.take(), two.take()
    first, second = book(one, 0.0), book(two, 0.0)
    assert one.hear(second, 0.1) != two.hear(first, 0.1)
    assert one.in_charge != two.in_charge


def test_an_overtaken_book_of_a_lower_term_changes_nothing() -> None:
    old, new, third = (
        LeaderElection("a", "1", anybody),
        LeaderElection("b", "2", anybody, highest=1),
        LeaderElection("c", "3", anybody),
    )
    old.take(), new.take()
    third.hear(book(new, 0.0), 0.0)
    third.hear(book(old, 0.5), 0.5)
    assert third.of == "b"


@pytest.mark.parametrize("seed", range(40))
def test_any_history_ends_with_exactly_one(seed: int) -> None:
    """Books and tokens are lost, planners die and come; then the network is whole, and one is in charge of all."""
    chance = random.Random(seed)
    planners = [LeaderElection(name, name * 3, anybody) for name in "abcd"]
    alive = set(range(4))
    for step in range(400):
        now = step * 0.5
        good = step > 250
        if not good and chance.random() < 0.03 and len(alive) > 1:
            alive.discard(chance.choice(sorted(alive)))
        if not good and chance.random() < 0.05:
            newcomer = chance.randrange(4)
            if newcomer not in alive:
                planners[newcomer] = LeaderElection(planners[newcomer].name, f"{planners[newcomer].instance}x", anybody)
                alive.add(newcomer)
        for i, j in itertools.permutations(sorted(alive), 2):
            if (good or chance.random() < 0.5) and planners[i].in_charge:
                planners[j].hear(book(planners[i], now), now)
        for i in sorted(alive):
            if not planners[i].in_charge and planners[i].lost(now):
                planners[i].take()
    chiefs = [planners[i] for i in alive if planners[i].in_charge]
    assert len(chiefs) == 1
    assert {planners[i].of for i in alive} == {chiefs[0].name}


# Half of the fleet.


@pytest.mark.parametrize(
    ("airborne", "heard", "goal", "may"),
    [
        ("", "abc", "a", True),
        ("abcd", "abcd", "a", True),
        ("abcd", "abc", "abcd", True),
        ("abcd", "ab", "abc", False),
        ("abcd", "ab", "ab", True),
        ("abcd", "", "a", False),
        ("abcde", "abc", "ce", True),
        ("abcde", "abc", "e", False),
    ],
)
def test_the_smaller_side_begins_nothing(airborne: str, heard: str, goal: str, may: bool) -> None:
    hearing = Hearing(frozenset(airborne), frozenset(heard))
    assert hearing.may_move(goal) is may
    assert hearing.unheard == set(airborne) - set(heard)
    assert f"of {len(airborne)} vehicles" in hearing.words()


def test_two_sides_never_both_move_the_same_vehicle() -> None:
    everybody = frozenset("abcdef")
    for cut in range(7):
        one, other = Hearing(everybody, frozenset("abcdef"[:cut])), Hearing(everybody, frozenset("abcdef"[cut:]))
        for goal in ("a", "f", "af", "abcdef"):
            assert not (one.may_move(goal) and other.may_move(goal))
