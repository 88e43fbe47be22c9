"""The world as told: what is forgotten when, how it looks to the solver, and what goals speak for."""

from __future__ import annotations

import itertools
import math
from typing import cast

import msgspec
import numpy as np
import pytest

from agents.planner.cli.asking import Planner, match_names
from agents.planner.goals.steps import VehicleView
from agents.planner.live import frames
from agents.planner.live.checks import MOST_OBSTACLES
from agents.planner.live.fleet import HeardVehicle
from agents.planner.live.reserved import ReservedAirspace, Tube, meet, tube
from agents.planner.live.scenes import DEPTH, room_of, scene_of
from agents.planner.live.settings import PlannerSettings, fence_of
from agents.planner.live.world import LATE, Pieces, World
from agents.planner.model import scene
from zmav import Client, wire
from zmav.config import FleetConfig, Geofence, body_of
from zmav.errors import BadConfig, BadInput
from zmav.wire import swarm

BOX = swarm.Box(low=(0.0, 10.0, 0.0), high=(5.0, 20.0, -30.0))


def told(name: str, what: object, t: float = 0.0, ttl: float | None = None) -> swarm.Obstacle:
    return swarm.Obstacle(name=name, t=t, what=what, ttl=ttl)  # type: ignore[arg-type]


# Frames.


def test_frames_are_each_other_s_inverse() -> None:
    rng = np.random.default_rng(3)
    points = rng.normal(size=(20, 3))
    assert np.array_equal(frames.enu_array(frames.enu_array(points)), points)
    assert frames.enu((1.0, 2.0, 3.0)) == (2.0, 1.0, -3.0)
    assert frames.ned((2.0, 1.0, -3.0)) == (1.0, 2.0, 3.0)
    for heading, course in ((0.0, math.pi / 2), (math.pi / 2, 0.0), (math.pi, -math.pi / 2)):
        assert frames.course_of(heading) == pytest.approx(course)
        assert frames.course_of(course) == pytest.approx(math.remainder(heading, math.tau))


# What is told.


def test_news_are_told_from_what_is_said_again() -> None:
    world = World()
    assert world.give(told("a", BOX), 0.0)
    assert not world.give(told("a", BOX, t=1.0), 1.0)
    assert world.revision == 1
    assert not world.give(told("a", None, t=0.5), 1.0), "overtaken on the way"
    assert world.give(told("a", None, t=2.0), 2.0)
    assert not world.give(told("a", None, t=3.0), 3.0)
    assert world.obstacles == []


def test_what_is_not_said_again_is_forgotten() -> None:
    world = World()
    world.give(told("a", BOX, ttl=2.0), 10.0)
    world.give(told("b", BOX), 10.0)
    world.expire(11.9)
    world.give(told("a", BOX, t=1.0, ttl=2.0), 11.0)
    world.expire(12.5)
    assert [each.name for each in world.obstacles] == ["a", "b"]
    world.expire(13.0)
    assert [each.name for each in world.obstacles] == ["b"]


def test_what_is_gone_does_not_come_back_by_a_late_word() -> None:
    """Networks hold messages back for half a minute, and give some twice."""
    world, late = World(), told("a", BOX, t=1.0)
    world.give(told("a", BOX, t=2.0), 2.0)
    assert world.give(told("a", None, t=3.0), 3.0)
    assert not world.give(late, 4.0)
    assert world.obstacles == []
    assert not world.give(told("b", None, t=3.0), 3.0), "it overtakes the one that it takes away"
    assert not world.give(told("b", BOX, t=2.0), 4.0)
    world.give(told("c", BOX, t=3.0, ttl=2.0), 3.0)
    world.expire(5.0)
    assert not world.give(told("c", BOX, t=2.0, ttl=2.0), 5.5)
    assert world.give(told("c", BOX, t=3.0, ttl=2.0), 5.5), "a program says again what it said: it stands there still"
    world.expire(7.5)
    square = [(0.0, 0.0), (50.0, 0.0), (50.0, 40.0)]
    old = told("old", swarm.Geofence(polygon=square, floor=0.0, ceiling=20.0), t=1.0)
    world.give(old, 6.0)
    world.give(told("new", swarm.Geofence(polygon=square, floor=1.0, ceiling=30.0), t=6.0), 6.5)
    assert not world.give(old, 7.0)
    assert [each.name for each in world.obstacles] == ["new"]
    assert world.give(told("a", BOX, t=3.5), 8.0), "who puts it again means it"
    world.expire(4.0 + LATE)
    assert world.give(told("b", BOX, t=2.0), 4.0 + LATE), "its clock was set back: nothing is late for so long"


