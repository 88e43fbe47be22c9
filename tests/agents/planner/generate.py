"""Scenes of every class, from a seed: ``python -m tests.agents.planner.generate city 100 --seed 3 -o city100.json``.

The vehicles are those of the example files (radius 1 m, 5 m/s, 2.5 m/s²) unless ``scale="lab"``: then everything is
that of small indoor copters (0.15 m, 1 m/s, 2 m/s²). Every scene of :data:`CLASSES` has a solution.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import click
import msgspec
import numpy as np

from agents.planner.model.scene import Box, Cylinder, Fence, NoFly, Obstacle, Scene, Vehicle
from tests.agents.planner.scenery import (
    DOWNWASH,
    SIZE,
    Places,
    Scale,
    box,
    grid,
    limited,
    point,
    room,
    scatter,
    scene_of,
    xy,
)


def swap_circle(n: int, seed: int = 0, *, scale: Scale = "field", spacing: float = 5.0) -> Scene:
    """Everybody to the opposite point of a level circle; neighbours are ``spacing`` radii apart or more."""
    unit = SIZE[scale]
    ring = max(20.0, n * spacing / math.tau) * unit
    angle = np.arange(n) / n * math.tau + np.random.default_rng(seed).uniform(0.0, math.tau) * (seed > 0)
    start = np.column_stack((ring * np.cos(angle), ring * np.sin(angle), np.full(n, 20.0 * unit)))
    goal = start * [-1.0, -1.0, 1.0]
    wide = ring + 15.0 * unit
    return scene_of("swap_circle", seed, start, goal, room(-wide, -wide, 5.0 * unit, wide, wide, 40.0 * unit), scale)


def swap_sphere(n: int, seed: int = 0, *, scale: Scale = "field", spacing: float = 5.0) -> Scene:
    """Everybody to the opposite point of a sphere."""
    unit = SIZE[scale]
    ball = max(15.0, spacing * math.sqrt(n) / 3.0) * unit
    # An odd spiral has no two opposite points in it, so that no goal is a start.
    k = np.arange(n) + 0.5
    height, angle = 1.0 - 2.0 * k / n, math.pi * (1.0 + math.sqrt(5.0)) * k + 0.1 * seed
    flat = np.sqrt(1.0 - height**2)
    unit_ball = np.column_stack((flat * np.cos(angle), flat * np.sin(angle), height))
    wide, middle = ball + 15.0 * unit, np.array([0.0, 0.0, ball + 20.0 * unit])
    start, goal = middle + ball * unit_ball, middle - ball * unit_ball
    tall = 2.0 * ball + 40.0 * unit
    return scene_of("swap_sphere", seed, start, goal, room(-wide, -wide, 0.0, wide, wide, tall), scale)


def swap_field(n: int, seed: int = 0, *, scale: Scale = "field") -> Scene:
    """Two blocks at two ends of a field change places; who goes where is drawn by lot."""
    unit, rng = SIZE[scale], np.random.default_rng(seed)
    half = n // 2
    block = grid(n - half, 5.0 * unit)
    away = np.array([30.0 * unit + np.ptp(block[:, 0]), 0.0, 20.0 * unit])
    left, right = block - [away[0], 0.0, -away[2]], block[:half] + away
    start = np.concatenate((left, right))
    ends = np.concatenate((rng.permutation(left)[:half], rng.permutation(block + away)[: n - half]))
    goal = np.concatenate((ends[half:], ends[:half]))
    x, y = np.abs(start[:, 0]).max() + 10.0 * unit, np.abs(start[:, 1]).max() + 15.0 * unit
    return scene_of("swap_field", seed, start, goal, room(-x, -y, 0.0, x, y, 40.0 * unit), scale)


def shuffle(n: int, seed: int = 0, *, scale: Scale = "field", spacing: float = 4.5) -> Scene:
    """A dense level grid in which everybody gets another's place."""
    unit, rng = SIZE[scale], np.random.default_rng(seed)
    start = grid(n, spacing * unit, 20.0 * unit)
    goal = start[rng.permutation(n)]
    wide = np.abs(start[:, :2]).max() + 15.0 * unit
    return scene_of("shuffle", seed, start, goal, room(-wide, -wide, 0.0, wide, wide, 40.0 * unit), scale)


Shape = Literal["ring", "vee", "line", "sphere", "grid"]


