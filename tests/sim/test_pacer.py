"""The pacer: when ticks are due, by a wall clock that the tests turn."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from zmav.errors import BadConfig
from zmav.sim import World
from zmav.sim.clock import MOST_BEHIND_S, Pacer

if TYPE_CHECKING:
    from tests.sim.conftest import MakeGcs


class Wall:
    """A wall clock that goes on only when told; each tick of the world takes ``cost`` seconds of it."""

    def __init__(self, speed: float, cost: float = 0.0) -> None:
        self.now, self.cost = 1000.0, cost
        self.pacer = Pacer(0.01, speed, lambda: self.now)
        self.ticks = 0

    def run(self, seconds: float) -> float:
        """Tick whenever that is due, for so many wall seconds; gives simulated seconds."""
        end, before = self.now + seconds, self.ticks
        while self.now < end - 1e-9:
            wait = self.pacer.wait_s()
            if wait > 0.0:
                self.now = min(self.now + wait, end)
                continue
            self.now += self.cost
            self.ticks += 1
            self.pacer.ticked()
        return (self.ticks - before) * 0.01


@pytest.mark.parametrize("speed", [0.5, 1.0, 4.0])
def test_it_keeps_the_speed_asked_for(speed: float) -> None:
    wall = Wall(speed, cost=0.001)
    assert wall.run(10.0) == pytest.approx(10.0 * speed, abs=0.02)
    assert wall.pacer.reached == pytest.approx(speed, rel=0.02)
    assert not wall.pacer.behind
    assert wall.pacer.given_up_s == 0.0


def test_without_a_limit_nothing_is_waited_for() -> None:
    wall = Wall(math.inf, cost=0.001)
    assert wall.run(2.0) == pytest.approx(20.0, abs=0.02)
    assert not wall.pacer.behind


def test_too_slow_a_machine_is_behind_and_says_so() -> None:
    wall = Wall(4.0, cost=0.005)  # it can do two times real time
    assert wall.run(10.0) == pytest.approx(20.0, abs=0.05)
    assert wall.pacer.behind
    assert wall.pacer.reached == pytest.approx(2.0, rel=0.02)
    assert wall.pacer.given_up_s == pytest.approx(5.0, abs=0.5)
    wall.cost = 0.001
    wall.run(3.0)
    assert not wall.pacer.behind


def test_a_short_delay_is_caught_up_with_and_a_long_one_is_not() -> None:
    wall = Wall(1.0)
    wall.run(1.0)
    wall.now += MOST_BEHIND_S * 0.8
    assert wall.run(1.0) == pytest.approx(1.0 + MOST_BEHIND_S * 0.8, abs=0.02)
    wall.now += 3600.0  # the computer slept
    assert wall.run(1.0) == pytest.approx(1.0, abs=0.02)
    assert wall.pacer.given_up_s == pytest.approx(3600.0, abs=0.1)


def test_a_pause_is_not_caught_up_with() -> None:
    wall = Wall(2.0)
    wall.run(1.0)
    wall.pacer.pause()
    assert wall.pacer.wait_s() == math.inf
    assert wall.run(5.0) == 0.0
    assert not wall.pacer.behind
    wall.pacer.resume()
    assert wall.run(1.0) == pytest.approx(2.0, abs=0.03)
    assert wall.pacer.given_up_s == 0.0


def test_steps_end_in_a_pause() -> None:
    wall = Wall(1.0)
    wall.pacer.pause()
    wall.pacer.allow(25)
    assert wall.pacer.stepping
    assert wall.run(5.0) == pytest.approx(0.25)
    assert wall.pacer.paused
    assert not wall.pacer.stepping


def test_another_speed_holds_at_once() -> None:
    wall = Wall(1.0)
    wall.run(10.0)
    wall.pacer.set_speed(10.0)
    assert wall.run(1.0) == pytest.approx(10.0, abs=0.1)
    wall.pacer.set_speed(1.0)
    assert wall.run(1.0) == pytest.approx(1.0, abs=0.02)
    for speed in (0.0, -1.0, math.nan, 1e-9, 1e9):
        with pytest.raises(BadConfig, match=r"expected 0\.001 to 1e\+06"):
            wall.pacer.set_speed(speed)


def test_what_is_given_up_is_told() -> None:
    wall, told = Wall(1.0), list[float]()
    wall.pacer.on_given_up = told.append
    wall.run(1.0)
    assert told == []
    wall.now += 2.0  # the computer slept
    wall.run(1.0)
    assert told == [pytest.approx(2.0, abs=0.02)]
    assert wall.pacer.given_up_s == sum(told)


def test_of_a_slow_world_is_told_each_second_of_the_wall() -> None:
    for wall, times in ((Wall(0.1), 10), (Wall(4.0, cost=0.05), 10), (Wall(1.0), 0), (Wall(4.0), 0)):
        told = list[float]()
        wall.pacer.on_slow = lambda wall=wall, told=told: told.append(wall.now)  # type: ignore[misc]
        wall.run(10.5)
        assert len(told) == times, wall.pacer.speed


def test_a_world_that_falls_behind_says_so_and_its_receivers_tell_utc() -> None:
    world, said = World(copters=2, epoch_s=1.8e9), list[str]()
    world.say = said.append
    nodes = [vehicle.node for vehicle in world.vehicles]
    world.step(1.0)
    for late in (0.4, 0.4, 0.4, 5.0):
        world.pacer.on_given_up(late)
    assert [node.unix_us for node in nodes] == [pytest.approx(1.8e15 + 7.2e6, abs=10.0)] * 2
    (words,) = said  # the next one comes a minute later
    assert "too slow for the simulation" in words and "1.2 s behind" in words
    world.set_speed(4.0)  # such a world has a time of its own
    world.pacer.on_given_up(1.0)
    assert nodes[0].unix_us == pytest.approx(1.8e15 + 7.2e6, abs=10.0)


def test_autopilots_of_a_slow_world_are_heard_each_second_all_the_same(make_gcs: MakeGcs) -> None:
    """Who listens has a real clock, and takes one for dead after three seconds of it without a HEARTBEAT."""
    gcs = make_gcs()
    gcs.world.step(1.0)
    before = len(gcs.all("HEARTBEAT"))
    gcs.world.pacer.on_slow()
    assert len(gcs.all("HEARTBEAT")) == before + 1
    gcs.vehicle.node.hung = True
    gcs.world.pacer.on_slow()
    assert len(gcs.all("HEARTBEAT")) == before + 1
