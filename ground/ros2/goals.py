"""Goals of a swarm, from ROS's words: places in metres east, north, up of the fleet's origin become north, east, down,
and what a message leaves at zero is as usual.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from ground.ros2 import frames
from ground.ros2.orders import finite, vector
from zmav.errors import BadInput
from zmav.wire import Vector, swarm

MOST = 2000
"""places of one goal"""
Name = Callable[[str], str]
"""the fleet's name of a vehicle by its name in ROS"""
Make = Callable[[Any, Name], swarm.Goal]
"""raises :class:`BadInput` for what is no number"""


def goto(said: Any, name: Name) -> swarm.Goal:
    return swarm.GoTo(vehicles=_vehicles(said, name), to=places("to", said.to), labelled=not said.assign)


def formation(said: Any, name: Name) -> swarm.Goal:
    return swarm.Formation(
        vehicles=_vehicles(said, name),
        shape=said.shape or "line",
        at=vector("at", said.at),
        heading=frames.heading(finite("heading", said.heading)),
        points=[frames.flu(_plain("points", each)) for each in _few("points", said.points)],
        via=places("via", said.via),
        labelled=said.in_order,
        **_given(spacing=finite("spacing", said.spacing)),
    )


def follow(said: Any, name: Name) -> swarm.Goal:
    return swarm.Follow(
        vehicles=_vehicles(said, name),
        leader=name(said.leader),
        offsets=places("offsets", said.offsets),
        **_given(on_lost=said.on_lost, lost_after=finite("lost_after", said.lost_after)),
    )


def search(said: Any, name: Name) -> swarm.Goal:
    overlap = finite("overlap", said.overlap)
    return swarm.Search(vehicles=_vehicles(said, name), **_area(said), **_given(overlap=overlap))


def survey(said: Any, name: Name) -> swarm.Goal:
    return swarm.Survey(
        vehicles=_vehicles(said, name),
        camera=(finite("across", said.across), finite("along", said.along)),
        pixels=said.pixels,
        trigger=said.trigger,
        **_area(said),
        **_given(overlap=finite("overlap", said.overlap), front=finite("front", said.front)),
    )


def takeoff(said: Any, name: Name) -> swarm.Goal:
    return swarm.TakeOff(vehicles=_vehicles(said, name), height=finite("height", said.height))


def land(said: Any, name: Name) -> swarm.Goal:
    return swarm.Land(vehicles=_vehicles(said, name), at=corners("at", said.at))


def back(said: Any, name: Name) -> swarm.Goal:
    return swarm.Return(vehicles=_vehicles(said, name))


def hold(said: Any, name: Name) -> swarm.Goal:
    return swarm.Hold(vehicles=_vehicles(said, name))


KINDS: dict[str, tuple[str, Make]] = {
    "goto": ("SwarmGoTo", goto),
    "formation": ("SwarmFormation", formation),
    "follow": ("SwarmFollow", follow),
    "search": ("SwarmSearch", search),
    "survey": ("SwarmSurvey", survey),
    "takeoff": ("SwarmTakeoff", takeoff),
    "land": ("SwarmLand", land),
    "return": ("SwarmReturn", back),
    "hold": ("SwarmHold", hold),
}
"""by the planner's names: the type in zmav_msgs, and what a goal of it is"""


def places(field: str, said: Any) -> list[Vector]:
    """North, east, down of points east, north, up."""
    return [vector(f"{field}[{i}]", each) for i, each in enumerate(_few(field, said))]


def corners(field: str, said: Any) -> list[swarm.Corner]:
    """North and east of points east and north."""
    return [(north, east) for north, east, _ in places(field, said)]


def _vehicles(said: Any, name: Name) -> list[str]:
    return [name(each) for each in _few("vehicles", said.vehicles)]


def _area(said: Any) -> dict[str, Any]:
    angle = frames.heading(finite("angle", said.angle)) if said.aligned else None
    return {"polygon": corners("polygon", said.polygon), "height": finite("height", said.height), "angle": angle}


def _given(**fields: Any) -> dict[str, Any]:
    """Those that are not at zero."""
    return {field: value for field, value in fields.items() if value}


def _plain(field: str, said: Any) -> Vector:
    return finite(f"{field}.x", said.x), finite(f"{field}.y", said.y), finite(f"{field}.z", said.z)


def _few(field: str, said: Sequence[Any]) -> Sequence[Any]:
    if len(said) > MOST:
        raise BadInput.wrong(field, len(said), f"at most {MOST}")
    return said