def test_a_late_word_brings_no_fence_back_that_was_replaced() -> None:
    square = [(0.0, 0.0), (50.0, 0.0), (50.0, 40.0)]
    own = told("fleet-file", swarm.Geofence(polygon=square, floor=0.0, ceiling=20.0))

    def fence(name: str, t: float) -> swarm.Obstacle:
        return told(name, swarm.Geofence(polygon=square, floor=0.0, ceiling=t), t=t)

    world = World()
    world.fence = own
    world.give(own, 0.0)
    assert world.give(fence("a", 100.0), 1.0)
    assert world.give(fence("b", 110.0), 2.0)
    assert not world.give(fence("a", 105.0), 3.0), "it was on its way when the other was given"
    assert not world.give(fence("c", 90.0), 3.0), "never heard before, and older than the one that holds"
    assert world.obstacles == [fence("b", 110.0)]
    assert world.give(told("b", None, t=120.0), 4.0)
    assert not world.give(fence("a", 105.0), 5.0)
    assert world.obstacles == [own]
    assert world.give(fence("c", 90.0), 6.0), "the fleet file's is older than any"
    assert world.give(fence("d", 90.0 - LATE), 7.0), "its clock was set back: nothing is late for so long"


def test_of_what_is_gone_no_more_is_remembered_than_of_what_is_there() -> None:
    world = World()
    world.give(told("first", None, t=9.0), 0.0)
    for number in range(MOST_OBSTACLES):
        world.give(told(f"b{number}", None, t=9.0), 0.0)
    assert world.give(told("first", BOX, t=1.0), 0.0)


def test_there_is_one_fence() -> None:
    world = World()
    square = [(0.0, 0.0), (50.0, 0.0), (50.0, 40.0)]
    world.give(told("old", swarm.Geofence(polygon=square, floor=0.0, ceiling=20.0)), 0.0)
    world.give(told("new", swarm.Geofence(polygon=square, floor=1.0, ceiling=30.0)), 0.0)
    pieces = world.pieces(0.0)
    assert pieces.geofence == scene.Fence(polygon=[(0.0, 0.0), (0.0, 50.0), (40.0, 50.0)], floor=1.0, ceiling=30.0)
    assert pieces.obstacles == ()


def test_obstacles_stand_where_they_were_told_to() -> None:
    world = World()
    world.give(told("box", BOX), 0.0)
    world.give(told("mast", swarm.Cylinder(center=(1.0, 2.0), radius=3.0, floor=0.0, ceiling=9.0)), 0.0)
    world.give(told("stone", swarm.Ball(center=(4.0, 5.0, -6.0), radius=1.0)), 0.0)
    world.give(told("bird", swarm.Ball(center=(0.0, 0.0, -10.0), radius=1.0, velocity=(1.0, 0.0, -2.0)), t=100.0), 0.0)
    pieces = world.pieces(103.0)
    assert pieces.obstacles == (
        scene.Box(min=(10.0, 0.0, 0.0), max=(20.0, 5.0, 30.0), name="box"),
        scene.Cylinder(center=(2.0, 1.0), radius=3.0, floor=0.0, ceiling=9.0, name="mast"),
        scene.Cylinder(center=(5.0, 4.0), radius=1.0, floor=5.0, ceiling=7.0, name="stone"),
    )
    (bird,) = pieces.movers
    assert bird.motion[0].tolist() == [0.0, 0.0, 3.0, 16.0]
    assert (bird.motion[1] - bird.motion[0])[1:] == pytest.approx([0.0, bird.motion[1, 0], 2.0 * bird.motion[1, 0]])
    assert world.ball("bird", 101.0) == ((1.0, 0.0, -12.0), (1.0, 0.0, -2.0))
    assert world.ball("mast", 101.0) is None


def test_a_standby_knows_what_the_chief_knows() -> None:
    chief, other = World(), World()
    for name in "abc":
        chief.give(told(name, BOX, t=50.0, ttl=5.0 if name == "c" else None), 0.0)
    other.give(told("gone", BOX), 0.0)
    other.follow(chief.obstacles, now=7.0, t=52.0)
    assert other.obstacles == chief.obstacles
    other.expire(9.9)
    assert other.find("c") is not None
    other.expire(10.0)
    assert other.find("c") is None


