"""One flight of a plan by real vehicles: what it is begun with, what it may come to, and the margin that it needs."""

from __future__ import annotations

from collections.abc import Callable, Collection, Coroutine, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from agents.planner.model.problem import Floats, Motion, MovingObstacle
from zmav.wire.state import Severity

TRACKING = 0.4
"""m by which a vehicle may be off its trajectory: see docs/planner-execution.md"""
SLACK = 0.05
"""m of a plan's margin that goes to the difference of its samples and the curve that is flown"""

Say = Callable[[str, Severity, str, dict[str, Any]], None]
"""is told what happened: kind, severity, text, detail"""


@dataclass(frozen=True)
class Flight:
    """A verified plan for execution. By vehicle; ENU metres about the fleet's origin; all begin at t = 0, at rest."""

    motions: Mapping[str, Motion]
    radius: Mapping[str, float]
    accel: Mapping[str, float]
    """m/s²: what stop tails are made by"""
    downwash: float = 1.0
    margin: float = TRACKING + SLACK
    """m by which each vehicle's radius was widened when the plan was made and verified"""
    tracking: float = TRACKING
    """m that vehicles may be off their trajectories in it"""
    movers: Sequence[MovingObstacle] = ()
    """on our UTC"""
    tolerance: float = 0.5
    """m from its goal at which a vehicle has arrived"""
    tolerances: Mapping[str, float] = field(default_factory=dict)
    """of those for which it is another one"""

    def near(self, name: str, away: float, holds: float = 0.0) -> bool:
        """``holds``: m within which the vehicle is seen to hold any place."""
        return away <= max(holds, self.tolerances.get(name, self.tolerance))


@dataclass(frozen=True)
class Trouble:
    """Why a plan is not flown to its end, and where everybody is."""

    reason: str
    places: Mapping[str, Floats]
    """those who go on: at rest at these places (ENU), from which a new plan starts"""
    gone: Collection[str]
    """those who do not: the way of each stays reserved, and the column at its last known place"""


Replan = Callable[[Trouble], Coroutine[Any, Any, "Flight | None"]]


@dataclass
class Outcome:
    """How a flight ended."""

    done: bool
    reason: str = ""
    away: dict[str, float] = field(default_factory=dict)
    """m from its goal, by vehicle"""
    replans: int = 0
    flown: dict[str, float] = field(default_factory=dict)
    """the moment of the last plan that each has come to"""


def margin_for(speed: float, clock_error: float, tracking: float = TRACKING) -> float:
    """The margin (m) that a plan needs for a vehicle of this speed whose clock is known to ``clock_error`` seconds."""
    return tracking + speed * clock_error + SLACK
