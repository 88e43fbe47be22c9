"""``python -m tests.sim.yardstick [NAME ...]``: fly what was recorded, and print what is different, and why."""

from __future__ import annotations

import sys
from pathlib import Path

from tests.sim.yardstick.explained import reason_for
from tests.sim.yardstick.flights import YARDSTICKS
from tests.sim.yardstick.measure import measure

DATA = Path(__file__).resolve().parents[4] / "shared" / "data"


def main(names: list[str]) -> int:
    unexplained = 0
    for name in names or list(YARDSTICKS):
        rows = measure(YARDSTICKS[name], DATA)
        print(f"== {name}: {len(rows)} differences")
        for row in rows:
            reason = reason_for(name, row)
            unexplained += reason is None
            where = f"{row.kind} {row.what}" + (f" ({row.phase})" if row.phase else "")
            print(f"{where:58} {row.real:>24} | {row.ours:24} {reason or '?'}")
    print(f"{unexplained} unexplained")
    return 1 if unexplained else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
