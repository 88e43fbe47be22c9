"""The space-time optimiser: knots of all vehicles moved together until nobody breaks anything.

Gauss-Newton on the violated constraints alone, measured by the change of acceleration, so that each step is a smooth
bend of whole trajectories (after CHOMP: Zucker et al. 2013, Covariant Hamiltonian Optimization for Motion Planning).
Two vehicles share what separates them half and half.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from agents.planner.model.geometry import World
from agents.planner.model.problem import ROVER, Floats, Ints, Problem, places_at
from agents.planner.solve.refine import kernels

# Lengths in radii, and times in what a vehicle takes for some of its radii from rest, so that all sizes of vehicles
# behave alike.
SKIN = 1.0  # that two may move before the list of those near each other is made again
EXTRA = 0.03  # more than the radii, aimed at so that these are reached in few steps
STIFF = 0.02
SPEED_WEIGHT = 0.25
ACCEL_WEIGHT = 0.06
BLOCK = 4


@dataclass
class Worst:
    """What the knots break most."""

    overlap: float = 0.0
    """m by which two are too near"""
    depth: float = 0.0
    """m in an obstacle or out of bounds"""
    speed: float = 0.0
    """greatest, over its limit"""
    accel: float = 0.0
    total: float = 0.0
    """m, summed over the vehicles, each with its worst"""
    by: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    """vehicles that are too near to another or to an obstacle"""

    @property
    def pace(self) -> float:
        """By how much the clock would have to be slowed for everybody to keep to their limits."""
        return float(max(self.speed, np.sqrt(self.accel)))


class Swarm:
    """N vehicles' knots ``place`` (N, K + 1, 3) over ``seconds``, among obstacles and movers."""

    def __init__(self, problem: Problem, world: World, place: Floats, seconds: float) -> None:
        self.problem, self.world = problem, world
        self.length, self.time = units(problem)
        self.extra = EXTRA * self.length
        self.weights = np.array([SPEED_WEIGHT * self.time**2, ACCEL_WEIGHT * self.time**4])
        self.free = len(problem)
        self.limits = np.column_stack([problem.radius, problem.vmax, problem.amax, problem.climb, problem.descend])
        self.size = np.concatenate([problem.radius, [m.radius for m in problem.movers]])
        self.flat = (problem.kind == ROVER).astype(np.float64)
        self.pairs = np.empty((1024, 3), dtype=np.int64)
        self.set(place, seconds)

    def set(self, place: Floats, seconds: float) -> None:
        """Take other knots (N, K + 1, 3), over another time."""
        self.seconds = seconds
        knots = place.shape[1] - 1
        self.h = seconds / knots
        movers = self.problem.movers
        self.all = np.concatenate([place, np.zeros((len(movers), knots + 1, 3))])
        self.last = np.full(self.free + len(movers), knots + 1, dtype=np.int64)
        times = np.linspace(0.0, seconds, knots + 1)
        for m, mover in enumerate(movers, self.free):
            self.all[m] = places_at(mover.motion, times)
            if mover.leaves:
                self.last[m] = int(np.ceil(mover.motion[-1, 0] / self.h))
        self.band = np.zeros((self.free, 3 * (knots + 1), kernels.BAND))
        self.right = np.zeros((self.free, 3 * (knots + 1)))
        self.moved = np.ones(self.free)
        self.pending = False
        self.own = np.zeros((self.free, 3))
        self.skin = -1.0

    @property
    def place(self) -> Floats:
        """(N, K + 1, 3)"""
        return self.all[: self.free]

    def look(self, slide: float = 1.0) -> Worst:
        """What is broken now; what is to be done about it is kept for :meth:`bend`."""
        if self.pending:
            self.clear()
        self.pending = True
        if self.skin < 0.0:
            self.find_pairs()
        hurt = np.zeros(len(self.all))
        kernels.keep_apart(
            self.all,
            self.pairs,
            self.count,
            BLOCK,
            self.last,
            self.size,
            1.0 / self.problem.downwash,
            self.extra,
            slide,
            self.h,
            self.band,
            self.right,
            hurt,
        )
        kernels.look(
            self.world,
            self.all,
            self.moved,
            self.limits,
            self.weights,
            self.h,
            self.extra,
            self.band,
            self.right,
            self.own,
        )
        hurt = hurt[: self.free]
        deepest, speed, accel = self.own.max(axis=0) if self.free else (0.0, 0.0, 0.0)
        by = np.flatnonzero((hurt > 0.0) | (self.own[:, 0] > 0.0))
        return Worst(
            float(hurt.max(initial=0.0)),
            float(deepest),
            float(speed),
            float(accel),
            float(hurt.sum() + self.own[:, 0].sum()),
            by,
        )

    def find_pairs(self) -> None:
        reach = self.size + self.extra + SKIN * self.length / 2
        while True:
            self.count = kernels.near_pairs(
                self.all, self.last, reach, self.free, 1.0 / self.problem.downwash, BLOCK, self.pairs
            )
            if self.count <= len(self.pairs):
                break
            self.pairs = np.empty((2 * self.count, 3), dtype=np.int64)
        self.skin = SKIN * self.length

    def slow(self, by: float) -> None:
        """The same ways with the clock slowed: no two come nearer to each other, movers may."""
        if self.problem.movers:
            self.set(self.place.copy(), self.seconds * by)
            return
        self.seconds *= by
        self.h *= by
        self.clear()

    def clear(self) -> None:
        """Forget what :meth:`look` found."""
        self.band[:] = 0.0
        self.right[:] = 0.0
        self.moved[:] = 1.0
        self.pending = False

    def bend(self, cap: float) -> None:
        """Move everybody who is to move, nobody by more than ``cap`` m."""
        stiff = STIFF * self.time**4
        far = kernels.bend(self.all, self.flat, stiff, cap, self.h, self.band, self.right, self.moved)
        self.skin -= 2.0 * float(far)
        self.pending = False


def units(problem: Problem) -> tuple[float, float]:
    """Metres and seconds by which a problem is measured: a radius, and the time in which 1.25 of it are left behind."""
    length = float(np.median(problem.radius)) if len(problem) else 1.0
    accel = float(np.median(problem.amax)) if len(problem) else 1.0
    return length, float(np.sqrt(2.5 * length / accel))
