"""Following: where each follower shall be beside something that moves, and the next few seconds of its motion.

All is NED about the fleet's origin (metres, m/s). A follower's place is the leader's plus an offset, its velocity the
leader's: fed forward, so that a follower of a steady leader has no lag. What is to be flown always ends at rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from agents.planner.goals.formation import check_apart
from agents.planner.model.problem import Floats, Motion
from zmav import geo
from zmav.errors import BadInput
from zmav.wire import Vector
from zmav.wire.swarm import Body, Follow

ROOM = 1.3
"""times the sum of the radii between default places"""
LAG = 0.8
"""s in which a follower makes up most of what it is away from its place"""
SPARE = 0.9
"""share of speed and acceleration that is used"""
STEP = 0.1
"""s of one step of the motion made here"""
Doing = Literal["follow", "hold", "return", "land"]


@dataclass(frozen=True)
class MovingTarget:
    """Something that moves, as it was at ``t`` (s)."""

    t: float
    pos: Vector
    vel: Vector = (0.0, 0.0, 0.0)

    def at(self, t: float) -> MovingTarget:
        """Going on as it went."""
        ahead = t - self.t
        return MovingTarget(t, geo.plus(self.pos, self.vel, ahead), self.vel)


def default_offsets(bodies: Sequence[Body], leader_radius: float) -> list[Vector]:
    """South of the leader, in turn to the west and east, at its height."""
    widest = max(body.radius for body in bodies)
    step = ROOM * max(2.0 * widest, leader_radius + widest) + 1.0
    return [(-step * (k + 1), (-0.5 if k % 2 == 0 else 0.5) * step, 0.0) for k in range(len(bodies))]


def offsets_of(goal: Follow, bodies: Sequence[Body], leader_radius: float, downwash: float) -> list[Vector]:
    """The goal's offsets, or the usual ones, checked.

    Raises :class:`BadInput` where there are not as many as vehicles, or where two places, or one and the leader, are
    nearer than the sum of the radii.
    """
    count = len(goal.vehicles)
    offsets = list(goal.offsets) or default_offsets(bodies, leader_radius)
    if len(offsets) != count:
        text = f"{len(offsets)} offsets for {count} vehicles"
        raise BadInput(text, field="offsets", value=len(offsets), expected=f"{count}, or none")
    radii = [leader_radius, *(body.radius for body in bodies)]
    names, places = ["the leader", *goal.vehicles], np.array([(0.0, 0.0, 0.0), *offsets])
    check_apart(names, places, radii, downwash, labelled=True, what="followers", field="offsets")
    return offsets


def doing(goal: Follow, age: float) -> Doing:
    """What is done when the leader was heard ``age`` s ago."""
    return "follow" if age <= goal.lost_after else goal.on_lost


def slot(leader: MovingTarget, offset: Vector, t: float) -> MovingTarget:
    """Where a follower of ``leader`` shall be at ``t``, and how fast it goes there."""
    lead = leader.at(t)
    return MovingTarget(t, geo.plus(lead.pos, offset, 1.0), lead.vel)


def segment(
    now: MovingTarget, target: MovingTarget, body: Body, seconds: float = 3.0, *, level: bool = False
) -> Motion:
    """The next motion (T, 4), NED, from ``now`` towards a place that moves as ``target`` does, then to rest.

    For ``seconds`` it makes up its distance to the moving place within the body's speed, acceleration, climb and
    descent; then it brakes. Times are as ``now.t`` says. ``level``: it keeps its height (rovers).
    """
    accel, most = SPARE * body.accel, SPARE * body.speed
    pos, vel = np.array(now.pos, dtype=np.float64), np.array(now.vel, dtype=np.float64)
    rows = [[now.t, *pos]]
    steps = max(1, round(seconds / STEP))
    for k in range(steps + _brake_steps(most, accel)):
        if k < steps:
            there = target.at(now.t + k * STEP)
            wanted = np.array(there.vel) + _closing(np.array(there.pos) - pos, accel)
            if level:
                wanted[2] = 0.0
            wanted = _limited(wanted, most, SPARE * body.climb, SPARE * body.descend)
        elif not vel.any():
            break
        else:
            wanted = np.zeros(3)
        change = wanted - vel
        size = float(np.linalg.norm(change))
        after = vel + change * min(1.0, accel * STEP / max(size, 1e-12))
        pos = pos + (vel + after) / 2.0 * STEP
        vel = after
        rows.append([now.t + (k + 1) * STEP, *pos])
    return np.array(rows, dtype=np.float64)


def _closing(away: Floats, accel: float) -> Floats:
    """The velocity at which a distance is made up: in proportion near by, and so that it can still brake far off."""
    far = float(np.linalg.norm(away))
    if far < 1e-9:
        return np.zeros(3)
    bend = 0.5 * accel * LAG * LAG
    speed = far / LAG if far <= bend else math.sqrt(accel * (2.0 * far - bend))
    return np.asarray(away * (speed / far))


def _limited(vel: Floats, most: float, climb: float, descend: float) -> Floats:
    """Within the speed, and within climb and descent, which are slowed alone."""
    limited = vel.copy()
    limited[2] = min(descend, max(-climb, limited[2]))
    over = float(np.linalg.norm(limited)) / most
    return limited / over if over > 1.0 else limited


def _brake_steps(speed: float, accel: float) -> int:
    return math.ceil(2.0 * speed / accel / STEP) + 2
