"""Landings on a target, with and without gusts; in virtual time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from agents.follower.guide import WAITS
from tests.agents.follower.virtual import DECK, TICK, Place, World


@pytest.mark.parametrize("speed", [0.0, 0.6])
def test_it_lands_in_the_middle(speed: float) -> None:
    world = World(lambda t: (speed * t, 0.0)).run(15.0)
    world.guide.land()
    world.run(60.0, lambda world: world.command.land)
    assert world.command.land
    assert world.guide.phase == "touch"
    assert world.off[-1] < 0.15
    assert DECK - world.pos[2] < 0.5


def wandering(seed: int) -> Place:
    """As a common GPS: by some 0.3 m in the time that the vehicle goes down unseen."""
    steps = np.random.default_rng(seed).normal(0.0, 0.05, (2, 2000))
    north, east = (np.cumsum(np.convolve(each, np.full(20, 0.05))) for each in steps)  # a filter smooths over a second
    return lambda t: (float(north[round(t / TICK)]), float(east[round(t / TICK)]))


def test_it_lands_in_the_middle_although_its_own_place_wanders() -> None:
    off = []
    for seed in range(8):
        world = World(lambda t: (0.0, 0.0))
        world.wander = wandering(seed)
        world.run(15.0).guide.land()
        world.run(60.0, lambda world: world.command.land)
        assert world.command.land
        off.append(world.off[-1])
    assert max(off) < 0.15


def test_a_descent_waits_while_it_is_off_and_goes_up_again_where_the_pad_is_lost() -> None:
    world = World(lambda t: (0.0, 0.0)).run(10.0)
    world.guide.land()
    world.run(4.0)
    height = DECK - world.pos[2]
    assert 2.5 < height < 4.6
    world.hidden = lambda t: True
    world.run(10.0)
    assert world.guide.phase in ("approach", "search")
    assert DECK - world.pos[2] > height
    assert world.guide.lost == 1
    gust = World(lambda t: (0.0, 0.0)).run(10.0)
    gust.guide.land()
    lowest = gust.pos[2]
    for k in range(100):  # blown a metre off by a gust, and held there
        gust.pos[1], gust.vel[1] = (k * TICK, 1.0) if k * TICK < 1.0 else (1.0, 0.0)
        gust.run(TICK)
        lowest = max(lowest, gust.pos[2])
    assert DECK - lowest > 4.5


def test_a_landing_is_called_off() -> None:
    world = World(lambda t: (0.0, 0.0)).run(10.0)
    world.guide.land()
    world.run(5.0)
    assert world.phases[-1] == "descend"
    world.guide.wanted = "follow"
    world.run(6.0)
    assert world.phases[-1] == "track"
    assert DECK - world.pos[2] == pytest.approx(5.0, abs=0.2)
    assert not world.command.land


def landing(until: Callable[[World], bool]) -> World:
    world = World(lambda t: (0.0, 0.0)).run(10.0)
    world.guide.land()
    return world.run(60.0, until)


def nearly_down(ticks: int = 1) -> World:
    """At rest over the pad's middle, so many ticks before it goes down unseen."""
    last = landing(lambda world: world.guide.phase == "touch").frame - ticks
    world = landing(lambda world: world.frame == last)
    assert (world.guide.phase, world.off[-1] < 0.05) == ("descend", True)
    return world


def test_it_does_not_go_down_unseen_while_a_gust_carries_it_off() -> None:
    """It is over the middle, but would be two decimetres beside it by the time it is on the deck."""
    world = nearly_down(4)
    for _ in range(4):  # it hears that of itself a little later
        world.vel[1] = 0.19
        world.step()
    assert world.off[-1] < world.tuned["gate"]
    assert world.phases[-1] == "descend"
    world.run(5.0, lambda world: world.guide.phase == "touch")
    assert world.phases[-1] == "touch"


