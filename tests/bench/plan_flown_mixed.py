"""Copters, rovers and planes of one fleet flown together over a bad mesh, and a leader that is lost. Needs root.

    python tests/bench/plan_flown_mixed.py [mixed|leader] [--runs 3] [--loss 0.1] [--seed 0]

The mesh of plan_flown.py without its storms. mixed: eight copters change places, four rovers do so below them on a
ring farther out, two planes go to each other's circle, all by one goal. leader: three copters follow a rover that is
driven by hand; its computer loses power on the way, and they return to where they took off. Separation is the
simulator's truth. Ends with 1 where two came nearer than their radii, or a goal did not end as it should.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import itertools
import math
import random
import sys
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import zmav
from mesh.lab.lab import Lab
from mesh.lab.scenario import Scenario
from tests.bench.plan_flown import HEIGHT, RADIUS, Planners, Truth, _ended, _known, _logs, planner, ring
from tests.mesh.proofs import rigs
from zmav.config import body_of
from zmav.errors import ZmavError
from zmav.wire import swarm

COPTERS, ROVERS, PLANES = 8, 4, 2
OUT, CRUISE = 30.0, 50.0
"""m: the ring of the rovers, and the height of the planes"""
CIRCLES = [(0.0, -220.0), (0.0, 220.0)]
SLOW = 1.0
"""m/s of the rovers: at more they trail their ways by metres"""
TRAILS = 1.0
"""m by which plans widen radii: rovers follow less closely than copters"""


def scenario() -> Scenario:
    """Everybody hears the ground, and the next of its kind."""
    hosts: dict[str, Any] = {"ground": {"position": [0.0, 60.0]}}
    for i, (north, east) in enumerate(ring(COPTERS)):
        hosts[f"quad{i + 1}"] = {"vehicle": "copter", "position": [north, east]}
    for i, (north, east) in enumerate(outer()):
        hosts[f"rover{i + 1}"] = {"vehicle": "rover", "position": [north, east]}
    for i in range(PLANES):
        hosts[f"plane{i + 1}"] = {"vehicle": "plane", "position": [-60.0 - 30.0 * i, -40.0]}
    names = [name for name in hosts if name != "ground"]
    pairs = [("ground", name) for name in names]
    pairs += [(a, b) for a, b in itertools.pairwise(names) if a[:4] == b[:4]]
    medium = {
        "kind": "radio",
        "name": "mesh",
        "interface": "wlan0",
        "pairs": pairs,
        "rate": "6 Mbit/s",
        "delay": "62 ms",
        "jitter": "37 ms",
        "loss": 0.0,
        "burst": 2.0,
    }
    slow = {f"rover{i + 1}": {"body": {"speed": SLOW}} for i in range(ROVERS)}
    fleet = {"failsafe": {"action": "loiter"}, "mesh": {"lease": 8.0}, "vehicles": slow}
    return rigs.scenario(name="mixed", profile="mesh", hosts=hosts, media=[medium], fleet=fleet)


def outer() -> list[tuple[float, float]]:
    angles = [math.tau * (i + 0.5) / ROVERS for i in range(ROVERS)]
    return [(round(OUT * math.cos(a), 2), round(OUT * math.sin(a), 2)) for a in angles]


@contextlib.asynccontextmanager
async def fleet(loss: float) -> AsyncIterator[tuple[Lab, zmav.Client, list[str], Truth]]:
    async with Lab(scenario()) as lab:
        await lab.ready()
        async with rigs.station(lab) as z:
            await rigs.all_heard(z, lab, 180.0)
            names = [name for name in lab.scenario.hosts if name != "ground"]
            await asyncio.gather(*(_up(z.vehicle(name)) for name in names))
            for edge in lab.network.wiring.edges:
                lab.set(edge.name, loss=1.0 - math.sqrt(1.0 - loss))
            radii = [body_of(lab.scenario.hosts[name].vehicle).radius for name in names]
            truth = Truth(lab.directory / "sim.sock", names, radii, [])
            try:
                yield lab, z, names, truth
            finally:
                truth.close()


async def _up(vehicle: zmav.Vehicle) -> None:
    if vehicle.name.startswith("rover"):
        await vehicle.arm(ready_timeout=rigs.PATIENCE)
    else:
        await rigs.in_the_air(vehicle, CRUISE if vehicle.name.startswith("plane") else HEIGHT)


async def mixed(args: argparse.Namespace, planners: Planners, names: list[str], truth: Truth) -> bool:
    rng, good = random.Random(args.seed), True
    circles = list(CIRCLES)
    for run in range(args.runs):
        await _known(planners, names)
        truth.reset()
        places, ground = ring(COPTERS), outer()
        rng.shuffle(places)
        rng.shuffle(ground)
        circles.reverse()
        to = [(n, e, -HEIGHT) for n, e in places] + [(n, e, 0.0) for n, e in ground]
        to += [(n, e, -CRUISE - 20.0 * k) for k, (n, e) in enumerate(circles)]
        start = time.monotonic()
        order = swarm.Submit(id=f"mixed{run}-{rng.random():.9f}", goal=swarm.GoTo(vehicles=names, to=to))
        given = await planners.order("submit", order)
        good &= bool((await _ended(planners, str(given["goal"]), truth, start, run, ""))["good"])
    return good


async def leader(planners: Planners, lab: Lab, z: zmav.Client, truth: Truth) -> bool:
    """The rover's computer loses power while it is followed."""
    followers = ["quad1", "quad2", "quad3"]
    await _known(planners, [*followers, "rover1"])
    truth.reset()
    homes = dict(zip([f"quad{i + 1}" for i in range(COPTERS)], ring(COPTERS), strict=True))
    offsets = [(-6.0, 6.0 * (k - 1), -HEIGHT) for k in range(3)]
    goal = swarm.Follow(vehicles=followers, leader="rover1", offsets=offsets, on_lost="return")
    start = time.monotonic()
    name = str((await planners.order("submit", swarm.Submit(id=f"leader-{start:.6f}", goal=goal)))["goal"])
    drive = asyncio.create_task(z.vehicle("rover1").goto(pos=(60.0, 20.0, 0.0)))
    await planners.until(lambda book: any(e.id == name and "following" in e.text for e in book.goals))
    near = 0
    while near < 20:  # for two seconds beside it
        here = z.vehicle("rover1").last_state
        away = []
        for follower, (north, east, _) in zip(followers, offsets, strict=True):
            state = z.vehicle(follower).last_state
            if state and state.local and here and here.local:
                n, e, _ = (a - b for a, b in zip(state.local, here.local, strict=True))
                away.append(math.hypot(n - north, e - east))
        near = near + 1 if len(away) == 3 and max(away) < 2.5 else 0
        await asyncio.sleep(0.1)
        if time.monotonic() - start > 120.0:
            print(f"       they did not come beside it: {[f'{a:.1f}' for a in away]} m off")
            return False
    moment = time.monotonic() - start
    drive.cancel()
    await lab.kill("rover1")
    row = await _ended(planners, name, truth, start, 0, f"leader killed after {moment:.0f} s")
    at = dict(zip(truth.names, truth.places, strict=True))
    off = max(math.hypot(at[q][0] - homes[q][0], at[q][1] - homes[q][1]) for q in followers)
    print(f"       they are {off:.1f} m from where they took off at most")
    return bool(row["good"]) and off < 2.0


async def flown(args: argparse.Namespace) -> bool:
    good = True
    async with fleet(args.loss) as (lab, z, names, truth):
        planner(lab, "ground", "--margin", str(TRAILS))
        planners = Planners(z)
        await planners.until(lambda book: book.planner == "ground")
        try:
            if args.what != "leader":
                good &= await mixed(args, planners, names, truth)
            if args.what != "mixed":
                good &= await leader(planners, lab, z, truth)
        except (ZmavError, TimeoutError) as e:
            print(f"  {e}")
            good = False
        if not good:
            _logs(lab)
    return good


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=["mixed", "leader", "both"], default="both")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--loss", type=float, default=0.1)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    if not rigs.able():
        return 0
    print(
        f"{COPTERS} copters, {ROVERS} rovers, {PLANES} planes; over two hops loss {args.loss:.0%} and 50-198 ms; "
        f"copters keep {2 * RADIUS:g} m"
    )
    return 0 if asyncio.run(flown(args)) else 1


if __name__ == "__main__":
    sys.exit(main())
