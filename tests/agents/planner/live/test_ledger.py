"""The book: who waits for whom, what takes whose place, what a standby goes on with."""

from __future__ import annotations

import pytest

from agents.planner.live.checks import check_goal
from agents.planner.live.ledger import MOST_ENDED, MOST_OPEN, GoalBook
from zmav.errors import BadInput
from zmav.wire import swarm


def hold(*names: str) -> swarm.Goal:
    return swarm.Hold(vehicles=list(names))


def test_what_comes_now_takes_the_place_of_what_shares_a_vehicle() -> None:
    ledger = GoalBook()
    first = ledger.add(hold("a", "b"), "now", 1.0, 1)
    apart = ledger.add(hold("c"), "now", 1.0, 1)
    second = ledger.add(hold("b"), "now", 2.0, 1, by="ops")
    assert (first.state, first.text) == ("cancelled", f"{second.id} took its place")
    assert second.by == "ops"
    assert ledger.ready() == [apart, second]


def test_what_is_queued_waits_for_all_before_it() -> None:
    ledger = GoalBook()
    first = ledger.add(hold("a", "b"), "queue", 1.0, 1)
    second = ledger.add(hold("b", "c"), "queue", 1.0, 1)
    third = ledger.add(hold("c"), "queue", 1.0, 1)
    apart = ledger.add(hold("d"), "queue", 1.0, 1)
    assert ledger.ready() == [first, apart]
    ledger.end(first, "done", "done")
    assert ledger.ready() == [second, apart]  # the third waits for the second, though nobody flies c
    ledger.end(second, "failed", "no way")
    assert ledger.ready() == [third, apart]


def test_what_has_ended_stays_as_it_ended() -> None:
    ledger = GoalBook()
    entry = ledger.add(hold("a"), "now", 1.0, 1)
    ledger.end(entry, "done", "there")
    ledger.end(entry, "cancelled", "too late")
    assert (entry.state, entry.text, entry.progress) == ("done", "there", 1.0)


def test_goals_are_found_by_id_and_the_others_named() -> None:
    ledger = GoalBook()
    entry = ledger.add(hold("a"), "now", 1.0, 3)
    assert ledger.find(entry.id) == [entry]
    assert ledger.find("") == [entry]
    with pytest.raises(BadInput, match=f"no goal g9; in the book are: {entry.id}"):
        ledger.find("g9")


def test_a_goal_that_nobody_could_have_given_fails_when_it_is_taken_over() -> None:
    ledger = GoalBook()
    good = ledger.add(hold("a"), "now", 1.0, 1)
    far = ledger.add(swarm.GoTo(vehicles=["b"], to=[(0.0, 1e300, -9.0)]), "now", 1.0, 1)
    nobody = ledger.add(hold(), "now", 1.0, 1)
    other = GoalBook()
    again = other.take_over(swarm.Book(t=1.0, planner="old", instance="x", term=1, goals=ledger.goals), check_goal)
    assert [entry.id for entry in again] == [good.id]
    failed = {entry.id: entry.text for entry in other.goals if entry.state == "failed"}
    assert set(failed) == {far.id, nobody.id}
    assert "not taken over from old: goal.to[0][1]" in failed[far.id]


def test_the_book_is_finite() -> None:
    ledger = GoalBook()
    for i in range(MOST_OPEN):
        ledger.add(hold(f"v{i}"), "now", 1.0, 1)
    with pytest.raises(BadInput, match="full"):
        ledger.add(hold("more"), "now", 1.0, 1)
    for entry in ledger.open:
        ledger.end(entry, "done", "")
    assert len(ledger.goals) == MOST_ENDED


def test_a_standby_goes_on_with_what_has_not_ended() -> None:
    ledger = GoalBook()
    done, flying = ledger.add(hold("a"), "now", 1.0, 1), ledger.add(hold("b"), "now", 1.0, 1)
    paused = ledger.add(hold("c"), "now", 1.0, 1)
    ledger.end(done, "done", "")
    flying.state, flying.makespan, paused.state = "flying", 12.0, "paused"
    told = swarm.Book(t=1.0, planner="old", instance="x", term=1, goals=ledger.goals)
    other = GoalBook()
    again = other.take_over(told, check_goal)
    assert [entry.id for entry in again] == [flying.id, paused.id]
    assert [(entry.state, entry.makespan) for entry in again] == [("queued", None), ("paused", None)]
    assert flying.state == "flying", "the old book is not ours to change"
    assert other.add(hold("d"), "now", 2.0, 1).id not in {entry.id for entry in told.goals}
