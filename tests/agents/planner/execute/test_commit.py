"""What a vehicle may be flying by what was heard of it, and who has to pass first."""

from __future__ import annotations

import time

import numpy as np
import pytest

from agents.planner.execute.commit import TAKING, Entry, Order, Part, Reserved
from agents.planner.execute.offset import Offset
from agents.planner.execute.track import CommonClock, Profile, Track, knots, onward
from agents.planner.model.problem import Motion, MovingObstacle
from tests.agents.planner.execute.virtual import carousel, line


def part_of(name: str, start: tuple[float, float], goal: tuple[float, float], delay: float = 0.0) -> Part:
    motion = line(np.array([*start, 10.0]), np.array([*goal, 10.0]), delay=delay)
    part = Part(name, Track(motion), 1.0, 2.5, 0.1, Offset())
    part.entries = [entry(part, 0.0)]
    return part


def entry(part: Part, stop: float) -> Entry:
    """On the common clock from 2 s on, to rest at ``stop``."""
    rest = Profile.resting(0.0, 0.0)
    profile = onward(rest, 1.0, CommonClock(2.0, 0.0), stop, part.track.end, 0.5) if stop else rest
    assert profile is not None
    return Entry(profile, knots(part.track, profile, 0.0), 1.0, np.inf)


def test_a_pending_trajectory_is_flown_once_the_vehicle_says_so() -> None:
    part = part_of("a", (0.0, 0.0), (20.0, 0.0))
    pending = entry(part, 3.0)
    pending.sent, pending.deadline = [(1, 5), (1, 6)], 50.0
    part.entries.append(pending)
    assert not part.acknowledge((1, 4), 49.0)
    assert part.pending
    assert part.acknowledge((1, 6), 49.5)
    assert part.entries == [pending]
    assert part.stop == 3.0


def test_a_pending_trajectory_is_forgotten_only_on_a_word_after_its_deadline() -> None:
    part = part_of("a", (0.0, 0.0), (20.0, 0.0))
    pending = entry(part, 3.0)
    pending.sent, pending.deadline = [(1, 5)], 50.0
    part.entries.append(pending)
    assert not part.acknowledge((1, 4), 50.0)
    assert not part.acknowledge((1, 4), 50.0 + TAKING)  # it may just be taking it
    assert part.stop == 0.0
    assert part.acknowledge((1, 4), 50.1 + TAKING)
    assert not part.pending


def test_a_trajectory_taken_is_kept_whatever_its_deadline() -> None:
    part = part_of("a", (0.0, 0.0), (20.0, 0.0))
    pending = entry(part, 3.0)
    pending.sent, pending.deadline = [(1, 5)], 50.0
    part.entries.append(pending)
    assert part.acknowledge((1, 5), 60.0)
    assert part.known is pending


def test_nobody_is_sent_through_one_who_may_still_be_there() -> None:
    first, second = part_of("first", (10.0, 0.0), (10.0, 20.0)), part_of("second", (0.0, 0.0), (20.0, 0.0), delay=4.0)
    reserved = Reserved([first, second], 1.5)
    through = entry(second, second.track.end)
    assert reserved.blocker(second, through, 0.0) == "first"
    first.entries.append(entry(first, first.track.end))
    assert reserved.blocker(second, through, 0.0) == "first"
    first.entries.pop(0)
    assert reserved.blocker(second, through, 0.0) is None


def test_below_and_above_one_who_is_lost_nobody_passes() -> None:
    lost, other = part_of("lost", (10.0, 0.0), (10.0, 0.0)), part_of("other", (0.0, 0.0), (20.0, 0.0))
    lost.track.pos[:, 2] += 30.0
    lost.entries = [entry(lost, 0.0)]
    reserved = Reserved([lost, other], 1.5)
    through = entry(other, other.track.end)
    assert reserved.blocker(other, through, 0.0) is None
    lost.lost = True
    assert reserved.blocker(other, through, 0.0) == "lost"
    lost.lost = False
    reserved.parts.remove(lost)
    reserved.ghosts.append(lost)
    lost.off, lost.place = "a pilot has it", np.array([10.0, 0.0, 0.0])
    assert reserved.blocker(other, through, 0.0) == "lost"


def test_what_moves_by_itself_is_kept_clear_of_until_it_has_left() -> None:
    part = part_of("a", (0.0, 0.0), (20.0, 0.0))
    reserved = Reserved([part], 1.5)
    through = entry(part, part.track.end)
    stands = np.array([[0.0, 10.0, 0.0, 10.0], [3.0, 10.0, 0.0, 10.0]])
    reserved.movers = [MovingObstacle("balloon", stands, 1.0)]
    assert reserved.blocker(part, through, 0.0) == "balloon"
    reserved.movers = [MovingObstacle("plane", stands, 1.0, leaves=True)]
    assert reserved.blocker(part, through, 0.0) is None


