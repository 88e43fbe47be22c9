"""What is flown above a target that moves, is hidden, is not where it says, and is landed on; in virtual time."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from agents.follower.guide import PULL, TargetFix
from tests.agents.follower.virtual import DECK, TICK, Place, World
from zmav.wire import Detection, Vector


def eight(t: float) -> tuple[float, float]:
    """A figure of eight, 1 m/s at its fastest, 20 m from where the vehicle is."""
    w = 0.09
    return 20.0 + 8.0 * math.sin(w * t), 4.0 * math.sin(2.0 * w * t)


@pytest.mark.parametrize(("delay", "lost", "most"), [(0.03, 0.0, 0.12), (0.25, 0.1, 0.3)])
def test_it_goes_there_and_stays_above_a_figure_of_eight(delay: float, lost: float, most: float) -> None:
    world = World(eight, delay=delay, lost=lost).run(20.0)
    world.off.clear()
    world.run(120.0)
    assert world.guide.phase == "track"
    assert world.guide.lost == 0
    assert np.mean(world.off) < most
    assert world.pos[2] == pytest.approx(DECK - 5.0, abs=0.1)


def test_weak_sights_begin_a_target_only_after_a_while() -> None:
    world = World(lambda t: (0.0, 0.0))
    world.score = 0.6
    world.run(9.0)
    assert world.phases[-1] == "search"
    world.run(3.0)
    assert world.phases[-1] == "track"
    world.score = 0.4  # what it follows, it follows by any sight
    world.run(5.0)
    assert world.phases[-1] == "track"


def test_what_looks_a_little_like_a_pad_never_takes_its_place() -> None:
    world = World(lambda t: (0.0, 0.0)).run(10.0)
    world.hidden, world.more, world.score = lambda t: True, lambda t: [(1.5, 1.0)], 0.35
    world.run(8.0)
    assert world.phases[-1] in ("approach", "search")


def test_a_target_that_is_lost_is_looked_for_where_it_truly_is() -> None:
    """It says 4.5 m beside that where it is, and that is learnt while it is seen."""
    world = World(lambda t: (0.3 * t, 0.0))
    world.run(2.0)
    world.told_off = (4.0, -2.0)
    world.run(10.0)
    assert world.phases[-1] == "track"
    world.hidden = lambda t: True
    world.run(10.0, lambda world: world.guide.phase == "search")
    assert world.phases[-1] == "search"
    assert world.off[-1] < 1.5


def test_a_lost_target_is_looked_for_where_it_is_although_its_own_place_wanders() -> None:
    """While it coasts and looks for it, the vehicle takes itself to go 4 m east, which it does not."""
    world = World(lambda t: (0.3 * t, 0.0)).run(12.0)
    lost = world.t
    world.hidden = lambda t: True
    world.wander = lambda t: (0.0, min(max(t - lost, 0.0), 4.0))
    world.run(10.0, lambda world: world.guide.phase == "search")
    world.run(2.0)
    assert world.phases[-1] == "search"
    assert world.off[-1] < 1.5


def test_a_target_that_says_nothing_is_looked_for_where_it_was_seen_although_its_own_place_wanders() -> None:
    world = World(lambda t: (0.0, 0.0))
    world.told = False
    world.run(12.0)
    assert world.phases[-1] == "track"
    world.hidden = lambda t: True
    world.run(10.0, lambda world: world.guide.phase == "search")
    lost = world.t
    world.wander = lambda t: (0.0, min(max(t - lost, 0.0), 4.0))
    world.run(4.5)
    assert world.phases[-1] == "search"
    assert world.off[-1] < 2.0


def test_the_way_there_is_no_search() -> None:
    world = World(lambda t: (60.0, 0.0))
    world.hidden, world.more, world.score = lambda t: True, lambda t: [(61.0, 0.0)], 0.4
    world.run(25.0)
    assert world.phases[-1] == "search"
    assert "track" not in world.phases


def test_after_a_hold_a_target_begins_as_ever() -> None:
    world = World(lambda t: (0.0, 0.0))
    world.score = 0.4
    world.run(2.0)
    world.guide.wanted = "hold"
    world.run(1.0)
    world.guide.wanted = "follow"
    world.run(5.0)
    assert "track" not in world.phases


def test_far_off_it_adds_little_to_the_target_s_velocity() -> None:
    world = World(lambda t: (1.8, 0.0))
    world.run(5.0, lambda world: world.guide.phase == "track")
    estimate = world.guide.target(world.t)
    assert estimate is not None
    added = [flown - own for flown, own in zip(world.command.vel[:2], estimate.vel, strict=True)]
    assert 0.9 * PULL < math.hypot(*added) < 1.1 * PULL  # of 1.4 m/s, with which it would fly past


def test_old_pictures_are_made_up_for() -> None:
    """Without the time stamps the vehicle would be behind by the delay times the speed: 0.5 m."""
    straight: Place = lambda t: (1.0 * t, 0.0)  # noqa: E731
    world = World(straight, delay=0.5).run(20.0)
    world.off.clear()
    world.run(20.0)
    assert np.mean(world.off) < 0.15


@pytest.mark.parametrize(("late", "least", "most"), [(0.0, 0.0, 0.08), (0.3, 0.3, 0.5)])
def test_it_leans_against_a_steady_wind_where_it_is_heard_in_time(late: float, least: float, most: float) -> None:
    """By itself the vehicle would be 0.5 / 1.2 m off. A loop closed 0.3 s late would swing: it is left open."""
    world = World(lambda t: (0.0, 0.0))
    world.push, world.late, world.tuned["lead"] = 0.5, late, 0.0
    world.run(20.0)
    world.off.clear()
    world.run(20.0)
    assert least <= np.mean(world.off) < most


def test_a_bridge_is_flown_over_by_prediction_and_what_was_lost_is_found_again() -> None:
    world = World(lambda t: (0.8 * t, 0.0)).run(10.0)
    world.hidden = lambda t: 10.0 < t < 12.0
    world.run(6.0)
    assert world.phases[-3:] == ["track", "coast", "track"]
    assert (world.guide.lost, max(world.off[-80:]) < 0.6) == (0, True)
    world.hidden = lambda t: 16.0 < t < 26.0
    world.run(9.5)
    assert world.phases[-1] in ("approach", "search")
    world.run(20.0)
    assert world.phases[-1] == "track"
    assert world.guide.lost == 1
    assert np.mean(world.off[-100:]) < 0.15


def test_what_was_lost_is_not_looked_for_at_the_speed_that_lost_it() -> None:
    world = World(lambda t: (0.0, 0.0)).run(10.0)
    world.hidden, begun = (lambda t: True), world.t
    world.more = lambda t: [(5.0 * (t - begun), 0.0)]  # what is seen runs away at 5 m/s
    world.run(0.6)
    world.more = lambda t: []
    world.run(10.0, until=lambda world: world.guide.phase == "approach")
    assert world.guide.lost == 1
    assert world.guide.tracker.at(world.t) is None
    world.hidden = lambda t: False
    world.run(20.0, until=lambda world: world.guide.phase == "track")
    estimate = world.guide.tracker.at(world.t)
    assert estimate is not None
    assert math.hypot(*map(float, estimate.vel)) < 0.2


@pytest.mark.parametrize(
    ("vel", "age", "expected"),
    [((2.0, 0.0, 0.0), 0.3, 2.0), ((2.0, 0.0, 0.0), 3.0, 0.0), ((20.0, 0.0, 0.0), 0.3, 0.0), (None, 0.3, 0.0)],
)
def test_it_begins_with_the_speed_that_the_target_says_if_that_is_fresh_and_possible(
    vel: Vector | None, age: float, expected: float
) -> None:
    world = World(lambda t: (0.0, 0.0))
    told = TargetFix(100.0 - age, (0.0, 0.0, 0.0), vel)
    (pad,) = world.picture()
    for since, believed in ((0.0, False), (0.1, True)):  # one alone may be anything
        seen = msgspec.structs.replace(pad, pos=(expected * since, 0.0, DECK))
        assert world.guide.see(100.3, 100.0 + since, [seen], (0.0, 0.0, -5.3), told, 0.3) is believed
    estimate = world.guide.tracker.at(100.1)
    assert estimate is not None
    assert float(estimate.vel[0]) == pytest.approx(expected, abs=1e-9)


def test_a_single_sight_moves_nobody() -> None:
    """On the way there something on the ground is taken for the pad, in one picture."""
    world = World(lambda t: (16.0, 0.0))
    world.hidden = lambda t: world.pos[0] < 14.0
    world.more = lambda t: [(world.me[0] + 1.5, 1.0)] if 2.05 < t < 2.15 else []
    world.run(20.0, until=lambda world: world.guide.phase == "track")
    assert world.phases == ["approach", "track"]
    assert world.pos[0] > 13.0
    assert world.guide.lost == 0


def test_a_search_widens_and_rises_within_its_bounds() -> None:
    world = World(lambda t: (0.0, 0.0))
    world.hidden = lambda t: True
    world.run(5.0, lambda world: world.guide.phase == "search")
    track = np.array([world.run(TICK).command.pos for _ in range(2400)])
    radius = np.hypot(track[:, 0] - world.told_off[0], track[:, 1] - world.told_off[1])
    assert world.phases == ["approach", "search"]
    assert 11.0 < radius.max() < 12.5
    assert DECK - track[:, 2].min() == pytest.approx(10.0, abs=0.1)
    assert np.median(np.hypot(*np.diff(track[:, :2], axis=0).T)) / TICK < 1.6
    # Every place within the radius was in view: the spiral's turns overlap.
    assert np.diff(np.sort(np.unique(radius.round(2)))).max() < 0.5


def test_without_a_word_of_the_target_any_pad_is_followed() -> None:
    world = World(lambda t: (2.5, 1.0))
    world.told = False
    world.run(60.0, lambda world: world.guide.phase == "track").run(10.0)
    assert world.off[-1] < 0.1


def test_of_two_pads_the_one_that_moves_as_the_target_does_is_followed() -> None:
    world = World(lambda t: (1.0 * t, 0.0))
    world.more = lambda t: [(1.0 * t, 9.0), (12.0, 0.3)]  # one beside it all the way, and one that lies on the way
    world.run(25.0)
    assert world.guide.phase == "track"
    assert np.mean(world.off[-200:]) < 0.2
    # One that is no pad of ours at all, far from where the target says that it is.
    world = World(lambda t: (0.0, 0.0))
    world.hidden = lambda t: True
    world.told_off = (20.0, 0.0)
    world.more = lambda t: [(1.0, 0.0)]
    world.run(3.0)
    assert world.guide.phase in ("approach", "search")


def test_a_jump_of_its_own_place_moves_it_nowhere() -> None:
    world = World(lambda t: (0.5 * t, 0.0)).run(20.0)
    world.wander = lambda t: (0.0, 3.0)
    world.off.clear()
    world.run(10.0)
    assert (world.phases[-1], world.guide.lost) == ("track", 0)
    assert max(world.off) < 0.3


def test_hold_stays_where_it_was_told_and_goes_on_when_asked() -> None:
    world = World(lambda t: (1.0 * t, 0.0)).run(10.0)
    world.guide.wanted = "hold"
    world.run(1.0)
    here = world.command.pos
    world.run(5.0)
    assert (world.command.pos, world.command.vel) == (here, (0.0, 0.0, 0.0))
    world.guide.wanted = "follow"
    world.run(25.0)
    assert world.guide.phase == "track"
    assert world.off[-1] < 0.3


def test_what_it_flies_faster_than_the_target_is_taken_from_the_velocity() -> None:
    world = World(lambda t: (0.0, 0.0)).run(15.0)
    before = world.command.vel[1]
    for _ in range(3):  # until it has heard that of itself
        world.vel[1] = 0.5
        world.step()
    assert before - world.command.vel[1] > 0.8 * 0.5 * world.tuned["damp"]


def test_beside_a_target_that_is_faster_than_it_may_fly_it_is_not_pulled_to_its_speed() -> None:
    """``damp`` is of how much slower it is than what it may fly, not than the target."""
    world = World(lambda t: (1.5 * t, 0.0)).run(25.0)
    assert world.phases[-1] == "track"
    world.tuned["speed"], world.tuned["stiff"], world.tuned["trim"] = 0.5, 0.0, 0.0
    world.run(0.6)
    assert world.phases[-1] == "track"
    assert world.vel[0] > 0.5
    assert world.command.vel[0] <= 0.5


def test_sights_of_the_future_of_another_place_or_nonsense_change_nothing() -> None:
    world = World(lambda t: (0.0, 0.0)).run(10.0)
    seen, now = world.guide.tracker.t, world.t

    def see(t: float, pos: Vector) -> bool:
        pad = Detection(symbol="H", u=0.0, v=0.0, scale_px=20.0, heading=0.0, score=0.9, pos=pos)
        return world.guide.see(now, t, [pad], world.me, world.word(), 0.3)

    for t, pos in (
        (now + 3600.0, (0.0, 0.0, DECK)),
        (1e200, (0.0, 0.0, DECK)),
        (now - 60.0, (0.0, 0.0, DECK)),
        (now, (1e6, 0.0, DECK)),
        (now, (math.nan, 0.0, DECK)),
        (now, (9.0, 9.0, DECK)),
    ):
        assert not see(t, pos)
    assert world.guide.tracker.t == seen
    world.run(2.0)
    assert world.phases[-1] == "track"


def test_a_clock_that_is_set_back_is_survived() -> None:
    world = World(lambda t: (0.0, 0.0)).run(10.0)
    world.t -= 60.0
    world.due.clear()
    world.run(5.0)
    assert world.phases[-1] == "track"
    world.hidden = lambda t: True
    world.run(30.0)
    assert world.phases[-1] == "search"
    world.t -= 60.0
    world.run(2.0)
    assert world.command.pos[2] < DECK - 4.0, "never below what was asked for"


@pytest.mark.parametrize("wrong", [-0.6, 1.5])
def test_a_height_that_was_told_wrong_is_made_up_for_by_what_is_seen(wrong: float) -> None:
    """The deck's height was forgotten: the sights say how far down the pad is."""
    world = World(lambda t: (0.0, 0.0))
    world.plane = DECK + wrong
    world.run(15.0)
    assert DECK - world.pos[2] == pytest.approx(5.0, abs=0.2)
    world.guide.land()
    world.run(60.0, lambda world: world.command.land)
    assert world.command.land
    assert 0.0 < DECK - world.pos[2] < 0.6


def test_a_search_ends() -> None:
    world = World(lambda t: (0.0, 0.0))
    world.hidden = lambda t: True
    world.tuned["search_seconds"] = 20.0
    world.run(40.0)
    assert world.phases == ["approach", "search", "hold"]
    assert world.guide.wanted == "hold"
