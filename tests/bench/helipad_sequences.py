"""What a helipad's detector and its tracks see in pictures one after another, 15 a second, beside the detector alone.

    python tests/bench/helipad_sequences.py [--sequences 30] [--seed 60000000]

Of hard pads: the share of pictures, from the fifth of eight on, in which it is told of, and of sequences in which it is
within five pictures; of hard clutter and other letters: pictures and sequences with a false one. Then, for each thing
that may happen to a pad meanwhile: the share of pictures in which it is told of and the longest gap.
"""

from __future__ import annotations

import argparse

import numpy as np

from tests.agents.helipad.sequences import EVERY, HAPPENINGS, Shot, longest_gap, right, sequence, watched
from tests.agents.helipad.typefaces import JUDGED, names
from zmav.vision.threads import one_thread

COUNT, WITHIN, HAPPENING = 8, 5, 24
"""pictures of a sequence, those of which one must show it, and those of one in which something happens"""


def seen(shots: list[Shot]) -> tuple[list[bool], list[bool], list[bool]]:
    """Of each picture: whether the pad is told of, whether by that picture alone, and whether something else is."""
    told = watched(shots)
    pairs = list(zip(shots, told, strict=True))
    there = [[each for each in found if right(shot, each.detection)] for shot, found in pairs]
    return (
        [bool(each) for each in there],
        [any(one.pictures == 1 for one in each) for each in there],
        [len(found) > len(each) for found, each in zip(told, there, strict=True)],
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sequences", type=int, default=30, help="of each kind")
    parser.add_argument("--seed", type=int, default=60_000_000, help="of the first of each kind")
    options = parser.parse_args()
    one_thread()
    seeds = range(options.seed, options.seed + options.sequences)
    for name, height in (("to 10 m", (1.0, 10.0)), ("10-12 m", (10.0, 12.0))):
        found = [seen(sequence(seed, hard=True, height=height, count=COUNT)) for seed in seeds]
        late = [np.mean([part[i][WITHIN - 1 :] for part in found]) for i in (0, 1)]
        within = [np.mean([any(part[i][:WITHIN]) for part in found]) for i in (0, 1)]
        false = sum(sum(part[2]) for part in found)
        print(
            f"hard, {name}: from the fifth picture {late[0]:.3f} (alone {late[1]:.3f}); within {WITHIN} pictures "
            f"{within[0]:.3f} (alone {within[1]:.3f}); false in {false} of {COUNT * len(found)} pictures",
            flush=True,
        )
    for kind in ("clutter", "lookalike"):
        some = [seen(sequence(seed, kind, hard=True, count=COUNT, letters=names(JUDGED)))[2] for seed in seeds]
        print(f"hard, {kind}: false in {np.sum(some)} of {COUNT * len(some)} pictures, {sum(map(any, some))} sequences")
    for happening in HAPPENINGS:
        shares, gaps = [], []
        for seed in seeds[: max(options.sequences // 5, 1)]:
            told = seen(sequence(seed, height=(3.0, 9.0), count=HAPPENING, happening=happening))[0]
            shares.append(np.mean(told))
            gaps.append(longest_gap(told) * EVERY)
        print(f"{happening}: {np.mean(shares):.3f} of pictures, longest gap {max(gaps):.2f} s", flush=True)


if __name__ == "__main__":
    main()