def test_what_its_leader_forgot_comes_back_to_a_standby_by_no_older_word() -> None:
    other = World()
    other.give(told("gone", BOX, t=50.0), 0.0)
    other.follow([], now=7.0, t=52.0)
    assert not other.give(told("gone", BOX, t=49.0), 8.0)
    assert other.obstacles == []
    assert other.give(told("gone", BOX, t=50.0), 8.0), "perhaps it was only not said again in time: then it is now"


def test_too_many_obstacles_are_refused() -> None:
    world = World()
    world.give(told("a", BOX), 0.0)
    for number in range(MOST_OBSTACLES - 1):
        world.give(told(f"b{number}", BOX), 0.0)
    with pytest.raises(BadInput, match="room"):
        world.give(told("c", BOX), 0.0)
    assert world.give(told("a", None, t=1.0), 0.0)


def test_the_fleet_file_s_fence_holds_again_when_another_is_gone() -> None:
    square = [(0.0, 0.0), (50.0, 0.0), (50.0, 40.0)]
    own = told("fleet-file", swarm.Geofence(polygon=square, floor=0.0, ceiling=20.0))
    world = World()
    world.fence = own
    world.give(own, 0.0)
    other = swarm.Geofence(polygon=square, floor=1.0, ceiling=30.0)
    for number, end in enumerate((told("field", None, t=9.0), told("field", BOX, t=9.0), None)):
        name = f"field{number}"
        world.give(told(name, other, ttl=5.0), 0.0)
        assert [each.what for each in world.obstacles] == [other] or number == 2
        if end is not None:
            world.give(msgspec.structs.replace(end, name=name), 1.0)
        else:
            world.expire(6.0)
        assert own in world.obstacles
        world.give(told(name, None, t=10.0), 7.0)
    world.give(told("field", other), 8.0)
    world.follow([told("field", other)], 9.0, 9.0)
    world.follow([told("leaders", other)], 9.0, 9.0)
    assert [each.name for each in world.obstacles] == ["leaders"], "a standby knows what its leader knows, and no more"
    world.give(told("fleet-file", other, t=1.0, ttl=5.0), 10.0)
    world.expire(16.0)
    assert world.obstacles == [own], "another one under its name is forgotten as any other"
    world.give(told("fleet-file", other, t=1.5), 17.0)
    world.give(told("fleet-file", None, t=2.0), 18.0)
    assert world.obstacles == [], "who takes it away by its name means it"


def test_the_fleet_file_s_fence_is_the_planner_s() -> None:
    origin = wire.Origin(lat_deg=50.0, lon_deg=8.0, alt_amsl=100.0)
    corners = [(50.001, 8.0), (50.0, 8.001), (49.999, 8.0)]
    fence = fence_of(FleetConfig(origin=origin, geofence=Geofence(polygon=corners, ceiling=60.0)))
    assert fence is not None
    assert fence.ceiling == 60.0
    assert fence.polygon[0] == pytest.approx((111.2, 0.0), abs=0.5)
    round_one = fence_of(FleetConfig(origin=origin, geofence=Geofence(radius=80.0)))
    assert round_one is not None
    assert {round(math.hypot(*corner), 6) for corner in round_one.polygon} == {80.0}
    assert fence_of(FleetConfig(origin=origin)) is None
    assert fence_of(FleetConfig(geofence=Geofence(radius=80.0))) is None


@pytest.mark.parametrize(
    ("field", "value"),
    [("margin", -1.0), ("margin", math.nan), ("tracking", math.nan), ("downwash", 0.5), ("patience", 0.0)],
)
def test_settings_that_cannot_be_are_named(field: str, value: float) -> None:
    with pytest.raises(BadConfig, match=field):
        msgspec.structs.replace(PlannerSettings(), **{field: value})


# A scene of what is.


def seen(name: str, pos: tuple[float, float, float], *, age: float = 0.0, kind: str = "copter") -> HeardVehicle:
    flies = kind not in ("rover",)
    view = VehicleView(name=name, kind=kind, body=body_of(kind), pos_ned=pos, airborne=flies)
    return HeardVehicle(view, age, wire.VehicleState(t=0.0, fleet="f", name=name, instance="i"))


