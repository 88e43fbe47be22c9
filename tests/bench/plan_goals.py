"""What goals come down to, how long that takes, and how well it is flown; every row judged by the verifier.

    python -m tests.bench.plan_goals [--pictures FOLDER]

Formations fly 180 m in the open. The error of their shape is the RMS distance from the ideal one, moved and turned to
fit best; "over" is the flight's time over that of a straight line at full speed. Searches sweep an L-shaped field, and
a hexagon with three obstacles, with equal copters and with mixed ones of three widths and two speeds; the balance is
the longest part over the mean.
Planning times are CPU time of this process, kernels compiled.
"""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path

import numpy as np

from agents.planner.goals import formation, sweeping
from agents.planner.goals.goals import resolve
from agents.planner.goals.search import ground as ground_of
from agents.planner.goals.search import split
from agents.planner.goals.steps import FleetView, Fly
from agents.planner.model.geometry import world_of
from agents.planner.model.scene import Box, Cylinder, NoFly, Obstacle, Scene
from agents.planner.model.staticmap import StaticMap
from tests.agents.planner.goals.team import balance, ground, judge_fly, lasting, shape_error, team, view
from zmav import wire
from zmav.wire.swarm import Corner, Shape

SHAPES: list[tuple[Shape, int]] = [
    ("line", 7),
    ("vee", 9),
    ("column", 8),
    ("circle", 12),
    ("grid", 16),
    ("grid", 36),
    ("vee", 21),
    ("grid", 64),
    ("grid", 256),
]
SPEED, ACCEL = 5.0, 2.5
ELL: list[Corner] = [(0.0, 0.0), (200.0, 0.0), (200.0, 80.0), (80.0, 80.0), (80.0, 200.0), (0.0, 200.0)]
HEXAGON: list[Corner] = [
    (100.0 + 100.0 * math.cos(0.3 + k * math.pi / 3.0), 100.0 + 100.0 * math.sin(0.3 + k * math.pi / 3.0))
    for k in range(6)
]
HOLES: list[Obstacle] = [
    NoFly(polygon=[(80.0, 80.0), (120.0, 90.0), (110.0, 130.0), (70.0, 120.0)], floor=0.0, ceiling=60.0),
    Cylinder(center=(40.0, 150.0), radius=12.0, floor=0.0, ceiling=60.0),
    Box(min=(150.0, 60.0, 0.0), max=(165.0, 80.0, 60.0)),
]


def timed(goal: wire.swarm.Goal, fleet: FleetView, world: Scene, static: StaticMap) -> tuple[float, Fly | None]:
    began = time.process_time()
    steps = resolve(goal, fleet, world, static)
    took = time.process_time() - began
    return took, next((step for step in steps if isinstance(step, Fly)), None)


def verdict(fly: Fly, fleet: FleetView, world: Scene) -> str:
    report = judge_fly(fly, fleet, world)
    return f"{report.clearance:9.2f}  {'verified' if report.ok else 'REFUSED: ' + report.faults[0].text}"


def formations() -> None:
    print(
        f"{'formation':12} {'N':>4} {'plan s':>7} {'flight s':>9} {'over':>5}  {'error m':>7} {'narrow':>7}   clear m"
    )
    for shape, count in SHAPES:
        fleet, world = team(count, apart=6.0), ground()
        static = StaticMap(world_of(world))
        goal = wire.swarm.Formation(
            vehicles=list(fleet.vehicles), shape=shape, at=(0.0, 90.0, -25.0), via=[(0.0, -90.0, -25.0)], heading=1.57
        )
        took, fly = timed(goal, fleet, world, static)
        label = f"{shape:12} {count:4} {took:7.2f}"
        if fly is None:
            print(f"{label}  not in shape")
            continue
        offsets = formation.offsets_of(goal, count)
        tracks = np.stack([motion[:, 1:] for motion in fly.motions.values()], axis=1)
        slots = formation.placed(offsets, np.array([-90.0, 0.0, 25.0]), 0.0)
        order = np.argmin(np.linalg.norm(tracks[0][None] - slots[:, None], axis=2), axis=1)
        errors = shape_error(offsets, tracks[:, order])
        whole, far = errors < 0.1, np.abs(tracks[:, :, 0].mean(axis=1)) > 60.0
        bound = 180.0 / SPEED + SPEED / ACCEL
        print(
            f"{label} {lasting(fly):9.1f} {lasting(fly) / bound:5.2f} {errors[far].max():8.4f} "
            f"{100.0 * (1.0 - whole.mean()):6.0f}% {verdict(fly, fleet, world)}"
        )


