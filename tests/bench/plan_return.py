"""The ways home of a fleet: whether all come down apart whenever a network is torn, and what that costs.

    python tests/bench/plan_return.py [--histories 60] [--vehicles 10 20 50] [--seed 0] [--moments 8]

``--histories``: executions in virtual time over networks that lose a third, with late and doubled messages and clocks
that are off by what is not known of them. At random moments of each: what every vehicle would do alone from then on by
what it truly has, with some that cannot fly home; and each ends by a planner that dies, a fleet that is torn in halves,
or a network that comes back in the middle. A violation is two vehicles nearer than their radii; they are counted.
``--vehicles``: bytes on the wire and processor time of the planner for so many, once with and once without ways home:
a grid with 5 m between neighbours flies 95 m in half a minute and then hovers.
"""

from __future__ import annotations

import argparse
import collections
import math
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from agents.planner.execute.conductor import Send
from agents.planner.model.problem import Motion
from tests.agents.planner.execute.virtual import History, carousel, crossing, line, slower
from tests.agents.planner.returning.torn import HomeHistory

KINDS = ("whole", "killed", "halves", "back")


def plan(k: int, rng: np.random.Generator) -> dict[str, Motion]:
    if k % 3 == 0:
        return crossing(rng, 6, 14.0, 2.8)
    return slower(crossing(rng, 8, 20.0, 2.8), 4.0) if k % 3 == 1 else carousel(6, 5.0, turn=6.0, speed=2.0)


def ended(history: History) -> bool:
    return history.conductor.phase(history.now) in ("done", "stuck", "halted")


def histories(count: int, seed: int, moments: int) -> None:
    tried: collections.Counter[str] = collections.Counter()
    broken: list[str] = []
    least, home, vehicles, begun = math.inf, 0, 0, time.process_time()
    for k in range(seed, seed + count):
        rng = np.random.default_rng(k)
        motions = plan(k, rng)
        kind, span = KINDS[k % len(KINDS)], max(float(motion[-1, 0]) for motion in motions.values())
        history = HomeHistory(motions, rng, loss=float(rng.choice([0.0, 0.3, 0.5])))
        until = 1000.0 + (span * 1.5 + 20.0 if kind == "whole" else float(rng.uniform(1.0, span + 4.0)))
        for at in np.sort(rng.uniform(1000.0, until, moments)).tolist():
            history.run(max(at - history.now, 0.0), ended)
            torn = history.torn(rng, lands=float(rng.choice([0.0, 0.2, 0.5])))
            tried["moments"] += 1
            least, home, vehicles = min(least, torn.least), home + torn.home, vehicles + torn.vehicles
            if torn.least <= 0.0:
                broken.append(f"{k} at {history.now - 1000.0:.1f} s: {torn}")
        if kind != "whole":
            _end(history, kind, rng)
            tried[kind] += 1
            least = min(least, history.least())
            if history.least() <= 0.0:
                broken.append(f"{k} {kind}: {history.least():.2f} m")
        if (k + 1 - seed) % 20 == 0 or k + 1 == seed + count:
            told = f"{k + 1 - seed} histories: {dict(tried)}; broken separations: {len(broken)}; least {least:.2f} m"
            took = time.process_time() - begun
            print(f"{told}; {home} of {vehicles} had a way home, the others land; {took:.0f} s of one core", flush=True)
    for each in broken[:20]:
        print("  broken:", each)


def _end(history: HomeHistory, kind: str, rng: np.random.Generator) -> None:
    """Flown to the ground, or for as long as anything can happen."""
    now = history.now
    if kind == "killed":
        history.alive = False
        history.run(170.0)
    elif kind == "halves":
        half = {part.id for part in history.parts[: len(history.parts) // 2]}
        history.network.cut = lambda at, who: who in half and at > now
        history.run(float(rng.uniform(5.0, 80.0)))
        history.alive = False
        history.run(170.0)
    else:
        back = now + float(rng.uniform(20.0, 60.0))
        history.network.cut = lambda at, who: now < at < back
        history.run(170.0)


def cost(count: int, seed: int) -> None:
    side = math.ceil(math.sqrt(count))
    places = [np.array([5.0 * (k % side), 5.0 * (k // side), 10.0]) for k in range(count)]
    motions = {f"v{k}": line(place, place + np.array([90.0, 30.0, 5.0]), 3.0) for k, place in enumerate(places)}
    plain = History(motions, np.random.default_rng(seed), loss=0.1)
    history = HomeHistory(motions, np.random.default_rng(seed), loss=0.1)
    without, spent = _spent(plain), _spent(history)
    flown, each = history.now - 1000.0, np.array(history.bytes)
    print(
        f"{count:3d} vehicles, {flown:.0f} s: {len(each)} ways home put, {each.mean():.0f} bytes each ({each.max()} at "
        f"most), {each.sum() / flown / count:.0f} bytes/s a vehicle; planner {1e2 * spent / flown:.1f} % of a core "
        f"({1e2 * without / flown:.1f} % without); found {history.keeper.found}, none {history.keeper.none}"
    )


def _spent(history: History) -> float:
    """s of processor for what is decided in a minute."""
    spent, decide = 0.0, history.conductor.decide

    def timed(now: float, most: int = 1000) -> list[Send]:
        nonlocal spent
        begun = time.process_time()
        try:
            return decide(now, most)
        finally:
            spent += time.process_time() - begun

    history.conductor.decide = timed  # type: ignore[method-assign]
    history.run(60.0)
    return spent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--histories", type=int, default=60)
    parser.add_argument("--moments", type=int, default=8)
    parser.add_argument("--vehicles", type=int, nargs="*", default=[10, 20, 50])
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    if args.histories:
        histories(args.histories, args.seed, args.moments)
    for count in args.vehicles:
        cost(count, args.seed)


if __name__ == "__main__":
    main()
