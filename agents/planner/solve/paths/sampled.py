"""A sampling planner (OMPL's RRTConnect) in three dimensions, each edge tested exactly.

It finds a way where lines of a lattice miss what is free. No other thread of the process runs while OMPL plans, so that
this belongs into a solver's process.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from agents.planner.model.deadline import Deadline
from agents.planner.model.geometry import away, segment_clear
from agents.planner.model.problem import Floats, Path
from agents.planner.model.world import World
from agents.planner.solve.paths.lattice import extent

STEPS = 25
"""of the extent's diagonal in the longest edge"""
SHORTEST = 0.01
"""s"""


def find(world: World, start: Floats, goal: Floats, radius: float, until: Deadline) -> Path | None:
    """A way from start to goal, (3,) each, that keeps ``radius`` everywhere; None: none was found ``until`` then.

    Both ends must be free, or all of the time is spent in vain.
    """
    from ompl import base, geometric, util  # takes long to import and is seldom needed

    util.setLogLevel(util.LOG_NONE)
    low, high = extent(world)
    # The world's box shrunk to what the ends span is no use: a way may lead around. Edges are tested, not sampled.
    space = base.RealVectorStateSpace(3)
    bounds = base.RealVectorBounds(3)
    for axis in range(3):
        bounds.setLow(axis, float(min(low[axis], start[axis], goal[axis])))
        bounds.setHigh(axis, float(max(high[axis], start[axis], goal[axis])))
    space.setBounds(bounds)
    setup = geometric.SimpleSetup(space)
    information = setup.getSpaceInformation()
    setup.setStateValidityChecker(lambda state: _free(world, state, radius))
    information.setMotionValidator(_motions(information, world, radius))
    setup.setStartAndGoalStates(_state(space, start), _state(space, goal))
    chosen = geometric.RRTConnect(information)
    chosen.setRange(float(np.linalg.norm(high - low)) / STEPS)
    setup.setPlanner(chosen)
    while (left := until.left()) > SHORTEST and not setup.haveExactSolutionPath():
        setup.solve(left)  # by the clock; what it knows is kept
    if not setup.haveExactSolutionPath():
        return None
    states = setup.getSolutionPath().getStates()
    return np.array([[state[0], state[1], state[2]] for state in states])


def _state(space: Any, point: Floats) -> Any:
    state = space.allocState()
    for axis in range(3):
        state[axis] = float(point[axis])
    return state


def _free(world: World, state: Any, radius: float) -> bool:
    return bool(away(world, state[0], state[1], state[2], radius, np.empty(3)) <= 0.0)


def _motions(information: Any, world: World, radius: float) -> Any:
    """OMPL's validator of edges; it holds nothing but arrays, for what refers back to OMPL's objects is never freed."""
    from ompl import base

    begin, end = np.empty(3), np.empty(3)

    class ExactMotions(base.MotionValidator):  # type: ignore[misc]
        def checkMotion(self, one: Any, other: Any) -> bool:
            begin[0], begin[1], begin[2] = one[0], one[1], one[2]
            end[0], end[1], end[2] = other[0], other[1], other[2]
            return bool(segment_clear(world, begin, end, radius))

    return ExactMotions(information)
