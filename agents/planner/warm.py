"""Make the planner ready: compile its kernels (once on a machine) and load them (once in a process).

A first plan would otherwise pay for that, some seconds each time and a minute the first time.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from agents.planner.geometry import world_of
from agents.planner.problem import Progress, problem_of
from agents.planner.scene import Bounds, Box, Cylinder, Fence, NoFly, Obstacle, Scene, Vehicle
from agents.planner.solve import solve
from agents.planner.spacetime import deconflict
from agents.planner.staticmap import StaticMap

PACKAGE = Path(__file__).resolve().parent


def compiled() -> bool:
    """Whether any kernels are there, beside their sources or where numba is told to keep them."""
    folders = (PACKAGE, Path(os.environ.get("NUMBA_CACHE_DIR") or PACKAGE))
    return any(next(folder.glob("**/*.nbi"), None) for folder in folders)


def warm(planes: bool = True, progress: Progress | None = None) -> None:
    """Plan small scenes that use every kernel; ``planes``: those of planes, too."""
    tell = progress or (lambda stage, share: None)
    tell("warm up", 0.0)
    copters = example(planes=False)
    solve(copters, seconds=600.0)
    tell("warm up", 0.5)
    # The discrete search is for scenes that are tighter than any that is small.
    problem, static = problem_of(copters), StaticMap(world_of(copters))
    deconflict.find(problem, static.world, static.paths_for(problem), 600.0, np.random.default_rng(0))
    tell("warm up", 0.7)
    if planes:
        solve(example(planes=True), seconds=600.0)
    tell("warm up", 1.0)


def example(planes: bool) -> Scene:
    """Four copters among one of everything, and a rover and a plane besides."""
    vehicles = [
        Vehicle(id=f"v{i}{k}", type="copter", start=(20.0 * i, y, 10.0), goal=(20.0 * i, -y, 10.0), radius=1.0,
                vmax=5.0, amax=2.5)
        for i in range(2) for k, y in enumerate((-15.0, 15.0))
    ]  # fmt: skip
    if planes:
        vehicles = [
            vehicles[0],
            Vehicle(id="r", type="rover", start=(-20.0, -20.0, 1.0), goal=(-20.0, 20.0, 1.0), radius=0.7, vmax=3.0,
                    amax=1.5),
            Vehicle(id="p", type="plane", start=(-150.0, -10.0, 60.0), goal=(150.0, 10.0, 60.0), radius=3.0, vmax=22.0,
                    amax=5.0, vmin=12.0, start_heading_deg=20.0),
        ]  # fmt: skip
    obstacles: list[Obstacle] = [
        Box(min=(-3.0, -2.0, 0.0), max=(3.0, 2.0, 30.0)),
        Cylinder(center=(20.0, 0.0), radius=3.0, floor=0.0, ceiling=30.0),
        NoFly(polygon=[(30.0, -5.0), (35.0, -5.0), (35.0, 5.0)], floor=0.0, ceiling=30.0),
    ]
    room = 200.0 if planes else 60.0
    fence = Fence(polygon=[(-room, -room), (room, -room), (room, room), (-room, room)], floor=0.5, ceiling=90.0)
    bounds = Bounds(min=(-room, -room, 0.0), max=(room, room, 90.0))
    return Scene(vehicles=vehicles, obstacles=obstacles, bounds=bounds, geofence=fence, downwash=1.5)
