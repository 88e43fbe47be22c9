"""How closely simulated vehicles follow what they are committed to, and how executions end over bad networks.

    python tests/bench/plan_execute.py [--follow] [--histories 300] [--seed 0]

``--follow``: vehicles of each autopilot circle together at several speeds; errors along and across the way, the worst
of all and 95 % of them, by the simulator's own truth. ``--histories``: so many executions in virtual time, with lost,
late and doubled messages, bursts of 2 s, partitions, pauses and killed planners: clearance, time against the plan's,
processor time and messages. Both by default.
"""

from __future__ import annotations

import argparse
import asyncio
import collections
import math
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from agents.planner.execute.executor import Executor
from agents.planner.execute.flight import Flight
from agents.planner.live.frames import enu
from agents.planner.model.problem import Motion
from tests.agents.planner.execute.fleet import airborne
from tests.agents.planner.execute.virtual import History, carousel, crossing, slower

SIDES = (
    ("arducopter", 2.0, 1.0),
    ("arducopter", 4.0, 2.0),
    ("arducopter", 5.0, 2.5),
    ("px4", 2.0, 1.0),
    ("px4", 4.0, 2.0),
    ("ardurover", 1.0, 0.5),
    ("ardurover", 2.0, 1.0),
)


async def follow(autopilot: str, speed: float, accel: float) -> None:
    """Three vehicles half-way round a circle; prints one row."""
    height = 0.0 if autopilot == "ardurover" else 10.0
    radius = max(8.0, 1.6 * speed * speed / accel)
    motions = {
        f"quad{i + 1}": circling(motion, speed, accel, height)
        for i, motion in enumerate(carousel(3, radius, speed=speed).values())
    }
    starts = [(float(motion[0, 2]), float(motion[0, 1])) for motion in motions.values()]
    along: list[float] = []
    across: list[float] = []
    async with airborne(starts, 10.0, autopilot=autopilot) as fleet, Executor(fleet.z, fleet.names) as ex:
        same = dict.fromkeys(motions, 1.0)
        flight = Flight(motions, same, dict.fromkeys(motions, accel), 1.0, margin=6.0, tracking=5.0)
        flying = asyncio.create_task(ex.run(flight))
        while not flying.done():
            meant, places = ex.meant(), fleet.places()
            for name, (place, velocity) in meant.items():
                pace = float(np.linalg.norm(velocity))
                off = np.array(enu(places[name])) - place
                if height == 0.0:
                    off[2] = 0.0
                lead = float(off @ velocity) / pace if pace > 0.2 else 0.0
                along.append(lead)
                across.append(math.sqrt(max(float(off @ off) - lead * lead, 0.0)))
            await asyncio.sleep(0.05)
        outcome = await flying
    a, c = np.abs(along), np.array(across)
    print(
        f"{autopilot:11s} {speed:4.1f} {accel:5.1f}  {a.max():5.2f} {np.percentile(a, 95):5.2f}   "
        f"{c.max():5.2f} {np.percentile(c, 95):5.2f}   {'yes' if outcome.done else outcome.reason}"
    )


def circling(motion: Motion, speed: float, accel: float, height: float) -> Motion:
    """The same way at a gentler start: sped up at ``accel`` as carousel's is at 2 m/s²."""
    times = max(1.0, math.sqrt(2.0 / accel)) if speed < 4.0 else 1.0
    motion = motion * np.array([times, 1.0, 1.0, 1.0])
    motion[:, 3] = height
    return motion


def histories(count: int, seed: int) -> None:
    kinds: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
    least: dict[str, float] = collections.defaultdict(lambda: math.inf)
    longer: dict[str, list[float]] = collections.defaultdict(list)
    sends, begun = 0, time.process_time()
    for k in range(seed, seed + count):
        rng = np.random.default_rng(k)
        motions = _plan(k, rng)
        span = max(float(motion[-1, 0]) for motion in motions.values())
        kind = ("loss", "bursts", "partition", "killed", "paused")[k % 5]
        history = History(motions, rng, loss=float(rng.choice([0.0, 0.3, 0.5])))
        _spoil(history, kind, rng, span)
        phase = "at rest" if kind == "killed" else history.conductor.phase(history.now)
        kinds[kind][phase] += 1
        least[kind] = min(least[kind], history.least())
        if phase == "done":
            longer[kind].append((history.now - 1002.0) / span)
        sends += history.sends
    print(f"{'history':10s} {'least clearance':>16s} {'time / plan':>12s} {'p90':>5s}  ends")
    for kind, ends in kinds.items():
        times = longer[kind] or [math.nan]
        print(
            f"{kind:10s} {least[kind]:14.2f} m {np.median(times):12.2f} {np.percentile(times, 90):5.2f}  {dict(ends)}"
        )
    took = time.process_time() - begun
    print(f"{count} histories, {took / count * 1e3:.0f} ms of one core and {sends / count:.0f} segments each")


def _plan(k: int, rng: np.random.Generator) -> dict[str, Motion]:
    if k % 3 == 0:
        return crossing(rng, 6, 12.0, 2.8)
    return slower(crossing(rng, 5, 12.0, 2.8), 5.0) if k % 3 == 1 else carousel(6, 5.0, turn=6.0, speed=3.0)


def _spoil(history: History, kind: str, rng: np.random.Generator, span: float) -> None:
    def ended(h: History) -> bool:
        return h.conductor.phase(h.now) in ("done", "stuck", "halted")

    at = 1000.0 + float(rng.uniform(0.0, span))
    if kind == "bursts":
        history.network.cut = lambda now, who: (now - at) % 6.0 < 2.0
    elif kind == "partition":
        half = {part.id for part in history.parts[:3]}
        history.network.cut = lambda now, who: who in half and at < now < at + 10.0
    if kind == "killed":
        history.run(at - 1000.0, ended)
        history.alive = False
        history.run(30.0)
        return
    if kind == "paused":
        history.run(at - 1000.0)
        history.conductor.pause()
        history.run(10.0)
        history.conductor.resume()
    history.run(4.0 * span + 60.0, lambda h: h.now > at + 12.0 and ended(h))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--follow", action="store_true")
    parser.add_argument("--histories", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    if args.histories or not args.follow:
        histories(args.histories or 60, args.seed)
    if args.follow or not args.histories:
        print("autopilot    m/s  m/s²   along   95 %  across   95 %   arrived")
        for side in SIDES:
            asyncio.run(follow(*side))


if __name__ == "__main__":
    main()
