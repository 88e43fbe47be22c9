"""Who takes which place, and what a formation can do: between the fleet's views and the solver's arrays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agents.planner.goals.steps import VehicleView
from agents.planner.goals.timing import Limits
from agents.planner.live import frames
from agents.planner.model.geometry import world_of
from agents.planner.model.problem import Floats
from agents.planner.model.scene import Bounds, Scene, Vehicle
from agents.planner.solve.assign import assign
from zmav.errors import Refused, Unsupported


def present(views: Sequence[VehicleView]) -> Floats:
    """(N, 3) ENU."""
    return frames.enu_array(np.array([view.pos_ned for view in views], dtype=np.float64).reshape(-1, 3))


def limits_of(views: Sequence[VehicleView]) -> Limits:
    def column(name: str) -> Floats:
        return np.array([getattr(view.body, name) for view in views], dtype=np.float64)

    speed = column("speed")
    accel = np.array([view.accel for view in views], dtype=np.float64)
    return Limits(speed, accel, np.minimum(column("climb"), speed), np.minimum(column("descend"), speed))


def rooms_of(views: Sequence[VehicleView]) -> list[float]:
    """m of each one's radius that are for what its position may be off."""
    return [view.room for view in views]


def check_flying(views: Sequence[VehicleView], what: str) -> None:
    """Raise :class:`Refused` naming those that must fly for it and stand on the ground."""
    grounded = [view.name for view in views if view.flies and not view.airborne]
    if grounded:
        are = "is" if len(grounded) == 1 else "are"
        text = f"{', '.join(grounded)} {are} on the ground: take off before a {what}"
        raise Refused(text, field="vehicles", vehicles=grounded, reason="not_airborne")


def check_hovering(views: Sequence[VehicleView], what: str) -> None:
    """Raise :class:`Unsupported` naming the planes, which cannot stand anywhere."""
    winged = [view.name for view in views if not view.hovers]
    if winged:
        text = f"{', '.join(winged)} cannot hover, as a {what} needs it; leave planes out of it"
        raise Unsupported(text, field="vehicles", vehicles=winged)


def at_own_height(views: Sequence[VehicleView], places: Floats) -> Floats:
    """(N, 3) the places, but a rover's at the height where it is: it has no other."""
    own = places.copy()
    for i, view in enumerate(views):
        if not view.flies:
            own[i, 2] = -view.pos_ned[2]
    return own


def choose(views: Sequence[VehicleView], places: Floats) -> list[int]:
    """For each vehicle the index of the place that it gets: all are there as early as can be, on short ways.

    Where rovers are among them heights do not count.
    """
    starts, ends = present(views), places.copy()
    if not all(view.flies for view in views):
        starts[:, 2], ends[:, 2] = 0.0, 0.0
    vehicles = [
        Vehicle(
            id=view.name,
            type="copter",
            start=frames.vector(start),
            radius=view.body.radius,
            vmax=view.body.speed,
            amax=view.accel,
            vz_up=view.body.climb,
            vz_down=view.body.descend,
        )
        for view, start in zip(views, starts, strict=True)
    ]
    both = np.vstack((starts, ends))
    bounds = Bounds(min=frames.vector(both.min(axis=0) - 1.0), max=frames.vector(both.max(axis=0) + 1.0))
    scene = Scene(vehicles=vehicles, assignment="unlabelled", goals=[frames.vector(p) for p in ends], bounds=bounds)
    chosen = assign(scene, world_of(scene))
    assert chosen is not None
    return chosen
