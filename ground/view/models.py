"""What vehicles look like: boxes in body axes (forward, right, down), about two metres across.

They are larger than most real vehicles, so that one is still seen across a field; ``zmav view --size`` scales them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import rerun as rr

from ground.view import style
from zmav.wire import Vector

BRIGHT, DIM, DARK = 1.0, 0.66, 0.24
"""shares of the vehicle's own colour"""


class Part(NamedTuple):
    center: Vector
    size: Vector
    share: float
    yaw: float = 0.0
    """radians about down"""


def _arm(yaw: float) -> tuple[Part, ...]:
    x, y = 0.72 * math.cos(yaw), 0.72 * math.sin(yaw)
    return (
        Part((x / 2, y / 2, 0.0), (0.72, 0.07, 0.06), DIM, yaw),
        Part((x, y, -0.1), (0.6, 0.6, 0.02), BRIGHT if x > 0 else DIM, yaw),
        Part((x, y, 0.0), (0.1, 0.1, 0.16), DARK),
    )


COPTER = (
    Part((0.0, 0.0, 0.0), (0.5, 0.34, 0.18), BRIGHT),
    Part((0.27, 0.0, 0.0), (0.14, 0.2, 0.1), DARK),
    *(part for turn in (1, 3, 5, 7) for part in _arm(turn * math.pi / 4)),
)
PLANE = (
    Part((-0.13, 0.0, 0.0), (1.95, 0.23, 0.23), BRIGHT),
    Part((0.98, 0.0, 0.0), (0.26, 0.16, 0.16), DARK),
    Part((0.26, 0.0, -0.08), (0.44, 3.1, 0.06), BRIGHT),
    Part((-1.0, 0.0, -0.03), (0.3, 1.04, 0.05), DIM),
    Part((-1.05, 0.0, -0.23), (0.3, 0.04, 0.46), DIM),
)
ROVER = (
    Part((0.0, 0.0, -0.38), (1.4, 0.8, 0.26), BRIGHT),
    Part((-0.2, 0.0, -0.6), (0.7, 0.6, 0.2), DIM),
    Part((0.3, 0.0, -0.58), (0.1, 0.12, 0.28), DARK),
    *(Part((x, y, -0.24), (0.4, 0.12, 0.4), DARK) for x in (-0.46, 0.46) for y in (-0.46, 0.46)),
)
OTHER = (Part((0.0, 0.0, 0.0), (1.2, 0.4, 0.3), BRIGHT), Part((0.7, 0.0, 0.0), (0.2, 0.2, 0.15), DARK))
KINDS = {"copter": COPTER, "heli": COPTER, "plane": PLANE, "vtol": PLANE, "rover": ROVER, "boat": ROVER}


def model(kind: str | None, size: float, shade: style.Colour) -> rr.Boxes3D:
    """The model of a kind of vehicle (:attr:`zmav.wire.VehicleState.kind`), enlarged ``size`` times."""
    parts = KINDS.get(kind or "", OTHER)
    return rr.Boxes3D(
        centers=[[size * x for x in part.center] for part in parts],
        sizes=[[size * x for x in part.size] for part in parts],
        rotation_axis_angles=[rr.RotationAxisAngle((0.0, 0.0, 1.0), radians=part.yaw) for part in parts],
        colors=[style.darkened(shade, part.share) for part in parts],
        fill_mode=rr.components.FillMode.Solid,
    )
