"""A planner on each side of a torn network, in the middle of a swap: both halves must stay apart. Needs root.

    python tests/bench/plan_partition.py [--vehicles 8] [--runs 3] [--seconds 40] [--seed 0]

The lab of plan_flown.py without loss and storms: copters on a ring, a planner on the ground, a standby on a van. At a
random moment of a swap every link between the half that hears the ground and the half that hears the van is cut, and
healed later. Prints who was in charge where, and the least separation by the simulator; ends with 1 where it was below
the sum of the radii, or the goal was not done in the end.
"""

from __future__ import annotations

import argparse
import asyncio
import random
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.bench.plan_flown import RADIUS, Planners, _ended, _logs, _swap, fleet, planner
from tests.mesh.proofs import rigs
from zmav.errors import ZmavError


async def runs(args: argparse.Namespace) -> bool:
    rng, good = random.Random(args.seed), True
    async with fleet(args, True, trees=()) as (lab, z, names, truth):
        planner(lab, "ground")
        planners = Planners(z)
        await planners.until(lambda book: book.planner == "ground")
        planner(lab, "van", "--standby")
        near = {"ground", *names[: len(names) // 2]}
        torn = [edge.name for edge in lab.network.wiring.edges if (edge.a in near) != (edge.b in near)]
        async with rigs.station(lab, "van") as beyond:
            far = Planners(beyond)
            await far.until(lambda book: book.planner == "ground")
            for run in range(args.runs):
                truth.reset()
                start = time.monotonic()
                book = planners.book
                assert book is not None
                goal = str((await planners.order("submit", _swap(names, rng, run)))["goal"])
                await planners.until(
                    lambda book, goal=goal: any(e.id == goal and e.state == "flying" for e in book.goals)
                )
                await asyncio.sleep(rng.uniform(0.0, 8.0))
                for edge in torn:
                    lab.cut(edge)
                await asyncio.sleep(args.seconds)
                sides = [f"{d.book.planner} (term {d.book.term})" if d.book else "nobody" for d in (planners, far)]
                least = truth.apart
                for edge in torn:
                    lab.heal(edge)
                try:
                    row = await _ended(
                        planners, goal, truth, start, run, f"in charge: {sides[0]} here, {sides[1]} beyond;"
                    )
                    done = row["state"] == "done"
                except (ZmavError, TimeoutError) as e:
                    print(f"  {run + 1:3d}: {e}")
                    done = False
                print(f"       least separation while torn {least:.2f} m, in all {truth.apart:.2f} m")
                good &= done and truth.apart >= 2 * RADIUS
        if not good:
            _logs(lab)
    return good


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicles", type=int, default=8)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=40.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--loss", type=float, default=0.0)
    parser.add_argument("--alone", action="store_true", help="without the vehicles' own last resort")
    args = parser.parse_args()
    if not rigs.able():
        return 0
    return 0 if asyncio.run(runs(args)) else 1


if __name__ == "__main__":
    sys.exit(main())