def test_a_scene_has_everybody_in_it() -> None:
    fleet = [
        seen("a", (0.0, 0.0, -10.0)),
        seen("b", (9.0, 0.0, -10.0)),
        seen("c", (0.0, 9.0, -12.0), age=60.0),
        seen("r", (5.0, 5.0, 0.0), kind="rover"),
        seen("t", (50.0, 5.0, -5.0)),
    ]
    wall = scene.Box(min=(1.0, 1.0, 1.0), max=(2.0, 2.0, 2.0))
    room = room_of(["a", "r"], fleet, Pieces(), [wall], {"t"}, 1.5, None)
    assert [mover.id for mover in room.movers] == ["b"]
    lost = scene.Cylinder(center=(9.0, 0.0), radius=1.0, floor=12.0 - DEPTH, ceiling=13.5)
    assert [msgspec.structs.replace(each, name="") for each in room.obstacles] == [wall, lost]
    assert "not heard" in room.obstacles[1].name
    made = scene_of([fleet[0].view, fleet[3].view], np.array([[0.0, 30.0, 15.0], [20.0, 5.0, 7.0]]), True, room)
    assert [(v.id, v.type, v.start, v.goal) for v in made.vehicles] == [
        ("a", "copter", (0.0, 0.0, 10.0), (0.0, 30.0, 15.0)),
        ("r", "rover", (5.0, 5.0, -0.0), (20.0, 5.0, -0.0)),
    ]
    low, high = made.bounds.min, made.bounds.max
    assert low[2] <= 0.0 < 15.0 < high[2]
    for v in made.vehicles:
        assert all(lo < p < hi for lo, p, hi in zip(low[:2], v.start[:2], high[:2], strict=True))


# Room that is spoken for.


def test_a_tube_holds_its_way() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        way = np.cumsum(rng.normal(scale=6.0, size=(12, 3)), axis=0)
        held = tube(way, 1.0)
        for one, other in itertools.pairwise(way):
            for share in np.linspace(0.0, 1.0, 15):
                p = one + (other - one) * share
                assert np.any(np.all((held.boxes[:, :3] <= p + 1e-9) & (p - 1e-9 <= held.boxes[:, 3:]), axis=1))
        assert np.max(held.boxes[:, 3:] - held.boxes[:, :3]) <= 2.5 + 1e-9


def test_tubes_meet_where_vehicles_might() -> None:
    one = Tube(np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 20.0]]), 1.0)
    assert meet(one, tube(np.array([[1.9, 0.0, 10.0]]), 1.0), 1.5)
    assert not meet(one, tube(np.array([[2.1, 0.0, 10.0]]), 1.0), 1.5)
    assert meet(one, tube(np.array([[0.0, 0.0, 22.9]]), 1.0), 1.5)
    assert not meet(one, tube(np.array([[0.0, 0.0, 23.1]]), 1.0), 1.5)


def test_a_goal_keeps_out_of_what_others_speak_for_and_not_of_its_own() -> None:
    tubes = ReservedAirspace()
    one, other = tube(np.array([[0.0, 0.0, 10.0]]), 1.0), tube(np.array([[30.0, 0.0, 10.0]]), 1.0)
    tubes.hold("g1", {"a": [one]})
    tubes.hold("g2", {"b": [other]})
    assert tubes.vehicles({"g1"}) == {"b"}
    wall = scene.Box(min=(29.0, -1.0, 8.5), max=(31.0, 1.0, 11.5), name="the way of b in g2")
    assert tubes.walls({"g1"}, 1.5) == [wall]
    near: Tube = tube(np.array([[28.5, 0.0, 10.0]]), 1.0)
    assert tubes.blocker({"g1"}, {"a": [near]}, 1.5) == "g2"
    assert tubes.blocker({"g2"}, {"b": [near]}, 1.5) == ""
    tubes.drop("g2")
    assert tubes.blocker({"g1"}, {"a": [near]}, 1.5) == ""


def test_names_are_matched_as_people_mean_them() -> None:
    names = ["quad1", "quad2", "rover1"]
    assert match_names(["quad*", "quad1"], names) == ["quad1", "quad2"]
    assert match_names(["all"], names) == names
    assert match_names(["rover1", "nobody"], names) == ["rover1", "nobody"]
    assert match_names(["plane*"], names) == []


def test_a_place_of_its_own_is_given_to_one_vehicle() -> None:
    """'goto quad*=A quad1=B' would have sent quad1 to A and quad2 to B."""
    planner = Planner(cast(Client, None), {"planner": "ground", "vehicles": ["quad1", "quad2", "rover1"]})
    assert planner.one_each(["quad2", "rover*"]) == ["quad2", "rover1"]
    for patterns in (["quad*", "quad1"], ["quad1", "quad?"], ["quad2", "quad2"], ["all"]):
        with pytest.raises(BadInput, match="give each vehicle one place"):
            planner.one_each(patterns)
    for patterns in (["quad2", "quad2"], ["rover1", "rover*"]):
        with pytest.raises(BadInput, match=f"{patterns[0]} has two places"):
            planner.one_each(patterns)
