"""Missions of LSC (github.com/qwerty35/lsc_planner, MIT licence) as scenes of ours, from a folder of one's own.

Nothing of theirs is kept here: a mission says who starts where, what its bounds and limits are; an OctoMap file
(octomap.github.io, ``.bt``) which cubes of space are taken.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from agents.planner.model.scene import Bounds, Box, Obstacle, Scene, Vehicle

Cubes = NDArray[np.float64]
DEPTH = 16
"""levels of an OctoMap tree"""
TAKEN, INNER = 2, 3
"""the two bits of a child; 1: free, 0: not known"""
ASIDE = 0.2
"""m beyond the bounds in which what is taken still matters to somebody"""


def scene_of(mission: Path, cubes: Cubes | None = None) -> Scene:
    """A mission; ``cubes``: what is :func:`taken` in its world.

    What they leave to each axis is held to here by the whole vector: nobody is quicker, or accelerates more, than the
    least of its three limits.
    """
    body: dict[str, Any] = json.loads(mission.read_text(encoding="utf-8"))
    x0, y0, z0, x1, y1, z1 = map(float, body["world"][0]["dimension"])
    kinds = body["quadrotors"]
    vehicles = []
    for n, agent in enumerate(body["agents"]):
        kind = kinds.get(agent["type"], kinds["default"])
        vehicle = Vehicle(
            id=f"a{n:02}",
            type="copter",
            start=tuple(agent["start"]),
            goal=tuple(agent["goal"]),
            radius=kind["radius"],
            vmax=min(kind["max_vel"]),
            amax=min(kind["max_acc"]),
        )
        vehicles.append(vehicle)
    obstacles: list[Obstacle] = (
        [] if cubes is None else list(boxes_of(cubes, np.array([x0, y0, z0]), np.array([x1, y1, z1])))
    )
    return Scene(
        vehicles=vehicles,
        obstacles=obstacles,
        bounds=Bounds(min=(x0, y0, z0), max=(x1, y1, z1)),
        downwash=max(kind["downwash"] for kind in kinds.values()),
        goal_tolerance=0.05,
        name=mission.stem,
    )


def world_for(mission: Path, folder: Path) -> Path | None:
    """The world that goes with a mission: of the same number in ``world/forest``, ``world/office.bt``, or none."""
    kind, number = mission.parents[1].name, re.findall(r"\d+", mission.stem)[-1]
    places = {"forest": folder / "world" / "forest" / f"forest{number}.bt", "office": folder / "world" / "office.bt"}
    return places.get(kind)


def taken(data: bytes) -> Cubes:
    """(n, 4): x, y, z and side of the cubes that an OctoMap file says are taken. Raises ValueError."""
    head, _, tree = data.partition(b"\ndata\n")
    side = re.search(rb"^res ([0-9.]+)$", head, re.MULTILINE)
    if not head.startswith(b"# Octomap OcTree binary file") or side is None:
        raise ValueError("not a binary OctoMap file")
    found: list[tuple[float, float, float, float]] = []
    at = 0
    waiting = [(0.0, 0.0, 0.0, float(side[1]) * 2**DEPTH)]
    while waiting:
        x, y, z, wide = waiting.pop()
        bits = int.from_bytes(tree[at : at + 2], "little")
        at += 2
        inner = []
        for child in range(8):
            kind = bits >> 2 * child & 3
            cube = tuple(c + (wide if child >> n & 1 else -wide) / 4.0 for n, c in enumerate((x, y, z)))
            if kind == TAKEN:
                found.append((cube[0], cube[1], cube[2], wide / 2.0))
            elif kind == INNER:
                inner.append((cube[0], cube[1], cube[2], wide / 2.0))
        waiting += inner[::-1]  # the first child's tree comes first
    if at != len(tree):
        raise ValueError("the OctoMap file's tree does not end with it")
    return np.array(found, dtype=np.float64).reshape(-1, 4)


def boxes_of(cubes: Cubes, low: Cubes, high: Cubes) -> list[Box]:
    """As few boxes as are soon found that hold what is taken between two corners.

    Holes in which two cubes a side do not fit are filled: walls that were scanned are full of them, and nobody of
    these fits into one. So a scene is somewhat tighter than the mission, and nowhere wider.
    """
    if not len(cubes):
        return []
    side = float(cubes[:, 3].min())
    first = np.floor((low - ASIDE) / side).astype(np.int64)
    shape = np.ceil((high + ASIDE) / side).astype(np.int64) - first
    full = np.zeros(shape, dtype=np.bool_)
    for x, y, z, wide in cubes:
        begin = np.round((np.array([x, y, z]) - wide / 2.0) / side).astype(np.int64) - first
        end = begin + round(wide / side)
        begin, end = np.clip(begin, 0, shape), np.clip(end, 0, shape)
        full[begin[0] : end[0], begin[1] : end[1], begin[2] : end[2]] = True
    full |= ndimage.binary_closing(np.pad(full, 2, mode="edge"), np.ones((2, 2, 2)))[2:-2, 2:-2, 2:-2]
    boxes = []
    for i, j, k in np.argwhere(full):
        if not full[i, j, k]:
            continue  # in a box before
        end = [int(i) + 1, int(j) + 1, int(k) + 1]
        for axis in (2, 1, 0):  # as tall as can be, then as long, then as wide
            while end[axis] < shape[axis]:
                ranges = [slice(b, e) for b, e in zip((i, j, k), end, strict=True)]
                ranges[axis] = slice(end[axis], end[axis] + 1)
                if not full[tuple(ranges)].all():
                    break
                end[axis] += 1
        full[i : end[0], j : end[1], k : end[2]] = False
        corners = np.round((np.array([[i, j, k], end]) + first) * side, 6).tolist()
        boxes.append(Box(min=tuple(corners[0]), max=tuple(corners[1])))
    return boxes
