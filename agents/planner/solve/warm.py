"""Make the planner ready: compile its kernels (once on a machine) and load them (once in a process).

A first plan would otherwise pay for that, some seconds each time and a minute the first time.
"""

from __future__ import annotations

import numpy as np

from agents.planner.model.geometry import world_of
from agents.planner.model.plans import Plan
from agents.planner.model.problem import problem_of
from agents.planner.model.scene import Bounds, Box, Cylinder, Fence, NoFly, Obstacle, Point, Scene, Vehicle
from agents.planner.model.staticmap import StaticMap
from agents.planner.solve import jit
from agents.planner.solve.pipeline import solve
from agents.planner.solve.spacetime import deconflict

PATIENCE = 600.0
"""s, for a slow machine that compiles"""


def warm(planes: bool = True) -> Plan:
    """Plan small scenes that use the kernels; gives the plan of the first.

    ``planes``: those of planes, too. Where they are not all compiled yet, all of them are, also what few scenes need.
    """
    with jit.compiling() as everything:
        copters = example(planes=False)
        plan = solve(copters, seconds=PATIENCE)
        # The discrete search is for scenes that are tighter than any that is small.
        for scene in (copters, lane()) if everything else (copters,):
            problem, static = problem_of(scene), StaticMap(world_of(scene))
            deconflict.find(problem, static.world, static.paths_for(problem), PATIENCE, np.random.default_rng(0))
        if planes or everything:
            solve(example(planes=True), seconds=PATIENCE)
    return plan


def copter(name: str, start: Point, goal: Point) -> Vehicle:
    return Vehicle(id=name, type="copter", start=start, goal=goal, radius=1.0, vmax=5.0, amax=2.5)


def lane() -> Scene:
    """Two that change places where there is room to pass only in one spot."""
    vehicles = [copter("a", (-20.0, 0.0, 5.0), (20.0, 0.0, 5.0)), copter("b", (20.0, 0.0, 5.0), (-20.0, 0.0, 5.0))]
    walls: list[Obstacle] = [
        Box(min=(x, y, 0.0), max=(x + 17.0, y + 8.0, 10.0)) for x in (-20.0, 3.0) for y in (-9.5, 1.5)
    ]
    bounds = Bounds(min=(-26.0, -8.0, 4.0), max=(26.0, 8.0, 6.0))
    return Scene(vehicles=vehicles, obstacles=walls, bounds=bounds, downwash=1.5)


def example(planes: bool) -> Scene:
    """Four copters among one of everything; or one, a rover, and two planes with a tower in their way."""
    vehicles = [
        copter(f"v{i}{k}", (20.0 * i, y, 10.0), (20.0 * i, -y, 10.0))
        for i in range(2)
        for k, y in enumerate((-15.0, 15.0))
    ]
    obstacles: list[Obstacle] = [
        Box(min=(-3.0, -2.0, 0.0), max=(3.0, 2.0, 30.0)),
        Cylinder(center=(20.0, 0.0), radius=3.0, floor=0.0, ceiling=30.0),
        NoFly(polygon=[(30.0, -5.0), (35.0, -5.0), (35.0, 5.0)], floor=0.0, ceiling=30.0),
    ]
    if planes:
        rover = Vehicle(
            id="r", type="rover", start=(-20.0, -20.0, 1.0), goal=(-20.0, 20.0, 1.0), radius=0.7, vmax=3.0, amax=1.5
        )
        wings = [
            Vehicle(
                id=f"p{k}",
                type="plane",
                start=(-150.0 * way, 0.0, 60.0),
                goal=(150.0 * way, 0.0, 60.0),
                radius=3.0,
                vmax=22.0,
                amax=5.0,
                vmin=12.0,
                start_heading_deg=20.0 + 180.0 * k,
            )
            for k, way in enumerate((1.0, -1.0))
        ]
        vehicles = [vehicles[0], rover, *wings]
        obstacles.append(Box(min=(-40.0, -90.0, 40.0), max=(40.0, 90.0, 90.0)))
    room = 200.0 if planes else 60.0
    fence = Fence(polygon=[(-room, -room), (room, -room), (room, room), (-room, room)], floor=0.5, ceiling=90.0)
    bounds = Bounds(min=(-room, -room, 0.0), max=(room, room, 90.0))
    return Scene(vehicles=vehicles, obstacles=obstacles, bounds=bounds, geofence=fence, downwash=1.5)