def searchers(count: int, mixed: bool) -> FleetView:
    if not mixed:
        return team(count)
    views = [
        view(
            f"v{i:03}",
            (-40.0 - 5.0 * (i // 8), -40.0 + 5.0 * (i % 8), -10.0),
            sweep_width=10.0 * (1 + i % 3),
            speed=5.0 + 3.0 * (i % 2),
        )
        for i in range(count)
    ]
    return FleetView({each.name: each for each in views})


def searches(folder: Path | None) -> None:
    print(f"\n{'search':18} {'N':>4} {'plan s':>7} {'flight s':>9} {'seen %':>7} {'balance':>8} {'clear m':>9}")
    for name, polygon, obstacles in (("L", ELL, []), ("hexagon, 3 holes", HEXAGON, HOLES)):
        world = ground(obstacles)
        static = StaticMap(world_of(world))
        for count in (1, 4, 8, 20):
            for mixed in (False, True) if count > 1 else (False,):
                fleet = searchers(count, mixed)
                goal = wire.swarm.Search(
                    vehicles=list(fleet.vehicles), polygon=[(y, x) for x, y in polygon], height=20.0
                )
                took, fly = timed(goal, fleet, world, static)
                assert fly is not None
                sweepers = sweeping.sweepers_of(goal, list(fleet.vehicles.values()))
                dealt = split(ground_of(polygon, world, (20.0, 20.0), 1.0), sweepers, goal.overlap, None)
                print(
                    f"{name + (' mixed' if mixed else ''):18.18} {count:4} {took:7.2f} {lasting(fly):9.1f} "
                    f"{100.0 * dealt.covered:7.2f} {balance(dealt.parts):8.3f} {verdict(fly, fleet, world)}"
                )
                if folder is not None and count == 4 and obstacles and mixed:
                    draw_search(folder / "search.png", polygon, obstacles, fleet, fly)


def draw_search(path: Path, polygon: list[Corner], obstacles: list[Obstacle], fleet: FleetView, fly: Fly) -> None:
    """Parts of a search, a colour each, with the width that each vehicle sees."""
    import shapely
    from matplotlib.figure import Figure

    from agents.planner.goals.search import footprint

    figure = Figure(figsize=(6.0, 5.2), layout="constrained")
    axes = figure.add_subplot()
    axes.fill(*zip(*polygon, strict=True), facecolor="none", edgecolor="0.2", lw=1.5)
    for k, (name, motion) in enumerate(fly.motions.items()):
        body = fleet.vehicles[name].body
        strip = shapely.LineString(motion[:, 1:3]).buffer(body.sweep_width / 2.0, cap_style="flat")
        for piece in shapely.get_parts(strip):
            axes.fill(*piece.exterior.xy, color=f"C{k}", alpha=0.15, lw=0.0)
        label = f"{name}: {body.sweep_width:.0f} m wide, {body.speed:.0f} m/s, {motion[-1, 0]:.0f} s"
        axes.plot(motion[:, 1], motion[:, 2], color=f"C{k}", lw=1.3, label=label)
        axes.plot(*motion[0, 1:3], "o", color=f"C{k}", ms=5)
    for obstacle in obstacles:
        axes.fill(*footprint(obstacle).exterior.xy, color="0.35")
    axes.set(xlabel="east, m", ylabel="north, m", aspect="equal")
    figure.legend(fontsize=7, loc="outside lower center", ncols=2)
    figure.savefig(path, dpi=90)


def main() -> None:
    folder = Path(sys.argv[sys.argv.index("--pictures") + 1]) if "--pictures" in sys.argv else None
    warm = team(2)
    resolve(wire.swarm.Formation(vehicles=list(warm.vehicles), shape="line", at=(9.0, 9.0, -9.0)), warm, ground())
    formations()
    searches(folder)


if __name__ == "__main__":
    main()
