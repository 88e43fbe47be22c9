"""Ways home over a bad mesh that is torn in flight: how near simulated copters came to each other. Needs root.

    python tests/bench/plan_return_torn.py [--vehicles 4] [--runs 10] [--loss 0.3] [--seed 0]

The lab of plan_flown.py: every frame is late, and a share of them is lost. At a random moment of a swap either every
copter loses the planner, or half of them do and the others later. Nobody hears anything of it until all are on the
ground. Then the network is healed, and they take off again. Ends with 1 where two came nearer than the sum of their
radii, or one did not come down.
"""

from __future__ import annotations

import argparse
import asyncio
import math
import random
import sys
import time
from collections.abc import Iterable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import zmav
from mesh.lab.lab import Lab
from tests.bench.plan_flown import HEIGHT, RADIUS, Planners, Truth, _known, _logs, _swap, fleet, planner, ring
from tests.mesh.proofs import rigs
from zmav.wire import swarm

FAILSAFE = {"land_after": 6.0, "action": "land", "return": "together"}
BESIDE = 7.0
"""m from its home at which a vehicle that found it taken may have landed"""
DOWN = 240.0
"""s until all must be on the ground: a segment, land_after, the way home and the landing"""


async def runs(args: argparse.Namespace) -> bool:
    rng, good = random.Random(args.seed), True
    async with fleet(args, False, (), FAILSAFE) as (lab, z, names, truth):
        planner(lab, "ground")
        planners = Planners(z)
        await planners.until(lambda book: book.planner == "ground")
        for run in range(args.runs):
            if run:
                await let_go(planners, z, names)
                await asyncio.gather(*(rigs.in_the_air(z.vehicle(name), HEIGHT) for name in names))
            await _known(planners, names)
            truth.reset()
            goal = str((await planners.order("submit", _swap(names, rng, run)))["goal"])
            book = await planners.until(
                lambda book, goal=goal: any(e.id == goal and e.state in ("flying", "failed") for e in book.goals)
            )
            if refused := [e.text for e in book.goals if e.id == goal and e.state == "failed"]:
                print(f"  {run + 1:3d}: {refused[0]}", flush=True)  # a battery lasts for three or four of them
                good &= run > 0
                break
            while not all(committed(z.vehicle(name)) for name in names):
                await asyncio.sleep(0.1)  # one that was never sent anything hovers, and misses nobody
            await asyncio.sleep(rng.uniform(0.0, 5.0))
            if any(e.id == goal and e.state != "flying" for e in (planners.book.goals if planners.book else [])):
                print(f"  {run + 1:3d}: it was over before the network was torn", flush=True)
                continue
            kind, begun = ("whole", "halves")[run % 2], time.monotonic()
            first = set(names if kind == "whole" else names[: len(names) // 2])
            cut = tear(lab, first, set(lab.scenario.hosts) - first)
            if kind == "halves":
                await asyncio.sleep(rng.uniform(5.0, 40.0))
                rest = set(names) - first
                cut |= tear(lab, rest, set(lab.scenario.hosts) - rest)
            landed = await down(truth, begun + DOWN)
            took = time.monotonic() - begun
            for edge in cut:
                lab.heal(edge)
            fine = landed and truth.apart >= 2 * RADIUS
            good &= fine
            home = sum(math.dist(at[:2], pad) < BESIDE for at, pad in zip(truth.places, ring(len(names)), strict=True))
            words = "all down" if landed else f"not all down: {truth.places}"
            words = f"{words} after {took:.0f} s, {home} of {len(names)} at home"
            print(f"  {run + 1:3d} {kind:6s}: {words}, least separation {truth.apart:.2f} m", flush=True)
            if not landed:
                break
        if not good:
            _logs(lab)
    return good


def committed(vehicle: zmav.Vehicle) -> bool:
    """It says that it is on a segment."""
    state = vehicle.last_state
    return state is not None and state.segment is not None


async def let_go(planners: Planners, z: zmav.Client, names: list[str]) -> None:
    """The goal is dropped, and nobody is commanded any more."""
    await planners.order("abort", swarm.GoalId())
    free = 0
    while free < 20:  # for 10 s: a goal that ends may ask for its leases once more
        states = [z.vehicle(name).last_state for name in names]
        free = free + 1 if all(state is not None and state.lease is None for state in states) else 0
        await asyncio.sleep(0.5)


def tear(lab: Lab, some: Iterable[str], others: Iterable[str]) -> set[str]:
    """Cut every link between them; which."""
    here, there = set(some), set(others)
    found = {
        e.name for e in lab.network.wiring.edges if (e.a in here and e.b in there) or (e.a in there and e.b in here)
    }
    for edge in found:
        lab.cut(edge)
    return found


async def down(truth: Truth, until: float) -> bool:
    while time.monotonic() < until:
        if truth.places and all(-down < 0.3 for _, _, down in truth.places):
            await asyncio.sleep(8.0)  # until they have disarmed
            return True
        await asyncio.sleep(0.5)
    return False


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicles", type=int, default=4)
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--loss", type=float, default=0.3)
    parser.add_argument("--alone", action="store_true", help="without the vehicles' own last resort")
    args = parser.parse_args()
    if not rigs.able():
        return 0
    return 0 if asyncio.run(runs(args)) else 1


if __name__ == "__main__":
    sys.exit(main())
