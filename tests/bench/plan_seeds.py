"""The README's commands with receivers that drift as typical ones do, in virtual time, by many teams.

How near any two truly came to each other, what stopped them where no plan said so, and how long it took by the
previews' own seconds.

    python tests/bench/plan_seeds.py                       # 100 teams, as ArduCopters and as PX4s follow
    python tests/bench/plan_seeds.py --loss 0.3            # over a network that loses a third of its messages
    python tests/bench/plan_seeds.py --no-room             # as if positions were exact

Takeoffs are the vehicles' own; here they climb at once and evenly, so their times say nothing.
"""

from __future__ import annotations

import argparse
import asyncio
import collections
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.agents.planner.live.seeds import ARDUCOPTER, COMMANDS, PROMISED, PX4, PX4_IN_CALM_AIR, Row, team_rows


def shown(what: str, rows: list[Row]) -> str:
    near = sorted(row.nearest for row in rows)
    took = [row.flown / row.said for row in rows]
    stops = sum(len(row.stops) for row in rows)
    return (
        f"{what:10} {len(rows):6} {sum(each < PROMISED for each in near):10} {near[0]:8.2f}"
        f" {near[len(near) // 20]:8.2f} {near[len(near) // 2]:8.2f} {stops:6}"
        f" {np.median(took):7.2f} {min(took):6.2f} {max(took):6.2f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--teams", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0, help="of the first team")
    parser.add_argument("--loss", type=float, default=0.0)
    parser.add_argument("--no-room", action="store_true")
    options = parser.parse_args()
    for name, sort in (("ArduCopter", ARDUCOPTER), ("PX4, calm", PX4_IN_CALM_AIR), ("PX4, windy", PX4)):
        print(f"{name}: teams of four, promised {PROMISED:g} m between two centres")
        print("command     teams  below that  least m  5 % m  median m  stops  flown/said  least   most", flush=True)
        rows: list[Row] = []
        for seed in range(options.seed, options.seed + options.teams):
            rows += asyncio.run(team_rows(seed, sort, loss=options.loss, room=not options.no_room))
        for what in COMMANDS:
            print(shown(what, [row for row in rows if row.what == what]), flush=True)
        why = collections.Counter(_kind(stop) for row in rows for stop in row.stops)
        for text, count in why.most_common():
            print(f"  {count} times: {text}")


def _kind(stop: str) -> str:
    """Without names and numbers."""
    return " ".join(word for word in stop.split() if not any(letter.isdigit() for letter in word))


if __name__ == "__main__":
    main()
