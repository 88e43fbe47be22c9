"""Scenes that have no plan, one or more for each code, with the ids that the error must name."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

from agents.planner.model.errors import Code
from tests.agents.planner.generate import as_json, city, swap_circle

Raw = dict[str, Any]


def _base() -> Raw:
    """Six copters fly past a box, a cylinder and a zone."""
    vehicles = [
        {
            "id": f"v{k:03d}",
            "type": "copter",
            "radius": 1.0,
            "vmax": 5.0,
            "amax": 2.5,
            "start": [-45, -40 + 8 * k, 10],
            "goal": [45, -40 + 8 * k, 10],
        }
        for k in range(6)
    ]
    obstacles = [
        {"type": "box", "min": [-10, -10, 0], "max": [10, 10, 30]},
        {"type": "cylinder", "center": [30, 30], "radius": 6.0, "floor": 0.0, "ceiling": 40.0},
        {"type": "no_fly", "polygon": [[-50, 20], [-30, 20], [-30, 45], [-50, 45]], "floor": 0.0, "ceiling": 40.0},
    ]
    return {
        "format": "swarm-scene/1",
        "name": "broken",
        "assignment": "labelled",
        "vehicles": vehicles,
        "obstacles": obstacles,
        "bounds": {"min": [-60, -60, 0], "max": [60, 60, 40]},
        "downwash": 1.5,
        "goal_tolerance": 0.5,
        "expect": "error",
        "class": "infeasible",
        "source": None,
    }


def _with(**of: Any) -> Callable[[Raw], None]:
    def change(scene: Raw) -> None:
        scene.update(of)

    return change


def _vehicle(k: int, **of: Any) -> Callable[[Raw], None]:
    def change(scene: Raw) -> None:
        scene["vehicles"][k].update(of)

    return change


def _without(*path: str | int) -> Callable[[Raw], None]:
    def change(scene: Raw) -> None:
        part: Any = scene
        for each in path[:-1]:
            part = part[each]
        del part[path[-1]]

    return change


def _also(obstacle: Raw) -> Callable[[Raw], None]:
    def change(scene: Raw) -> None:
        scene["obstacles"].append(obstacle)

    return change


def _fenced(scene: Raw) -> None:
    """A notch in the fence, in which v003 starts and v001 is to end."""
    polygon = [[-58, -58], [58, -58], [58, 58], [-58, 58], [-58, -10], [-42, -10], [-42, -20], [-58, -20]]
    scene["geofence"] = {"polygon": polygon, "floor": 2, "ceiling": 38}


def _unlabelled(scene: Raw) -> None:
    scene["assignment"] = "unlabelled"
    scene["goals"] = [v.pop("goal") for v in scene["vehicles"]]


def _all(*changes: Callable[[Raw], None]) -> Callable[[Raw], None]:
    def change(scene: Raw) -> None:
        for each in changes:
            each(scene)

    return change


def _goal(k: int, place: list[float]) -> Callable[[Raw], None]:
    def change(scene: Raw) -> None:
        scene["goals"][k] = place

    return change


def _cell(x: float, y: float) -> Callable[[Raw], None]:
    """Four walls and a lid about a place on the ground, with a crack that is too narrow for anybody."""

    def change(scene: Raw) -> None:
        for low, high in (
            ([x - 6, y - 6, 0], [x - 4, y + 6, 20]),
            ([x + 4, y - 6, 0], [x + 6, y + 6, 20]),
            ([x - 4, y - 6, 0], [x + 4, y - 4, 20]),
            ([x - 4, y + 4, 0], [x - 1, y + 6, 20]),
            ([x + 0.5, y + 4, 0], [x + 4, y + 6, 20]),
            ([x - 6, y - 6, 20], [x + 6, y + 6, 22]),
        ):
            scene["obstacles"].append({"type": "box", "min": low, "max": high})

    return change


def _wall(foot: float) -> Callable[[Raw], None]:
    """Across everything, from so high up; two have to get behind it, a third has not."""
    return _all(
        _also({"type": "box", "min": [20, -60, foot], "max": [22, 60, 40]}),
        *[_without("vehicles", 3)] * 3,
        _vehicle(2, goal=[-45, 56, 10]),
    )


PLANE = {"type": "plane", "vmin": 12.0, "vmax": 22.0, "amax": 5.0, "radius": 3.0, "start_heading_deg": 0.0}
BOW_TIE = {"type": "no_fly", "polygon": [[0, 30], [10, 40], [10, 30], [0, 40]], "floor": 0, "ceiling": 9}

CASES: dict[str, tuple[Code, list[str], Callable[[Raw], None]]] = {
    "another format": ("invalid_scene", [], _with(format="swarm-scene/2")),
    "no vehicles": ("invalid_scene", [], _with(vehicles=[])),
    "no bounds": ("invalid_scene", [], _without("bounds")),
    "bounds inside out": ("invalid_scene", [], _with(bounds={"min": [60, -60, 0], "max": [-60, 60, 40]})),
    "two of a name": ("invalid_scene", ["v001"], _vehicle(4, id="v001")),
    "no name": ("invalid_scene", [], _without("vehicles", 2, "id")),
    "no start": ("invalid_scene", ["v002"], _without("vehicles", 2, "start")),
    "no goals": ("invalid_scene", ["v002", "v005"], _all(_vehicle(2, goal=None), _without("vehicles", 5, "goal"))),
    "a word for a number": ("invalid_scene", ["v003"], _vehicle(3, vmax="fast")),
    "two numbers for a place": ("invalid_scene", ["v003"], _vehicle(3, start=[1.0, 2.0])),
    "an unknown type": ("invalid_scene", ["v003"], _vehicle(3, type="balloon")),
    "no size": ("invalid_scene", ["v003"], _vehicle(3, radius=0.0)),
    "no speed": ("invalid_scene", ["v003"], _vehicle(3, vmax=-5.0)),
    "no acceleration": ("invalid_scene", ["v003"], _vehicle(3, amax=0)),
    "a plane without vmin": ("invalid_scene", ["v003"], _vehicle(3, type="plane", start_heading_deg=0.0)),
    "a plane without heading": ("invalid_scene", ["v003"], _vehicle(3, type="plane", vmin=2.0)),
    "a plane whose vmin is over vmax": (
        "invalid_scene",
        ["v003"],
        _vehicle(3, type="plane", vmin=6.0, start_heading_deg=0.0),
    ),
    "an unknown obstacle": ("invalid_scene", [], _also({"type": "cone", "center": [0, 0]})),
    "a box inside out": ("invalid_scene", [], _also({"type": "box", "min": [0, 0, 9], "max": [1, 1, 3]})),
    "a cylinder without radius": (
        "invalid_scene",
        [],
        _also({"type": "cylinder", "center": [0, 0], "radius": -1, "floor": 0, "ceiling": 9}),
    ),
    "a zone of two corners": (
        "invalid_scene",
        [],
        _also({"type": "no_fly", "polygon": [[0, 0], [1, 1], [0, 0]], "floor": 0, "ceiling": 9}),
    ),
    "a zone that crosses itself": ("invalid_scene", [], _also(BOW_TIE)),
    "too few goals": ("invalid_scene", [], _all(_unlabelled, lambda scene: scene["goals"].pop())),
    "no list of goals": ("invalid_scene", [], _with(assignment="unlabelled")),
    "start in a box": ("start_in_obstacle", ["v004"], _vehicle(4, start=[0, 0, 10])),
    "start beside a box": ("start_in_obstacle", ["v004"], _vehicle(4, start=[-10.9, 0, 10])),
    "starts in a zone and a cylinder": (
        "start_in_obstacle",
        ["v002", "v004"],
        _all(_vehicle(4, start=[-40, 30, 10]), _vehicle(2, start=[30, 24, 10])),
    ),
    "goal in a box": ("goal_in_obstacle", ["v002"], _vehicle(2, goal=[0, 0, 10])),
    "goal above a box": ("goal_in_obstacle", ["v002"], _vehicle(2, goal=[0, 0, 30.9])),
    "goal in a zone, unlabelled": ("goal_in_obstacle", ["goals[3]"], _all(_unlabelled, _goal(3, [-40, 30, 10]))),
    "starts overlap": ("starts_overlap", ["v000", "v001"], _vehicle(1, start=[-45, -39, 10])),
    "three starts overlap": (
        "starts_overlap",
        ["v000", "v001", "v003"],
        _all(_vehicle(3, start=[-45, -38.5, 10]), _vehicle(1, start=[-45, -38.5, 12.9])),
    ),
    "goals overlap": ("goals_overlap", ["v001", "v005"], _vehicle(5, goal=[45, -32, 12.9])),
    "goals overlap, unlabelled": (
        "goals_overlap",
        ["goals[1]", "goals[5]"],
        _all(_unlabelled, _goal(5, [45, -31, 10])),
    ),
    "start out of bounds": ("start_out_of_bounds", ["v001"], _vehicle(1, start=[-60.1, 0, 10])),
    "goal out of bounds": (
        "goal_out_of_bounds",
        ["v001", "v003"],
        _all(_vehicle(3, goal=[0, 30, 41]), _vehicle(1, goal=[61, 0, 9])),
    ),
    "start out of the fence": ("start_out_of_bounds", ["v003"], _fenced),
    "goal out of the fence": (
        "goal_out_of_bounds",
        ["v001"],
        _all(_fenced, _vehicle(3, start=[-40, -16, 10]), _vehicle(1, goal=[-50, -15, 10])),
    ),
    "goal under the fence": (
        "goal_out_of_bounds",
        ["v001"],
        _all(_fenced, _vehicle(3, start=[-40, -16, 10]), _vehicle(1, goal=[40, -32, 1])),
    ),
    "a rover's goal in the air": ("unreachable", ["v001"], _vehicle(1, type="rover", goal=[45, -32, 20])),
}
"""what is known before anything is searched for"""

CLOSED: dict[str, tuple[Code, list[str], Callable[[Raw], None]]] = {
    "a goal in a cell and a start in another": (
        "unreachable",
        ["v000", "v002"],
        _all(_cell(45, -40), _cell(-45, -24), _vehicle(1, start=[-52, -40, 10]), _vehicle(3, start=[-52, -8, 10])),
    ),
    "a wall from end to end": ("unreachable", ["v000", "v001"], _wall(0.0)),
    "a crack under a wall": ("unreachable", ["v000", "v001"], _wall(0.9)),
}
"""what the map has to find"""


def broken(name: str) -> tuple[Raw, Code, list[str]]:
    """A scene as in a file, its code, and the ids of the offenders."""
    code, ids, change = {**CASES, **CLOSED}[name]
    scene = copy.deepcopy(_base())
    change(scene)
    scene["error"] = {"codes": [code], "ids": ids}
    return scene, code, ids


def big_and_broken(kind: str) -> tuple[Raw, Code, list[str]]:
    """Large ones, which must be refused as quickly."""
    if kind == "city":
        scene = as_json(city(100, 3))
        scene["vehicles"][70]["goal"] = [scene["obstacles"][0]["min"][0] + 1.0, scene["obstacles"][0]["min"][1], 5.0]
        return scene, "goal_in_obstacle", ["v070"]
    scene = as_json(swap_circle(256, 3))
    scene["vehicles"][255]["start"] = scene["vehicles"][7]["start"]
    return scene, "starts_overlap", ["v007", "v255"]
