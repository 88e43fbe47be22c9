"""What is read, what is refused, and with which code and whose ids."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from agents.planner.model.errors import PlanError
from agents.planner.model.scene import Cylinder, Fence, NoFly, Scene, parse_scene, read_scene
from agents.planner.model.validate import distance, validate
from tests.agents.planner.broken import CASES, PLANE, big_and_broken, broken
from tests.agents.planner.generate import CLASSES, as_json, city


def parse(scene: dict[str, Any]) -> Scene:
    return parse_scene(json.dumps(scene).encode())


def refused(scene: dict[str, Any]) -> PlanError:
    with pytest.raises(PlanError) as caught:
        validate(parse(scene))
    return caught.value


@pytest.mark.parametrize("name", CASES)
def test_is_refused(name: str) -> None:
    scene, code, ids = broken(name)
    error = refused(scene)
    assert (error.kind, error.ids) == (code, ids), error
    assert error.message


@pytest.mark.parametrize("kind", ["city", "swap"])
def test_a_big_one_is_refused(kind: str) -> None:
    scene, code, ids = big_and_broken(kind)
    error = refused(scene)
    assert (error.kind, error.ids) == (code, ids)


def test_what_is_wrong_in_several_ways_gets_the_first_code() -> None:
    scene, _, _ = broken("goal in a box")
    scene["vehicles"][4]["start"] = scene["vehicles"][3]["start"]
    assert refused(scene).kind == "goal_in_obstacle"
    scene["vehicles"][5]["start"] = [30, 30, 10]
    assert refused(scene).kind == "start_in_obstacle"
    scene["vehicles"][5]["radius"] = -1.0
    assert refused(scene).kind == "invalid_scene"


def test_a_centimetre_is_let_pass() -> None:
    scene, _, _ = broken("start beside a box")
    scene["vehicles"][4]["start"] = [-10.995, 0, 10]
    scene["vehicles"][0]["goal"] = [60.005, -40, 10]
    scene["vehicles"][1]["start"] = [-45, -38.005, 10]
    validate(parse(scene))


def test_planes_leave_so_their_goals_may_be_near_others() -> None:
    scene, _, _ = broken("goals overlap")
    scene["vehicles"][5] |= PLANE
    scene["obstacles"] = []
    validate(parse(scene))
    scene["vehicles"][5]["start"] = scene["vehicles"][1]["start"]  # but they all start there
    assert refused(scene).kind == "starts_overlap"


@pytest.mark.parametrize(
    "data", [b"", b"{", b"[]", b"null", b"\xff\xfe\x00", b'{"vehicles": 3}', b"[" * 100_000, b'{"vehicles":[1e999]}']
)
def test_what_is_no_scene_is_refused(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "scene.json"
    path.write_bytes(data)
    with pytest.raises(PlanError) as caught:
        read_scene(path)
    assert caught.value.kind == "invalid_scene"
    with pytest.raises(PlanError, match=r"cannot read .*: No such file"):
        read_scene(tmp_path / "none.json")
    with pytest.raises(PlanError, match="cannot read"):
        read_scene(tmp_path)


def test_a_file_without_end_is_not_read_for_ever() -> None:
    with pytest.raises(PlanError, match="more than 1 MB"):
        read_scene("/dev/zero", largest=1 << 20)


def test_the_field_is_named() -> None:
    for name, words in (
        ("a word for a number", r"vehicles\[3\].vmax: Expected `float`, got `str`"),
        ("no size", r"vehicles\[3\] \(v003\): radius: 0.0 is not between 0.001 and 100000"),
        ("a box inside out", r"obstacles\[3\]: min and max: .* is not below"),
        ("a zone that crosses itself", r"obstacles\[3\]: polygon: the sides after .* cross"),
        ("too few goals", "goals: 5 for 6 vehicles"),
        ("another format", "format: 'swarm-scene/2' is not known"),
    ):
        assert msgspec.json.encode(broken(name)[0])
        with pytest.raises(PlanError, match=words):
            validate(parse(broken(name)[0]))


def test_numbers_that_are_none_are_refused_in_scenes_made_live() -> None:
    good = parse(as_json(city(3)))
    for change in ({"downwash": math.nan}, {"goal_tolerance": math.inf}, {"time_limit": math.nan}, {"downwash": 0.0}):
        with pytest.raises(PlanError) as caught:
            validate(msgspec.structs.replace(good, **change))
        assert caught.value.kind == "invalid_scene"
        assert next(iter(change)) in caught.value.message
    good.vehicles[1].start = (0.0, math.nan, 0.0)
    with pytest.raises(PlanError) as caught:
        validate(good)
    assert caught.value.ids == ["v001"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"bounds": {"min": [-1e308] * 3, "max": [1e308] * 3}}, "bounds: .* the farthest"),
        ({"obstacles": [{"type": "box", "min": [1e300] * 3, "max": [1e301] * 3}]}, r"obstacles\[0\]: .* the farthest"),
        ({"obstacles": [{"type": "cylinder", "center": [0, 0], "radius": 1e300, "floor": 0, "ceiling": 1}]}, "radius"),
        (
            {"obstacles": [{"type": "no_fly", "polygon": [[0, 0], [1e9, 0], [0, 1]], "floor": 0, "ceiling": 1}]},
            "corner",
        ),
        ({"downwash": 1e-300}, "downwash"),
        ({"downwash": 1e300}, "downwash"),
        *[({name: 1e300}, rf"vehicles\[0\] \(v000\): {name}: 1e\+300") for name in ("radius", "vmax", "amax", "vz_up")],
        *[({name: 1e-300}, rf"vehicles\[0\] \(v000\): {name}: 1e-300") for name in ("radius", "vmax", "amax", "vz_up")],
        ({"start": [1e300, 0, 0]}, r"vehicles\[0\] \(v000\): start"),
    ],
)
def test_numbers_that_arithmetic_does_not_bear_are_refused(change: dict[str, Any], words: str) -> None:
    raw = as_json(city(3))
    (raw if change.keys() <= raw.keys() else raw["vehicles"][0]).update(change)
    with pytest.raises(PlanError, match=words) as caught:
        parse(raw)
    assert caught.value.kind == "invalid_scene"


def test_a_polygon_of_very_many_corners_is_looked_at_side_by_side_with_its_neighbours_only() -> None:
    raw = as_json(city(3))
    angles = np.linspace(0.0, 2.0 * np.pi, 4000, endpoint=False)
    corners = (900.0 + 5.0 * np.stack((np.cos(angles), np.sin(angles)), axis=1)).tolist()
    raw["obstacles"] = [{"type": "no_fly", "polygon": corners, "floor": 0.0, "ceiling": 10.0}]
    assert len(parse(raw).obstacles) == 1
    corners[10], corners[3000] = corners[3000], corners[10]
    with pytest.raises(PlanError, match="cross"):
        parse(raw)


def test_unknown_fields_are_left_alone_and_repeated_corners_dropped() -> None:
    scene, _, _ = broken("goal in a box")
    scene["vehicles"][2]["goal"] = [45, -24, 10]
    scene["vehicles"][2]["colour"] = "red"
    scene["obstacles"][0]["name"] = "house"
    scene["geofence"] = {
        "polygon": [[-60, -60], [60, -60], [60, 60], [60, 60], [-60, 60], [-60, -60]],
        "floor": 0,
        "ceiling": 40,
    }
    read = parse(scene)
    validate(read)
    assert isinstance(read.geofence, Fence)
    assert read.geofence.polygon == [(-60, -60), (60, -60), (60, 60), (-60, 60)]


@pytest.mark.parametrize("kind", CLASSES)
def test_generated_scenes_are_sound(kind: str) -> None:
    for n, seed in ((6, 0), (13, 2)):
        scene = CLASSES[kind](n, seed)
        assert len(scene.vehicles) == n
        again = parse(as_json(scene))
        assert again == scene
        validate(again)


def test_the_examples_are_as_they_say(root: Path) -> None:
    folder = root.parent / "shared" / "scenes"
    if not folder.is_dir():
        pytest.skip("the example scenes (../shared/scenes) are not beside this checkout")
    seen = 0
    for path in sorted(folder.glob("*.json")):
        body = json.loads(path.read_bytes())
        if body["expect"] == "error":
            error = refused(body)
            assert error.kind in body["error"]["codes"]
            assert error.ids == body["error"]["ids"]
        else:
            validate(read_scene(path))
        seen += 1
    assert seen >= 9


def test_distances_from_obstacles() -> None:
    pipe = Cylinder(center=(0.0, 0.0), radius=2.0, floor=0.0, ceiling=5.0)
    assert distance(pipe, (5.0, 0.0, 9.0)) == pytest.approx(5.0)
    assert distance(pipe, (1.0, 1.0, 9.0)) == pytest.approx(4.0)
    hook = NoFly(polygon=[(0, 0), (10, 0), (10, 10), (8, 10), (8, 2), (0, 2)], floor=0.0, ceiling=5.0)
    assert distance(hook, (4.0, 6.0, 3.0)) == pytest.approx(4.0)
    assert distance(hook, (9.0, 6.0, 3.0)) == 0.0
    assert distance(hook, (9.0, 6.0, 7.0)) == pytest.approx(2.0)
