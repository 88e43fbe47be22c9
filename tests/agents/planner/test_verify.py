"""The verifier and the tests' own checker, side by side: both pass what is good and object to whatever was spoilt."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from agents.planner.model.problem import MovingObstacle
from agents.planner.model.scene import Bounds, Scene, Vehicle
from agents.planner.model.separation import all_pairs, separation
from agents.planner.model.verify import Report, verify
from tests.agents.planner import checker
from tests.agents.planner.flights import straight, straight_plan
from tests.agents.planner.generate import CLASSES, as_json

Array = NDArray[np.float64]
SCENE: dict[str, Any] = {
    "format": "swarm-scene/1",
    "vehicles": [
        {
            "id": "a",
            "type": "copter",
            "radius": 1.0,
            "vmax": 5.0,
            "amax": 2.5,
            "start": [-20, 0, 10],
            "goal": [20, 0, 10],
            "vz_up": 2.5,
            "vz_down": 1.5,
        },
        {
            "id": "b",
            "type": "copter",
            "radius": 1.0,
            "vmax": 5.0,
            "amax": 2.5,
            "start": [-20, 3, 10],
            "goal": [20, 3, 10],
            "vz_up": 2.5,
            "vz_down": 1.5,
        },
        {"id": "r", "type": "rover", "radius": 0.7, "vmax": 3.0, "amax": 1.5, "start": [-20, 0, 0], "goal": [20, 0, 0]},
        {
            "id": "p",
            "type": "plane",
            "radius": 3.0,
            "vmax": 22.0,
            "amax": 5.0,
            "vmin": 12.0,
            "start": [-90, 0, 40],
            "goal": [60, 0, 40],
            "start_heading_deg": 0.0,
            "vz_up": 3.0,
            "vz_down": 3.0,
        },
    ],
    "assignment": "labelled",
    "obstacles": [
        {"type": "box", "min": [-5, -6, 5], "max": [5, -2, 15]},
        {"type": "cylinder", "center": [0, 8], "radius": 2.0, "floor": 0.0, "ceiling": 20.0},
        {
            "type": "no_fly",
            "polygon": [[10, -9], [18, -9], [14, -5], [18, -1.5], [10, -1.5]],
            "floor": 2,
            "ceiling": 30,
        },
    ],
    "bounds": {"min": [-100, -50, 0], "max": [100, 50, 60]},
    "geofence": {
        "polygon": [[-95, -20], [95, -20], [95, 20], [0, 20], [0, 10], [-8, 10], [-8, 20], [-95, 20]],
        "floor": 0.0,
        "ceiling": 50.0,
    },
    "downwash": 1.5,
    "goal_tolerance": 0.5,
    "time_limit": 20.0,
}


def judged(scene: dict[str, Any], plan: dict[str, Any]) -> tuple[Report, set[tuple[str, str]], set[tuple[str, str]]]:
    """The verifier's report, and what either finds as (kind, id)."""
    report = verify(msgspec.convert(scene, Scene), plan["trajectories"], written=True)
    return report, {(f.kind, name) for f in report.faults for name in f.ids}, checker.check(scene, plan)


@pytest.fixture
def plan() -> dict[str, Any]:
    return straight_plan(msgspec.convert(SCENE, Scene))


def test_a_good_plan_is_passed_by_both(plan: dict[str, Any]) -> None:
    report, ours, theirs = judged(SCENE, plan)
    assert (ours, theirs) == (set(), set())
    assert report.makespan == pytest.approx(40.0 / 3.0 + 2.0, abs=1e-5)
    assert report.closest is not None
    assert set(report.closest.ids) == {"a", "b"}
    assert report.clearance == pytest.approx(1.0)
    assert report.obstacle_clearance == pytest.approx(0.5)  # a and the zone's side at y = -1.5


def moved(**by: float) -> Callable[[Array], Array]:
    """A bump on the way that begins and ends gently, 1 at its top."""

    def change(track: Array) -> Array:
        t = track[:, 0] / track[-1, 0]
        bump = np.clip(np.sin(math.pi * np.clip((t - 0.1) / 0.8, 0.0, 1.0)), 0.0, 1.0) ** 2
        for axis, size in by.items():
            track[:, "txyz".index(axis)] += size * bump
        return track

    return change


