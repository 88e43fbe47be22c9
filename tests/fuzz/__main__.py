"""``make fuzz ARGS='--seconds 60 --seed 7 mcap http'``: for as long as one likes. What is found goes to the corpus."""

from __future__ import annotations

import argparse
import random
import sys
import time
import traceback

from tests.fuzz.engine import Found, fuzz, shrunk
from tests.fuzz.targets import TARGETS


def main() -> int:
    options = argparse.ArgumentParser("make fuzz", description=__doc__)
    options.add_argument("targets", nargs="*", metavar="TARGET", help=f"of {', '.join(TARGETS)} (default: all)")
    options.add_argument("--seconds", type=float, default=10.0, help="of CPU for each target (default 10)")
    options.add_argument("--seed", type=int, help="of the mutations (default: another each time)")
    asked = options.parse_args()
    if unknown := [each for each in asked.targets if each not in TARGETS]:
        options.error(f"no target {', '.join(unknown)}; there are {', '.join(TARGETS)}")
    seed = random.randrange(1 << 32) if asked.seed is None else asked.seed
    failed, whole = False, 0
    for name in asked.targets or TARGETS:
        begun = time.monotonic()
        try:
            tried = fuzz(TARGETS[name], seed, seconds=asked.seconds)
        except Found as found:
            failed = True
            traceback.print_exception(found.error)
            kept = found.target.keep(shrunk(found.target, found.data, found.error))
            print(f"{found}\n  kept as {kept}, cut down", flush=True)
            continue
        whole += tried.inputs
        took = time.monotonic() - begun
        print(f"{name}: {tried.inputs} inputs, {tried.taken} of them taken, nothing found ({took:.0f} s)", flush=True)
    print(f"{whole} inputs, seed {seed}")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
