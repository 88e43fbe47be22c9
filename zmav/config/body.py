"""How much room a vehicle needs and what it can do: ``[body]`` in the fleet file, and what is usual for its kind."""

from __future__ import annotations

import math

from zmav import wire
from zmav.config.table import Positive, Table
from zmav.errors import BadConfig

_AIRFRAME = {"speed": 5.0, "accel": 2.5, "climb": 2.0, "descend": 1.5}
_PLANE = wire.swarm.Body(
    radius=4.0, speed=22.0, accel=5.0, climb=3.0, descend=3.0, min_speed=12.0, turn_radius=60.0, sweep_width=40.0
)
USUAL: dict[str | None, wire.swarm.Body] = {
    "copter": wire.swarm.Body(radius=1.0, **_AIRFRAME),
    "heli": wire.swarm.Body(radius=1.5, **_AIRFRAME),
    "rover": wire.swarm.Body(radius=1.0, speed=2.0, accel=1.0, climb=0.5, descend=0.5),
    "boat": wire.swarm.Body(radius=1.5, speed=2.0, accel=0.5, climb=0.1, descend=0.1),
    "plane": _PLANE,
    "vtol": _PLANE,
}
"""cautious figures of the small vehicles of each kind; a kind that is not here is taken for a copter"""


class BodyConfig(Table, frozen=True):
    """``[body]`` and ``[vehicles.NAME.body]``: what is absent is as usual for the kind; units as in
    :class:`zmav.wire.swarm.Body`.
    """

    radius: Positive | None = None
    speed: Positive | None = None
    accel: Positive | None = None
    climb: Positive | None = None
    descend: Positive | None = None
    min_speed: float | None = None
    turn_radius: float | None = None
    sweep_width: Positive | None = None
    endurance: Positive | None = None
    reserve: float | None = None
    position_error: float | None = None


def check_body(body: BodyConfig, field: str) -> None:
    """Raise :class:`BadConfig` for numbers that cannot be, or do not go together."""
    for name in body.__struct_fields__:
        value = getattr(body, name)
        if value is not None and not (math.isfinite(value) and value >= 0.0):
            raise BadConfig.wrong(f"{field}.{name}", value, "a number, zero or more")
    if body.reserve is not None and body.reserve >= 1.0:
        raise BadConfig.wrong(f"{field}.reserve", body.reserve, "a share below 1")
    if body.speed is not None and body.min_speed is not None and body.min_speed > body.speed:
        text = f"{field}.min_speed is {body.min_speed}, more than its speed of {body.speed}"
        raise BadConfig(text, field=f"{field}.min_speed", value=body.min_speed, expected=f"{body.speed} at most")


def body_of(kind: str | None, declared: BodyConfig | None = None) -> wire.swarm.Body:
    """What is declared, filled up with what is usual for a kind (copter, plane, rover...; None: not known)."""
    usual = USUAL.get(kind, USUAL["copter"])
    if declared is None:
        return usual
    names = declared.__struct_fields__
    own = {name: value for name in names if (value := getattr(declared, name)) is not None}
    return wire.swarm.Body(**{name: own.get(name, getattr(usual, name)) for name in usual.__struct_fields__})