def test_a_gust_on_the_last_half_metre_has_it_rise_and_try_again() -> None:
    world = nearly_down()
    world.run(5.0, lambda world: world.guide.phase == "touch")
    world.vel[1] = 0.6
    world.run(1.0, lambda world: world.guide.phase == "descend")
    assert world.guide.phase == "descend"
    assert not world.command.land
    assert DECK - world.command.pos[2] > 0.9  # where it sees the pad
    assert world.guide.called_off == 1
    highest = 0.0
    while world.guide.phase == "descend":
        world.step()
        highest = max(highest, DECK - float(world.pos[2]))
    assert highest > 0.85, "it is told to rise, but sinks at the same time"
    world.run(30.0, lambda world: world.command.land)
    assert world.command.land
    assert world.off[-1] < 0.15


def test_it_rises_no_higher_than_it_was_asked_to_follow() -> None:
    world = nearly_down()
    world.guide.height = 0.7
    world.run(5.0, lambda world: world.guide.phase == "touch")
    world.vel[1] = 0.6
    world.run(1.0, lambda world: world.guide.phase == "descend")
    assert DECK - world.command.pos[2] == pytest.approx(0.7, abs=0.05)


def test_a_lower_height_asked_for_while_it_waits_unseen_is_no_sudden_descent() -> None:
    world = landing(lambda world: DECK - float(world.pos[2]) < 3.0)
    world.hidden = lambda t: True
    world.run(1.0)
    height = DECK - world.command.pos[2]
    world.guide.height = 1.0
    world.step()
    assert world.phases[-1] == "descend"
    assert DECK - world.command.pos[2] == pytest.approx(height, abs=0.1)


def test_a_landing_that_gusts_stop_again_and_again_is_given_up() -> None:
    world = landing(lambda world: world.guide.phase == "descend")
    begun = world.t
    while world.guide.wanted == "land" and world.t < begun + 300.0:
        if world.guide.phase == "touch":
            world.vel[1] = 0.6
        world.step()
        assert not world.command.land
    assert world.guide.called_off >= 3
    assert WAITS < world.t - begun < 3.0 * WAITS
    assert "rose again" in world.guide.why
    assert "less wind" in world.guide.why
    world.run(10.0)
    assert world.phases[-1] == "track"
    assert DECK - world.pos[2] == pytest.approx(5.0, abs=0.2)
    world.guide.land()
    assert (world.guide.why, world.guide.called_off) == ("", 0)
    world.run(60.0, lambda world: world.command.land)
    assert world.command.land


def test_a_landing_that_is_given_up_because_the_pad_is_seldom_seen_says_so() -> None:
    world = landing(lambda world: DECK - float(world.pos[2]) < 2.0)
    world.hidden = lambda t: t % 2.5 > 0.2
    world.run(300.0, lambda world: world.guide.wanted != "land")
    assert "did not see the pad in" in world.guide.why
    assert "wind" not in world.guide.why


def test_near_the_deck_it_goes_on_down_whatever_blows() -> None:
    """Called off there it would be on the deck before it rises."""
    world = nearly_down()
    world.run(10.0, lambda world: DECK - float(world.pos[2]) < 0.3)
    assert world.guide.phase == "touch"
    world.vel[1] = 0.6
    world.run(1.0, lambda world: world.command.land)
    assert world.command.land


def test_it_rises_while_it_waits_unseen_above_the_pad() -> None:
    """From higher up it sees more; it does not wait until the target counts as lost."""
    world = landing(lambda world: DECK - float(world.pos[2]) < 2.0)
    world.hidden = lambda t: True
    world.run(1.0)
    lowest = DECK - float(world.pos[2])
    world.run(1.5)
    assert world.guide.phase == "descend"
    assert DECK - float(world.pos[2]) > lowest + 0.3


def test_it_does_not_sink_unseen() -> None:
    world = World(lambda t: (0.0, 0.0)).run(10.0)
    world.guide.land()
    world.run(60.0, lambda world: DECK - float(world.pos[2]) < 2.0)
    lowest = DECK - float(world.pos[2])
    world.hidden = lambda t: True
    for _ in range(60):
        world.run(TICK)
        assert not world.command.land
        assert DECK - float(world.pos[2]) > lowest - 0.4
