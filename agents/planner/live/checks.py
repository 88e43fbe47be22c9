"""What is taken from the network: numbers that are numbers, names that can be names, and not too much of anything."""

from __future__ import annotations

import math
from typing import Any

import msgspec

from agents.planner.goals.sweeping import spacing_of
from agents.planner.model.scene import polygon_fault
from zmav import keys, wire
from zmav.errors import BadInput
from zmav.wire import swarm

MOST_BYTES = 512 * 1024
"""of an order; an obstacle alone has at most an eighth of that"""
MOST_VEHICLES, MOST_POINTS, MOST_CORNERS = 500, 2000, 500
FARTHEST = 100_000.0
"""m from the fleet's origin, and the largest number of any kind: fields of 32 bits and less lie behind"""
WIDTHS, MOST_OVERLAP, MOST_PIXELS = (0.02, 10.0), 0.9, 100_000
"""of a survey: m of ground in a picture from 1 m above, the largest share seen twice, pixels across"""
EVERY = (0.1, 1000.0)
"""m between two pictures that a vehicle's autopilot is told"""
MOST_OBSTACLES = 2000
OBSTACLE_BYTES = MOST_BYTES // 8


def check_numbers(value: Any, field: str) -> None:
    """Raise :class:`BadInput` naming the field that holds no finite number of a sensible size."""
    if isinstance(value, msgspec.Struct):
        for name in value.__struct_fields__:
            check_numbers(getattr(value, name), f"{field}.{name}")
    elif isinstance(value, list | tuple):
        for i, each in enumerate(value):
            check_numbers(each, f"{field}[{i}]")
    elif isinstance(value, float) and not abs(value) <= FARTHEST:
        raise BadInput.wrong(field, value, f"a number between -{FARTHEST:.0f} and {FARTHEST:.0f}")


def check_goal(goal: swarm.Goal) -> None:
    """What can be told without knowing the fleet. Raises :class:`BadInput`."""
    _at_most(goal.vehicles, MOST_VEHICLES, "goal.vehicles")
    if not goal.vehicles:
        raise BadInput("the goal names no vehicle", field="goal.vehicles", value=[], expected="one name or more")
    for name in goal.vehicles:
        keys.check_name(name, "goal.vehicles")
    for field in ("to", "points", "via", "offsets", "polygon", "at"):
        listed = getattr(goal, field, None)
        if isinstance(listed, list):
            _at_most(listed, MOST_POINTS, f"goal.{field}")
    if isinstance(goal, swarm.Search):
        _at_most([point for way in goal.lanes for point in way], MOST_POINTS, "goal.lanes")
    check_numbers(goal, "goal")
    _check_sizes(goal)


def _check_sizes(goal: swarm.Goal) -> None:
    if isinstance(goal, swarm.Search) and goal.above_ground:
        _positive(goal.height, "goal.height")
    if isinstance(goal, swarm.Formation):
        _positive(goal.spacing, "goal.spacing")
    elif isinstance(goal, swarm.TakeOff):
        _positive(goal.height, "goal.height")
    elif isinstance(goal, swarm.Search) and len(goal.polygon) < 3:
        corners = len(goal.polygon)
        raise BadInput.wrong("goal.polygon", corners, "three or more", f"the search's polygon has {corners} corners")
    elif isinstance(goal, swarm.Survey):
        _check_survey(goal)
    elif isinstance(goal, swarm.GoTo) and len(goal.to) != len(goal.vehicles):
        text = f"{len(goal.vehicles)} vehicles have {len(goal.to)} places to go to"
        raise BadInput(text, field="goal.to", value=len(goal.to), expected=f"{len(goal.vehicles)} places")


def _check_survey(goal: swarm.Survey) -> None:
    _positive(goal.height, "goal.height")
    for i, ratio in enumerate(goal.camera):
        if not WIDTHS[0] <= ratio <= WIDTHS[1]:
            expected = f"sensor over focal length, {WIDTHS[0]:g} to {WIDTHS[1]:g}"
            raise BadInput.wrong(f"goal.camera[{i}]", ratio, expected)
    for field, share in (("goal.overlap", goal.overlap), ("goal.front", goal.front)):
        if not 0.0 <= share <= MOST_OVERLAP:
            raise BadInput.wrong(field, share, f"a share from 0 to {MOST_OVERLAP:g}")
    if not 0 <= goal.pixels <= MOST_PIXELS:
        raise BadInput.wrong("goal.pixels", goal.pixels, f"0 (not known) to {MOST_PIXELS}")
    every = spacing_of(goal)
    if goal.trigger and not EVERY[0] <= every <= EVERY[1]:
        expected = f"pictures {EVERY[0]:g} to {EVERY[1]:g} m apart"
        raise BadInput.wrong("goal.trigger", goal.trigger, expected, f"a picture every {every:.3g} m is not triggered")


def check_obstacle(obstacle: swarm.Obstacle) -> None:
    """Raises :class:`BadInput` for one that has no name or no size."""
    keys.check_name(obstacle.name, "obstacle.name")
    if obstacle.t != obstacle.t or abs(obstacle.t) > 1e11:
        raise BadInput.wrong("obstacle.t", obstacle.t, "UTC seconds")
    if obstacle.ttl is not None and not 0.0 < obstacle.ttl < 1e9:
        raise BadInput.wrong("obstacle.ttl", obstacle.ttl, "seconds, more than zero")
    what = obstacle.what
    check_numbers(what, "obstacle.what")
    if isinstance(what, swarm.Box):
        if any(low == high for low, high in zip(what.low, what.high, strict=True)):
            text = f"box {obstacle.name} has no extent along one of its sides"
            raise BadInput(text, field="obstacle.what", value=[what.low, what.high], expected="two opposite corners")
    elif isinstance(what, swarm.Ball | swarm.Cylinder):
        _positive(what.radius, "obstacle.what.radius")
    if isinstance(what, swarm.Cylinder | swarm.NoFly | swarm.Geofence) and not what.floor < what.ceiling:
        text = f"{obstacle.name}: the floor ({what.floor} m) is not below the ceiling ({what.ceiling} m)"
        raise BadInput(text, field="obstacle.what.floor", value=what.floor, expected=f"less than {what.ceiling}")
    if isinstance(what, swarm.NoFly | swarm.Geofence):
        _at_most(what.polygon, MOST_CORNERS, "obstacle.what.polygon")
        if fault := polygon_fault(what.polygon):
            text = f"the polygon of {obstacle.name}: {fault}"
            raise BadInput(text, field="obstacle.what.polygon", value=len(what.polygon), expected="a simple polygon")


def read_obstacle(data: bytes) -> swarm.Obstacle:
    """An obstacle as it came. Raises :class:`BadInput`."""
    if len(data) > OBSTACLE_BYTES:
        text = f"an obstacle of {len(data)} bytes is not read"
        raise BadInput.wrong("obstacle", len(data), f"at most {OBSTACLE_BYTES} bytes", text)
    obstacle = wire.decode(data, swarm.Obstacle, "obstacle")
    check_obstacle(obstacle)
    return obstacle


def _positive(value: float, field: str) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise BadInput.wrong(field, value, "more than zero")


def _at_most(listed: list[Any], most: int, field: str) -> None:
    if len(listed) > most:
        raise BadInput.wrong(field, len(listed), f"at most {most} entries", f"{field} has {len(listed)} entries")