def formation(n: int, seed: int = 0, *, scale: Scale = "field", shape: Shape = "ring", labelled: bool = False) -> Scene:
    """From a grid to another shape; labelled: drawn by lot."""
    unit = SIZE[scale]
    start = grid(n, 5.0 * unit, 20.0 * unit)
    goal = _shape(shape, n, 5.0 * unit, 20.0 * unit)
    goal = goal[np.random.default_rng(seed).permutation(n)]
    both = np.abs(np.concatenate((start, goal)))
    x, y = both[:, 0].max() + 15.0 * unit, both[:, 1].max() + 15.0 * unit
    tall = max(60.0 * unit, both[:, 2].max() + 15.0 * unit)
    name = f"formation_{shape}" + ("" if labelled else "_unlabelled")
    return scene_of(name, seed, start, goal, room(-x, -y, 0.0, x, y, tall), scale, labelled=labelled)


def _shape(shape: Shape, n: int, step: float, height: float) -> Places:
    k = np.arange(n)
    if shape == "ring":
        ring, angle = max(step, n * step / math.tau), k / n * math.tau
        return np.column_stack((ring * np.cos(angle), ring * np.sin(angle), np.full(n, height)))
    if shape == "line":
        return np.column_stack(((k - (n - 1) / 2.0) * step, np.zeros(n), np.full(n, height)))
    if shape == "vee":
        back, side = (k + 1) // 2, np.where(k % 2, 1.0, -1.0)
        return np.column_stack(((n / 4.0 - back) * step * 0.8, side * back * step * 0.8, np.full(n, height)))
    if shape == "grid":
        return grid(n, step * 0.9, height + 2.0 * step)
    ball = max(2.0 * step, step * math.sqrt(n) / 2.5)
    level, spiral = 1.0 - 2.0 * (k + 0.5) / n, math.pi * (1.0 + math.sqrt(5.0)) * k
    flat = np.sqrt(1.0 - level**2)
    middle = max(height, ball * DOWNWASH + step)
    x, y = ball * flat * np.cos(spiral), ball * flat * np.sin(spiral)
    return np.column_stack((x, y, middle + DOWNWASH * ball * level))


def formation_labelled(n: int, seed: int = 0, *, scale: Scale = "field") -> Scene:
    return formation(n, seed, scale=scale, shape="grid", labelled=True)


def formation_vee(n: int, seed: int = 0, *, scale: Scale = "field") -> Scene:
    return formation(n, seed, scale=scale, shape="vee", labelled=True)


def formation_sphere(n: int, seed: int = 0, *, scale: Scale = "field") -> Scene:
    return formation(n, seed, scale=scale, shape="sphere")


def forest(n: int, seed: int = 0, *, scale: Scale = "field", trees: int = 60) -> Scene:
    """From anywhere to anywhere between trees as high as the room."""
    unit, rng = SIZE[scale], np.random.default_rng(seed)
    wide, tall = 60.0 * unit, 30.0 * unit
    obstacles: list[Obstacle] = []
    for _ in range(trees):
        x, y = rng.uniform(-wide + 3.0 * unit, wide - 3.0 * unit, 2)
        obstacles.append(
            Cylinder(center=xy(x, y), radius=round(rng.uniform(1.0, 2.5) * unit, 3), floor=0.0, ceiling=tall)
        )
    bounds = room(-wide, -wide, 0.0, wide, wide, tall)
    start = scatter(n, rng, bounds, obstacles, unit, low=4.0 * unit, high=26.0 * unit)
    goal = scatter(n, rng, bounds, obstacles, unit, low=4.0 * unit, high=26.0 * unit)
    return scene_of("forest", seed, start, goal, bounds, scale, obstacles)


