"""Missions of LSC as scenes: an OctoMap file is read, and what is taken becomes boxes that hold it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from agents.planner.model.scene import Box
from tests.agents.planner import lsc

HEAD = b"# Octomap OcTree binary file\n# a comment\nid OcTree\nsize 3\nres 0.1\ndata\n"


def tree(*kinds: int) -> bytes:
    """One node: the kinds of its eight children."""
    return sum(kind << 2 * n for n, kind in enumerate(kinds)).to_bytes(2, "little")


def test_the_taken_leaves_of_an_octomap_are_found_where_they_are() -> None:
    nodes = tree(0, 2, 0, 0, 0, 0, 0, 3) + tree(2, 1, 0, 0, 0, 0, 0, 0)
    half = 0.1 * 2**15
    found = lsc.taken(HEAD + nodes)
    assert found.tolist() == [[half / 2, -half / 2, -half / 2, half], [half / 4, half / 4, half / 4, half / 2]]


@pytest.mark.parametrize("data", [b"", b"PNG", HEAD, HEAD + tree(2, *[0] * 7) + b"\0\0"])
def test_what_is_no_octomap_is_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match=r"OctoMap"):
        lsc.taken(data)


def test_boxes_hold_all_that_is_taken_and_fill_small_holes_only() -> None:
    low, high = np.zeros(3), np.full(3, 2.0)
    places = [(0.05 + 0.1 * i, 0.05, 0.05 + 0.1 * k, 0.1) for i in range(10) for k in range(20) if (i, k) != (5, 5)]
    boxes = lsc.boxes_of(np.array(places), low, high)
    assert [(box.min, box.max) for box in boxes] == [((0.0, 0.0, 0.0), (1.0, 0.1, 2.0))]
    apart = [(0.55, 0.55, 0.55, 0.1), (0.95, 0.55, 0.55, 0.1)]
    boxes = lsc.boxes_of(np.array(apart), low, high)
    assert [box.min for box in boxes] == [(0.5, 0.5, 0.5), (0.9, 0.5, 0.5)]
    assert [box.max for box in boxes] == [(0.6, 0.6, 0.6), (1.0, 0.6, 0.6)]


def test_a_mission_becomes_a_scene_with_limits_that_hold_theirs(tmp_path: Path) -> None:
    limits = {"max_vel": [1.0, 1.0, 0.8], "max_acc": [2.0, 2.0, 1.0], "radius": 0.15, "downwash": 2.0}
    mission = tmp_path / "missions" / "forest" / "1agents" / "multi_random_1agents_7.json"
    mission.parent.mkdir(parents=True)
    agent = {"type": "crazyflie", "cid": 1, "start": [0.0, 0.0, 1.0], "goal": [1.0, 0.0, 1.0]}
    body = {"quadrotors": {"crazyflie": limits, "default": limits}, "world": [{"dimension": [-2, -2, 0, 2, 2, 2]}]}
    mission.write_text(json.dumps(body | {"agents": [agent], "obstacles": []}), encoding="utf-8")
    scene = lsc.scene_of(mission, np.array([[0.5, 0.1, 0.9, 0.2]]))
    (vehicle,) = scene.vehicles
    assert (vehicle.radius, vehicle.vmax, vehicle.amax, scene.downwash) == (0.15, 0.8, 1.0, 2.0)
    assert scene.obstacles == [Box(min=(0.4, 0.0, 0.8), max=(0.6, 0.2, 1.0))]
    assert lsc.world_for(mission, tmp_path) == tmp_path / "world" / "forest" / "forest7.bt"