def shifted(track: Array, **by: float) -> Array:
    return np.asarray(track + np.array([by.get(axis, 0.0) for axis in "txyz"]))


def one_sample(k: int, axis: int, by: float) -> Callable[[Array], Array]:
    def change(track: Array) -> Array:
        track[k, axis] += by
        return track

    return change


def faster(share: float) -> Callable[[Array], Array]:
    def change(track: Array) -> Array:
        track[:, 0] /= share
        return track

    return change


def held(track: Array) -> Array:
    """Stands still for a while in full flight."""
    half = len(track) // 2
    track[half:, 0] += 2.0
    return track


def sparse(track: Array) -> Array:
    return np.asarray(np.delete(track, len(track) // 2 + np.arange(3), axis=0))


def late(track: Array) -> Array:
    track[1:, 0] += 15.0
    return track


def sharp_turn(track: Array) -> Array:
    """Sideways from one sample to the next, and back as suddenly later."""
    third = len(track) // 3
    side = np.interp(np.arange(len(track)), [third, third + 5, 2 * third, 2 * third + 5], [0.0, 0.5, 0.5, 0.0])
    track[:, 2] += side
    return track


SPOILT: dict[str, tuple[str, Callable[[Array], Array], str]] = {
    "teleports": ("a", one_sample(40, 1, 2.0), "speed"),
    "shakes": ("a", one_sample(40, 2, 0.05), "acceleration"),
    "too fast": ("a", faster(1.05), "speed"),
    "speeds up too hard": ("r", faster(1.1), "acceleration"),
    "does not come from rest": ("a", lambda track: straight((-19.0, 0.0, 10.0), (20.0, 0.0, 10.0), 5.0, 2.5), "start"),
    "cuts off its end": ("a", lambda track: track[:-8], "goal"),
    "ends in flight": ("a", lambda track: track[:-3], "acceleration"),
    "begins in flight": ("a", lambda track: np.vstack(([0, -20, 0, 10], track[8:] - [track[7, 0], 0, 0, 0])), "speed"),
    "begins late": ("a", lambda track: shifted(track, t=0.5), "start"),
    "stops dead": ("a", held, "acceleration"),
    "has too few samples": ("a", sparse, "sampling"),
    "takes too long": ("a", late, "late"),
    "goes back in time": ("a", one_sample(40, 0, -5.0), "samples"),
    "is nowhere": ("a", one_sample(40, 2, math.nan), "samples"),
    "ends elsewhere": ("a", lambda track: straight((-20.0, 0.0, 10.0), (20.0, 0.6, 10.0), 5.0, 2.5), "goal"),
    "turns at once": ("a", sharp_turn, "acceleration"),
    "comes too near to another": ("a", moved(y=1.1), "separation"),
    "flies over another": ("b", moved(y=-3.0, z=2.9), "separation"),
    "touches the box": ("a", moved(y=-1.1), "obstacle"),
    "touches the zone": ("a", moved(y=-1.2), "obstacle"),
    "touches the cylinder": ("b", moved(y=2.3), "obstacle"),
    "leaves the ground": ("r", moved(z=0.05), "height"),
    "leaves the bounds": ("p", moved(z=21.0), "bounds"),
    "climbs too fast": ("p", moved(z=9.0), "climb"),
    "flies over the fence": ("p", moved(z=10.5), "fence"),
    "descends too fast": ("p", moved(z=-9.0), "descent"),
    "has a plane at walking speed": ("p", faster(0.5), "slow"),
    "has a plane on another heading": ("p", lambda track: one_sample(0, 2, 0.0)(track) + turned(track), "heading"),
    "writes too much": ("a", one_sample(40, 1, 1e-8), "decimals"),
}


def turned(track: Array) -> Array:
    """A swerve in the first second."""
    side = np.zeros_like(track)
    side[1:, 2] = 0.3
    return side


@pytest.mark.parametrize("how", SPOILT)
def test_both_object_to_a_plan_that(how: str, plan: dict[str, Any]) -> None:
    name, change, kind = SPOILT[how]
    track = change(np.array(plan["trajectories"][name]))
    plan["trajectories"][name] = (track if how == "writes too much" else np.round(track, 6)).tolist()
    report, ours, theirs = judged(SCENE, plan)
    assert not report.ok
    assert (kind, name) in ours
    assert (kind, name) in theirs
    assert all(fault.text and name in fault.ids for fault in report.faults)


def test_both_object_to_vehicles_that_are_missing_or_unknown(plan: dict[str, Any]) -> None:
    plan["trajectories"]["x"] = plan["trajectories"].pop("b")
    _, ours, theirs = judged(SCENE, plan)
    assert ours == theirs == {("missing", "b"), ("unknown", "x")}


def test_a_corner_is_not_cut_between_two_samples_inside(plan: dict[str, Any]) -> None:
    """The fence's notch is 8 m wide at y = 10: a vehicle whose samples are all inside passes through it."""
    scene = copy.deepcopy(SCENE)
    scene["vehicles"] = [{**SCENE["vehicles"][0], "vmax": 100.0, "amax": 5000.0, "goal": [20, 9.9, 10]}]
    scene["obstacles"] = []
    way = [[0.0, -20, 0, 10], [0.2, -8.1, 9.9, 10], [0.4, 0.1, 10.1, 10], [0.6, 20, 9.9, 10]]
    _, ours, theirs = judged(scene, {"trajectories": {"a": way}})
    assert ours == theirs == {("fence", "a")}
    way[2][2] = 9.9
    assert judged(scene, {"trajectories": {"a": way}})[1:] == (set(), set())


def test_who_has_arrived_is_still_there_and_a_plane_is_not() -> None:
    scene = copy.deepcopy(SCENE)
    scene["obstacles"], scene["geofence"] = [], None
    scene["vehicles"] = [scene["vehicles"][0], scene["vehicles"][3]]
    scene["vehicles"][0] |= {"start": [-20, 0, 40], "goal": [-8, 0, 40]}
    scene["vehicles"][1] |= {"start": [-90, 0, 40], "goal": [-25, 0, 40]}
    plan = straight_plan(msgspec.convert(scene, Scene))
    assert judged(scene, plan)[1:] == (set(), set())  # 5 m from it, and gone
    scene["vehicles"][1]["goal"] = [60, 0, 40]
    plan = straight_plan(msgspec.convert(scene, Scene))
    _, ours, theirs = judged(scene, plan)
    assert ours == theirs == {("separation", "a"), ("separation", "p")}


def test_unlabelled_goals_are_each_reached_once() -> None:
    scene = as_json(CLASSES["formation"](12, 3))
    plan = straight_plan(msgspec.convert(scene, Scene))
    report, ours, theirs = judged(scene, plan)
    assert "goal" not in {kind for kind, _ in ours | theirs}
    assert report.goals == {f"v{k:03d}": k for k in range(12)}
    plan["trajectories"]["v001"] = plan["trajectories"]["v000"]
    _, ours, theirs = judged(scene, plan)
    assert len({name for kind, name in ours if kind == "goal"}) == 1
    assert len({name for kind, name in theirs if kind == "goal"}) == 1
    report = verify(msgspec.convert(scene, Scene), {})
    assert {fault.kind for fault in report.faults} == {"missing"}


def test_goals_that_all_can_reach_are_dealt_out_whatever_their_number() -> None:
    places = [(3.0 * k, 0.0, 0.0) for k in range(1100)]  # more than Python nests calls
    vehicles = [
        Vehicle(id=f"v{k}", type="copter", start=p, radius=1.0, vmax=5.0, amax=2.0) for k, p in enumerate(places)
    ]
    bounds = Bounds(min=(-1.0, -1.0, -1.0), max=(5000.0, 1.0, 1.0))
    scene = Scene(vehicles=vehicles, bounds=bounds, assignment="unlabelled", goals=places, goal_tolerance=5000.0)
    report = verify(scene, {v.id: [[0.0, *v.start]] for v in vehicles})
    assert report.ok
    assert sorted(report.goals.values()) == list(range(1100))


@pytest.mark.parametrize(("kind", "n"), [("city", 12), ("forest", 24), ("fence_u", 15), ("mixed", 12), ("crowd", 24)])
def test_both_find_the_same_in_plans_that_run_into_everything(kind: str, n: int) -> None:
    scene = as_json(CLASSES[kind](n, 7))
    plan = straight_plan(msgspec.convert(scene, Scene))
    report, ours, theirs = judged(scene, plan)
    assert ours == theirs
    assert {"separation", "obstacle", "fence"} & {k for k, _ in ours}
    for fault in report.faults:
        assert fault.amount is not None and fault.amount > 0.0


def test_all_pairs_finds_what_each_pair_by_itself_finds() -> None:
    rng = np.random.default_rng(5)
    motions = []
    for _ in range(40):
        count = int(rng.integers(1, 60))
        t = np.cumsum(rng.uniform(0.02, 0.5, count)) + rng.uniform(0.0, 5.0)
        places = np.cumsum(rng.normal(size=(count, 3)), axis=0) + rng.uniform(-25.0, 25.0, 3)
        motions.append(np.column_stack((t, places)))
    leaves = [k % 3 == 0 for k in range(40)]
    radius = rng.uniform(0.5, 1.5, 40)
    found, (i, j, clearance, when) = all_pairs(motions, radius, leaves, 1.5)
    since = min(motion[0, 0] for motion in motions)
    alone = {}
    for a in range(40):
        for b in range(a + 1, 40):
            distance, _ = separation(motions[a], motions[b], 1.5, a_leaves=leaves[a], b_leaves=leaves[b], since=since)
            alone[a, b] = distance - radius[a] - radius[b]
    assert {(int(a), int(b)) for a, b, _, _ in found} == {pair for pair, value in alone.items() if value < 0.0}
    assert (i, j) == min(alone, key=lambda pair: alone[pair])
    assert clearance == pytest.approx(alone[i, j])
    one, other = (checker.at(motions[k], np.array([when]))[0] for k in (i, j))
    gap = np.linalg.norm((one - other) / [1.0, 1.0, 1.5])
    assert gap - radius[i] - radius[j] == pytest.approx(clearance)


def test_the_closest_approach_lies_between_samples() -> None:
    """Two cross at right angles; at no sample of either are they nearer than 10 m."""
    one = np.array([[0.0, -10, 0, 0], [2.0, 10, 0, 0]])
    other = np.array([[0.0, 0, -10, 3.0], [2.0, 0, 10, 3.0]])
    assert separation(one, other, 1.5) == pytest.approx((2.0, 1.0))
    assert separation(one, other, 1.5, since=1.5)[0] == pytest.approx(math.sqrt(5**2 + 5**2 + 2**2))


def test_movers_are_kept_clear_of_and_not_judged(plan: dict[str, Any]) -> None:
    scene = msgspec.convert(SCENE, Scene)
    across = MovingObstacle("m", np.array([[-5.0, 11.5, -60, 10], [20.0, 11.5, 65, 10]]), 0.5)
    again = MovingObstacle("n", across.motion, 0.5)
    report = verify(scene, plan["trajectories"], [across, again])
    assert {f.ids for f in report.faults} == {("a", "m"), ("a", "n"), ("b", "m"), ("b", "n")}
    past = MovingObstacle("m", np.array([[-5.0, -18, 0, 10], [-0.5, -18, 60, 10]]), 0.5, leaves=True)
    assert verify(scene, plan["trajectories"], [past]).ok  # what it did before the plan begins is no matter


@pytest.mark.parametrize(
    "samples",
    [
        [],
        [[]],
        [[0, 1, 2]],
        [["a", 0, 0, 0]],
        3,
        None,
        [[0, -20, 0, 10], [1]],
        [[0, 1e300, 0, 10]],
        [[0, 10**400, 0, 10]],
        [[math.inf] * 4],
        [[[0, -20, 0, 10]]],
    ],
)
def test_whatever_is_no_trajectory_is_a_fault(samples: Any, plan: dict[str, Any]) -> None:
    report = verify(msgspec.convert(SCENE, Scene), {**plan["trajectories"], "a": samples})
    assert [(fault.kind, fault.ids) for fault in report.faults] == [("samples", ("a",))]


def test_the_endless_and_the_far_are_judged_all_the_same(plan: dict[str, Any]) -> None:
    far = [[0.0, -20, 0, 10], [1.0, 1e9, 1e9, 1e9], [1e11, 20, 0, 10]]
    report = verify(msgspec.convert(SCENE, Scene), {**plan["trajectories"], "a": far})
    ours = {(fault.kind, fault.ids[0]) for fault in report.faults}
    assert {("speed", "a"), ("bounds", "a"), ("fence", "a"), ("late", "a"), ("sampling", "a")} <= ours
    assert report.makespan == 1e11