def gate(n: int, seed: int = 0, *, opposing: bool = False, walls: int = 1, window: float = 5.0) -> Scene:
    """Through a window in a wall (or one wall after another), from one side or from both at once."""
    rng = np.random.default_rng(seed)
    obstacles: list[Obstacle] = []
    reach = 8.0 * (walls - 1)
    for wall in range(walls):
        x = -reach + 16.0 * wall
        aside = 0.0 if walls == 1 else rng.uniform(-10.0, 10.0)
        obstacles += _wall(round(x, 3), round(aside, 3), 10.0, window, 40.0, 24.0)
    rows = math.ceil((n / 2 if opposing else n) / 5)
    k = np.arange(rows * 5)
    queue = np.column_stack((-20.0 - reach - 5.0 * (k // 5), 5.0 * (k % 5) - 10.0, np.full(len(k), 10.0)))
    mirror = queue * [-1.0, 1.0, 1.0]
    if opposing:
        half = n // 2
        start = np.concatenate((queue[: n - half], mirror[:half]))
        goal = np.concatenate((rng.permutation(mirror)[: n - half], rng.permutation(queue)[:half]))
    else:
        start, goal = queue[:n], mirror[:n] if seed == 0 else rng.permutation(mirror[:n])
    long = max(60.0, np.abs(start[:, 0]).max() + 10.0, np.abs(goal[:, 0]).max() + 10.0)
    name = ("gate_opposing" if opposing else "gate_oneway") + ("" if walls == 1 else f"_{walls}")
    return scene_of(name, seed, start, goal, room(-long, -40.0, 0.0, long, 40.0, 24.0), "field", obstacles)


def _wall(x: float, y: float, z: float, window: float, wide: float, tall: float) -> list[Obstacle]:
    """Four boxes about a square window at y, z."""
    low, high, under, over = (round(v, 3) for v in (y - window / 2, y + window / 2, z - window / 2, z + window / 2))
    return [
        Box(min=(x - 1.0, -wide, 0.0), max=(x + 1.0, low, tall)),
        Box(min=(x - 1.0, high, 0.0), max=(x + 1.0, wide, tall)),
        Box(min=(x - 1.0, low, 0.0), max=(x + 1.0, high, under)),
        Box(min=(x - 1.0, low, over), max=(x + 1.0, high, tall)),
    ]


def gate_opposing(n: int, seed: int = 0) -> Scene:
    return gate(n, seed, opposing=True)


def gates(n: int, seed: int = 0) -> Scene:
    return gate(n, seed, opposing=True, walls=3)


def windows(n: int, seed: int = 0) -> Scene:
    """Three walls with a window each that one vehicle just passes, and none behind another."""
    rows = math.ceil(n / 5)
    obstacles: list[Obstacle] = []
    for x, aside in ((-12.0, -8.0), (0.0, 8.0), (12.0, -8.0)):
        obstacles += _wall(x, aside, 10.0, 2.6, 40.0, 24.0)
    k = np.arange(n)
    start = np.column_stack((-32.0 - 5.0 * (k // 5), 5.0 * (k % 5) - 10.0, np.full(n, 10.0)))
    mirror = start * [-1.0, 1.0, 1.0]
    goal = mirror if seed == 0 else np.random.default_rng(seed).permutation(mirror)
    long = 40.0 + 5.0 * rows
    return scene_of("windows", seed, start, goal, room(-long, -40.0, 0.0, long, 40.0, 24.0), "field", obstacles)


def tunnel(n: int, seed: int = 0) -> Scene:
    """Two groups change ends of a tunnel in which nobody can pass but in a bay half-way."""
    long, half = 20.0, n // 2
    obstacles: list[Obstacle] = []
    for side in (-1.0, 1.0):
        for x0, x1 in ((-long, -5.0), (5.0, long)):
            obstacles.append(box(x0, side * 1.6, 0.0, x1, side * 30.0, 12.0))
        obstacles.append(box(-5.0, side * 8.0, 0.0, 5.0, side * 30.0, 12.0))
    obstacles += [
        Box(min=(-long, -30.0, 0.0), max=(long, 30.0, 4.0)),
        Box(min=(-long, -30.0, 8.0), max=(long, 30.0, 12.0)),
    ]
    k = np.arange(n - half)
    queue = np.column_stack((-long - 6.0 - 5.0 * (k // 5), 5.0 * (k % 5) - 10.0, np.full(n - half, 6.0)))
    mirror = queue * [-1.0, 1.0, 1.0]
    start = np.concatenate((queue, mirror[:half]))
    goal = np.concatenate((mirror, queue[:half]))
    end = np.abs(start[:, 0]).max() + 10.0
    return scene_of("tunnel", seed, start, goal, room(-end, -30.0, 0.0, end, 30.0, 12.0), "field", obstacles)


def city(n: int, seed: int = 0, *, boxes: int = 200) -> Scene:
    """Blocks of houses in rows of streets and three zones where nobody may fly."""
    rng = np.random.default_rng(seed)
    rows = math.ceil(math.sqrt(boxes))
    wide, tall = 150.0, 60.0
    step = 2.0 * (wide - 2.0) / rows
    cells = rng.permutation(rows * rows)[:boxes]
    obstacles: list[Obstacle] = []
    for cell in sorted(cells):
        x, y = (np.array(divmod(int(cell), rows)) + 0.5) * step - wide + 2.0
        a, b, height = rng.uniform(4.5, 6.5), rng.uniform(4.5, 6.5), rng.uniform(12.0, 50.0)
        obstacles.append(box(x - a, y - b, 0.0, x + a, y + b, height))
    for floor, ceiling in ((0.0, tall), (15.0, tall), (0.0, 35.0)):
        x, y = rng.uniform(-90.0, 90.0, 2)
        obstacles.append(NoFly(polygon=_blob(rng, x, y, rng.uniform(15.0, 32.0)), floor=floor, ceiling=ceiling))
    bounds = room(-wide, -wide, 0.0, wide, wide, tall)
    start = scatter(n, rng, bounds, obstacles, 1.0, low=5.0, high=45.0)
    goal = scatter(n, rng, bounds, obstacles, 1.0, low=5.0, high=45.0)
    return scene_of("city", seed, start, goal, bounds, "field", obstacles)


def _blob(rng: np.random.Generator, x: float, y: float, size: float) -> list[tuple[float, float]]:
    corners = int(rng.integers(5, 9))
    angle = np.sort((np.arange(corners) + rng.uniform(-0.3, 0.3, corners)) / corners * math.tau)
    reach = size * rng.uniform(0.6, 1.0, corners)
    return [xy(x + r * math.cos(a), y + r * math.sin(a)) for a, r in zip(angle, reach, strict=True)]


def fence(n: int, seed: int = 0, *, kind: Literal["L", "U", "layers"] = "L") -> Scene:
    """Round a corner (L), round two (U), or through a low room with ceilings and floors in the way (layers)."""
    rng = np.random.default_rng(seed)
    bounds = room(-60.0, -60.0, 0.0, 60.0, 60.0, 40.0)
    obstacles: list[Obstacle] = []
    k = np.arange(n)
    first = np.column_stack((48.0 - 5.0 * (k % 5), -25.0 - 7.0 * (k // 5 % 4), 10.0 + 6.0 * (k // 20)))
    if kind == "L":
        polygon = [(-55.0, -55.0), (55.0, -55.0), (55.0, -15.0), (-15.0, -15.0), (-15.0, 55.0), (-55.0, 55.0)]
        limits, goal = Fence(polygon=polygon, floor=2.0, ceiling=35.0), first[:, [1, 0, 2]]
    elif kind == "U":
        polygon = [
            (-55.0, -55.0),
            (55.0, -55.0),
            (55.0, 55.0),
            (15.0, 55.0),
            (15.0, -15.0),
            (-15.0, -15.0),
            (-15.0, 55.0),
            (-55.0, 55.0),
        ]
        first = np.column_stack((48.0 - 5.0 * (k % 5), 48.0 - 6.0 * (k // 5 % 5), 10.0 + 6.0 * (k // 25)))
        limits, goal = Fence(polygon=polygon, floor=2.0, ceiling=35.0), first * np.array([-1.0, 1.0, 1.0])
    else:
        polygon = [(-55.0, -55.0), (55.0, -55.0), (55.0, 55.0), (-55.0, 55.0)]
        limits, goal = Fence(polygon=polygon, floor=3.0, ceiling=25.0), first * [-1.0, -1.0, 1.0]
        obstacles = [
            NoFly(polygon=[(-40.0, -12.0), (40.0, -12.0), (40.0, 0.0), (-40.0, 0.0)], floor=0.0, ceiling=16.0),
            NoFly(polygon=[(-40.0, 3.0), (40.0, 3.0), (40.0, 12.0), (-40.0, 12.0)], floor=12.0, ceiling=40.0),
        ]
    goal = goal if seed == 0 else rng.permutation(goal)
    return scene_of(f"fence_{kind}", seed, first, goal, bounds, "field", obstacles, geofence=limits)


def fence_u(n: int, seed: int = 0) -> Scene:
    return fence(n, seed, kind="U")


def fence_layers(n: int, seed: int = 0) -> Scene:
    return fence(n, seed, kind="layers")


def mixed(n: int, seed: int = 0, *, planes: int | None = None, rovers: int | None = None) -> Scene:
    """Copters low, rovers between houses and planes above, across a square of 400 m."""
    rng = np.random.default_rng(seed)
    planes = n // 6 if planes is None else planes
    rovers = n // 3 if rovers is None else rovers
    obstacles: list[Obstacle] = []
    for _ in range(25):
        x, y = rng.uniform(-120.0, 120.0, 2)
        a, b = rng.uniform(6.0, 18.0, 2)
        obstacles.append(box(x - a, y - b, 0.0, x + a, y + b, rng.uniform(7.0, 28.0)))
    zone = [(-40.0, 60.0), (40.0, 60.0), (30.0, 120.0), (-30.0, 120.0)]
    obstacles.append(NoFly(polygon=zone, floor=0.0, ceiling=120.0))
    bounds = room(-200.0, -200.0, 0.0, 200.0, 200.0, 120.0)
    copters = n - planes - rovers
    start = scatter(copters, rng, bounds, obstacles, 1.0, low=5.0, high=36.0)
    goal = scatter(copters, rng, bounds, obstacles, 1.0, low=5.0, high=36.0)
    vehicles = [
        Vehicle(
            id=f"c{k:03d}",
            type="copter",
            start=point(start[k]),
            goal=point(goal[k]),
            radius=1.0,
            vmax=5.0,
            amax=2.5,
            vz_up=2.5,
            vz_down=1.5,
        )
        for k in range(copters)
    ]
    start = scatter(rovers, rng, bounds, obstacles, 1.0, low=0.0, high=0.0)
    goal = scatter(rovers, rng, bounds, obstacles, 1.0, low=0.0, high=0.0)
    vehicles += [
        Vehicle(
            id=f"r{copters + k:03d}",
            type="rover",
            start=point(start[k]),
            goal=point(goal[k]),
            radius=0.7,
            vmax=3.0,
            amax=1.5,
        )
        for k in range(rovers)
    ]
    vehicles += [_plane(rng, copters + rovers + k, k) for k in range(planes)]
    found = Scene(name=f"mixed_n{n:03d}_s{seed}", vehicles=vehicles, obstacles=obstacles, bounds=bounds, downwash=1.5)
    return limited(found)


def _plane(rng: np.random.Generator, number: int, k: int) -> Vehicle:
    """From one side to the other, towards the goal at first; on a level of its own by 6 m where it starts."""
    angle = rng.uniform(0.0, math.tau)
    height = 62.0 + 6.0 * (k % 8)
    start = 165.0 * np.array([math.cos(angle), math.sin(angle)])
    turn = angle + math.pi + rng.uniform(-0.6, 0.6)
    goal = 165.0 * np.array([math.cos(turn), math.sin(turn)])
    heading = math.degrees(math.atan2(*(goal - start)[::-1]))
    ends = [point(np.array([*place, height + rng.uniform(-1.0, 1.0)])) for place in (start, goal)]
    return Vehicle(
        id=f"p{number:03d}",
        type="plane",
        start=ends[0],
        goal=ends[1],
        radius=3.0,
        vmax=22.0,
        amax=5.0,
        vmin=12.0,
        vz_up=3.0,
        vz_down=3.0,
        start_heading_deg=round(heading, 3),
    )


def crowd(n: int, seed: int = 0, *, scale: Scale = "lab") -> Scene:
    """Anywhere to anywhere in a small empty room: 60 in 3 x 3 x 2 m is what the literature's hardest rows have."""
    unit, rng = SIZE[scale], np.random.default_rng(seed)
    side = max(10.0, 20.0 * (n / 60.0) ** (1.0 / 3.0)) * unit
    bounds = room(-side / 2, -side / 2, 0.0, side / 2, side / 2, side)
    start = scatter(n, rng, bounds, [], unit, low=unit, high=side - unit)
    goal = scatter(n, rng, bounds, [], unit, low=unit, high=side - unit)
    return scene_of("crowd", seed, start, goal, bounds, scale)


CLASSES: dict[str, Callable[..., Scene]] = {
    "swap_circle": swap_circle,
    "swap_sphere": swap_sphere,
    "swap_field": swap_field,
    "shuffle": shuffle,
    "crowd": crowd,
    "formation": formation,
    "formation_sphere": formation_sphere,
    "formation_labelled": formation_labelled,
    "formation_vee": formation_vee,
    "forest": forest,
    "gate": gate,
    "gate_opposing": gate_opposing,
    "gates": gates,
    "windows": windows,
    "tunnel": tunnel,
    "city": city,
    "fence": fence,
    "fence_u": fence_u,
    "fence_layers": fence_layers,
    "mixed": mixed,
}


def as_json(scene: Scene, **more: Any) -> dict[str, Any]:
    """As in a scene file, without fields that have nothing in them."""
    body = msgspec.to_builtins(scene)
    body["vehicles"] = [{k: v for k, v in each.items() if v is not None} for each in body["vehicles"]]
    return {**{k: v for k, v in body.items() if v is not None}, "expect": "solvable", **more}


@click.command()
@click.argument("kind", type=click.Choice(sorted(CLASSES)))
@click.argument("n", type=click.IntRange(min=1))
@click.option("--seed", default=0, show_default=True)
@click.option(
    "-o", "--output", default="-", type=click.Path(allow_dash=True), help="A file, or a folder for NAME.json."
)
def main(kind: str, n: int, seed: int, output: str) -> None:
    """Write a scene as JSON."""
    scene = CLASSES[kind](n, seed)
    text = json.dumps(as_json(scene))
    if output == "-":
        click.echo(text)
    else:
        path = Path(output)
        (path / f"{scene.name}.json" if path.is_dir() else path).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
