"""Single ways: the map's search against OMPL's planners on the same starts and goals, in one run, CPU time.

    python tests/bench/plan_paths.py [--trips 20] [--json]

Scenes: a city of boxes, a forest, a large land with few obstacles, a wall with a window barely wider than the vehicle,
and a slanted slot. "connect" is RRTConnect and then the same shortening as the map's. Times are
medians a trip; ratio is a way's length over the straight line's, of the trips that all found.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable

import numpy as np

from agents.planner.model.deadline import Deadline
from agents.planner.model.geometry import away, segment_clear
from agents.planner.model.problem import Floats, Path
from agents.planner.model.scene import Bounds, Box, Cylinder, NoFly, Obstacle, Scene
from agents.planner.model.staticmap import SWEEPS, StaticMap
from agents.planner.model.world import World, world_of
from agents.planner.solve.paths import sampled, shorten

RADIUS = 1.0
RATES = np.ones(3)
Way = Callable[[Floats, Floats], Path | None]


def city(rng: np.random.Generator) -> Scene:
    """200 houses on a grid of streets, 300 m wide."""
    obstacles: list[Obstacle] = []
    for n in rng.choice(225, 200, replace=False):
        x, y = -140.0 + 20.0 * (n % 15) + rng.uniform(-2, 2), -140.0 + 20.0 * (n // 15) + rng.uniform(-2, 2)
        a, b, high = rng.uniform((4.5, 4.5, 12), (6.5, 6.5, 50))
        obstacles.append(Box(min=(x - a, y - b, 0), max=(x + a, y + b, high)))
    return scene(obstacles, 150.0, 60.0)


def forest(rng: np.random.Generator) -> Scene:
    trees = rng.uniform((-55, -55, 0.8), (55, 55, 2.5), (90, 3))
    return scene([Cylinder(center=(x, y), radius=r, floor=0, ceiling=30) for x, y, r in trees.tolist()], 60.0, 30.0)


def land(rng: np.random.Generator) -> Scene:
    low = rng.uniform((-180, -180), (150, 150), (25, 2)).tolist()
    return scene([Box(min=(x, y, 0), max=(x + 30, y + 30, 40)) for x, y in low], 200.0, 120.0)


def window(rng: np.random.Generator) -> Scene:
    """2.4 m square for a vehicle of 2 m, in a wall across everything."""
    y, z = 17.0, 11.0
    sides = [
        (-60, 0, y - 1.2, 40),
        (y + 1.2, 0, 60, 40),
        (y - 1.2, 0, y + 1.2, z - 1.2),
        (y - 1.2, z + 1.2, y + 1.2, 40),
    ]
    return scene([Box(min=(-1, a, b), max=(1, c, d)) for a, b, c, d in sides], 60.0, 40.0)


def slot(rng: np.random.Generator) -> Scene:
    """2.6 m wide for a vehicle of 2 m, in a wall that runs slantwise across 400 m."""
    along, across = np.array([np.cos(0.54), np.sin(0.54)]), np.array([-np.sin(0.54), np.cos(0.54)])
    walls: list[Obstacle] = []
    for begin, end in ((-400.0, 17.0), (19.6, 400.0)):
        ring = np.array([u * along + v * across for u, v in ((begin, -1), (end, -1), (end, 1), (begin, 1))]).tolist()
        walls.append(NoFly(polygon=[(x, y) for x, y in ring], floor=0, ceiling=120))
    return scene(walls, 200.0, 120.0)


def scene(obstacles: list[Obstacle], half: float, high: float) -> Scene:
    return Scene(vehicles=[], obstacles=obstacles, bounds=Bounds(min=(-half, -half, 0), max=(half, half, high)))


def trips_of(world: World, count: int, rng: np.random.Generator) -> list[Floats]:
    """Starts and goals, (2, 3) each, that are free, far apart and do not see each other."""
    low, high = world.bounds[:3] + 2.0, world.bounds[3:] - 2.0
    high[2] = min(high[2], 45.0)
    trips: list[Floats] = []
    while len(trips) < count:
        ends = rng.uniform(low, high, (2, 3))
        if np.linalg.norm(ends[1] - ends[0]) > (high[0] - low[0]) / 2.0:
            free = all(away(world, end[0], end[1], end[2], 1.5 * RADIUS, np.empty(3)) == 0.0 for end in ends)
            if free and not segment_clear(world, ends[0], ends[1], RADIUS):
                trips.append(ends)
    return trips


def measure(find: Way, trips: list[Floats]) -> tuple[list[float], list[float]]:
    """s and ratio (inf: not found) of each trip."""
    seconds, ratios = [], []
    for start, goal in trips:
        begun = time.process_time()
        way = find(start, goal)
        seconds.append(time.process_time() - begun)
        length = np.inf if way is None else np.linalg.norm(np.diff(way, axis=0), axis=1).sum()
        ratios.append(float(length / np.linalg.norm(goal - start)))
    return seconds, ratios


def sides_of(world: World) -> dict[str, Way]:
    static = StaticMap(world)

    def connect(start: Floats, goal: Floats) -> Path | None:
        way = sampled.find(world, start, goal, RADIUS, Deadline.after(1.0))
        return None if way is None else shorten.shorten(world, way, RADIUS, RATES, SWEEPS)

    return {
        "map": lambda start, goal: static.path(start, goal, RADIUS),
        "connect": connect,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trips", type=int, default=20)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rows = []
    for make in (city, forest, land, window, slot):
        rng = np.random.default_rng(1)
        world = world_of(make(rng))
        trips = trips_of(world, options.trips if make is not slot else max(3, options.trips // 4), rng)
        for find in sides_of(world).values():
            measure(find, trips[:1])  # compile and load before anything is timed
        found = {name: measure(find, trips) for name, find in sides_of(world).items()}
        both = [n for n in range(len(trips)) if all(np.isfinite(ratios[n]) for _, ratios in found.values())]
        for name, (seconds, ratios) in found.items():
            row = {
                "scene": make.__name__,
                "planner": name,
                "found": float(np.isfinite(ratios).mean()),
                "median_ms": 1e3 * statistics.median(seconds),
                "worst_ms": 1e3 * max(seconds),
                "ratio": statistics.fmean(ratios[n] for n in both) if both else None,
            }
            rows.append(row)
            if not options.json:
                ratio = "-" if row["ratio"] is None else f"{row['ratio']:.3f}"
                times = f"{row['median_ms']:8.1f} ms, worst {row['worst_ms']:7.1f} ms"
                print(
                    f"{make.__name__:8} {name:9} found {row['found']:4.0%}  {times}  length ratio {ratio}", flush=True
                )
    if options.json:
        print(json.dumps(rows))


if __name__ == "__main__":
    main()