def test_to_come_to_rest_near_what_moves_is_better_than_to_go_on_nearer_but_near_nobody_else() -> None:
    part = part_of("a", (0.0, 0.0), (20.0, 0.0))
    part.entries, rests = [entry(part, part.track.end)], entry(part, 2.0)
    reserved = Reserved([part], 1.5)
    aircraft = MovingObstacle("aircraft", np.array([[0.0, 20.0, 0.0, 10.0]]), 30.0)
    reserved.movers = [aircraft]
    assert reserved.blocker(part, rests, 0.0) == "aircraft"
    assert reserved.is_better(part, rests, 0.0)
    assert not reserved.is_better(part, part.known, 0.0), "it is what it flies"
    x, y, z = rests.samples[-1, 1:]
    mate = MovingObstacle("mate", np.array([[0.0, x, y + 60.0, z], [30.0, x, y + 60.0, z], [60.0, x, y + 2.0, z]]), 1.0)
    reserved.movers = [mate, aircraft]
    assert reserved.blocker(part, part.known, 0.0) == "aircraft", "it is clear of the mate, who comes there later"
    assert not reserved.is_better(part, rests, 0.0), "however near the aircraft is to it"
    other = part_of("other", (x, y), (x, y))
    reserved.parts, reserved.movers = [part, other], [aircraft]
    assert not reserved.is_better(part, rests, 0.0)


def test_who_crosses_second_waits_for_the_first_and_the_first_for_nobody() -> None:
    first, second = part_of("first", (10.0, -10.0), (10.0, 10.0)), part_of("second", (0.0, 0.0), (20.0, 0.0), delay=4.0)
    order = Order([first, second], 1.5)
    whole = np.array([first.track.end, second.track.end])
    assert order.allows(0, first.track.end, np.zeros(2)) is None
    assert order.allows(1, second.track.end, np.array([2.0, 0.0])) == 0
    assert order.allows(1, second.track.end, whole) is None
    assert order.allows(1, 5.0, np.zeros(2)) is None


def drawn(seed: int) -> dict[str, Motion]:
    """Five that go here and there in a small square, rest on the way, and pass each other near."""
    rng, motions = np.random.default_rng(seed), {}
    for k in range(5):
        places = rng.uniform(0.0, 9.0, (5, 3)) * (1.0, 1.0, 0.0)
        places[2] = places[1]
        motions[f"v{k}"] = np.column_stack((np.cumsum(rng.uniform(1.0, 5.0, 5)) - 1.0, places))
        motions[f"v{k}"][0, 0] = 0.0
    return motions


@pytest.mark.parametrize("motions", [carousel(5, 4.0, turn=6.0), *map(drawn, range(6))])
def test_the_order_is_the_same_by_brute_force(motions: dict[str, Motion]) -> None:
    parts = [Part(k, Track(m), 1.0, 2.5, 0.0, Offset()) for k, m in motions.items()]
    order = Order(parts, 1.5)
    moments = np.arange(order.count, dtype=np.float64) * 0.25
    places = np.array([part.track.at(moments)[0] for part in parts])
    places[:, :, 2] /= 1.5
    earlier = np.arange(order.count)[:, None] < np.arange(order.count) - 1
    for k in range(len(parts)):
        for i in range(len(parts)):
            near = (
                np.linalg.norm(places[i, :, None] - places[k, None, :], axis=2) < 2.0 if i != k else np.zeros(1, bool)
            )
            last = np.where(near & earlier, np.arange(order.count)[:, None], -1).max(axis=0)
            assert order.first[k, i].tolist() == np.maximum.accumulate(last).tolist()


@pytest.mark.parametrize("n", [1, 2])
def test_few_vehicles_have_an_order_too(n: int) -> None:
    parts = [part_of(f"v{k}", (5.0 * k, 0.0), (5.0 * k, 10.0)) for k in range(n)]
    assert Order(parts, 1.0).allows(0, 3.0, np.zeros(n)) is None


def test_who_goes_first_is_known_however_long_a_plan_lasts() -> None:
    """Moments are quarters of a second: after 8191 s they had come round, and nobody went first any more."""
    late = 9000.0
    first = part_of("first", (10.0, 0.0), (10.0, 20.0), delay=late)
    second = part_of("second", (0.0, 0.0), (20.0, 0.0), delay=late + 30.0)
    order = Order([first, second], 1.5)
    stops = np.array([late, np.inf])
    assert order.allows(1, late + 31.0, stops) is None
    assert order.allows(1, second.track.end, stops) == 0
    assert order.allows(1, second.track.end, np.array([first.track.end, np.inf])) is None


def test_who_rests_side_by_side_for_long_costs_no_square_of_that_time() -> None:
    """A plan of 4000 s held up the agent's loop for 22 s, one of 9000 s would for two minutes."""
    beside = [("first", 0.0), ("second", 2.3)]  # by what they need, and a bit more
    Order([part_of(name, (x, 0.0), (x, 10.0)) for name, x in beside], 1.5)  # it may have to be compiled
    parts = [part_of(name, (x, 0.0), (x, 10.0), delay=9000.0) for name, x in beside]
    begun = time.process_time()
    order = Order(parts, 1.5)
    assert time.process_time() - begun < 10.0
    assert order.first.max() == -1
