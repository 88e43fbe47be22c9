"""How well and how fast the helipad detector finds a pad, beside others, on rendered frames; one run, one thread.

    python tests/bench/helipad.py [--frames 200] [--slow-frames 30] [--seed 20000000] [--ours]

Prints docs/vision.md's table: CPU time of a frame, recall of the best-scored detection in clear and hard frames (to
10 m / 10-12 m), the share of frames without a pad that give a detection, and the median errors of place and heading.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import time
from collections.abc import Callable

import numpy as np

from agents.helipad import Detection, Detector
from tests.agents.helipad.generator import CAMERA, FOCAL_PX, SYMBOL_M, Sample, sample
from tests.bench._helipad_rivals import MatchTemplate, Naive, Seen, Tags
from zmav.vision.threads import one_thread

NEAR = 0.3
"""of the symbol's height: a detection within that of the middle counts"""
Hints = tuple[float, float, float]
Find = Callable[[Sample, Hints], list[Seen]]


@dataclasses.dataclass(frozen=True)
class Set:
    name: str
    kind: str
    hard: bool
    height: tuple[float, float]
    whole_pad: bool = False


CLEAR, CLEAR_FAR = Set("clear", "pad", False, (1.0, 10.0)), Set("clear far", "pad", False, (10.0, 12.0))
HARD, HARD_FAR = Set("hard", "pad", True, (1.0, 10.0)), Set("hard far", "pad", True, (10.0, 12.0))
EMPTY = (
    Set("clutter", "clutter", False, (1.0, 12.0)),
    Set("hard clutter", "clutter", True, (1.0, 12.0)),
    Set("look-alike", "lookalike", False, (1.0, 12.0)),
    Set("hard look-alike", "lookalike", True, (1.0, 12.0)),
)
WHOLE, WHOLE_FAR = Set("whole", "pad", False, (1.0, 10.0), True), Set("whole far", "pad", False, (10.0, 12.0), True)


class Tally:
    """What one finder did on one set after another."""

    def __init__(self) -> None:
        self.spent: dict[bool, list[float]] = {True: [], False: []}
        """by whether there is a pad, s"""
        self.hits: dict[str, list[bool]] = {}
        self.places: list[float] = []
        self.headings: list[float] = []

    def add(self, which: Set, made: Sample, found: list[Seen], spent: float) -> None:
        if not which.whole_pad:  # each of those has a letter and a detector of its own
            self.spent[bool(made.pads)].append(spent)
        if not made.pads:
            self.hits.setdefault(which.name, []).append(bool(found))
            return
        truth = made.pads[0]
        away = math.hypot(found[0].u - truth.u, found[0].v - truth.v) if found else math.inf
        hit = away < NEAR * truth.scale_px
        self.hits.setdefault(which.name, []).append(hit)
        if hit and not which.whole_pad and found[0].heading is not None:
            off = (found[0].heading - truth.heading + math.pi / 2.0) % math.pi - math.pi / 2.0
            self.places.append(away)
            self.headings.append(abs(math.degrees(off)))

    def share(self, *names: str) -> str:
        return "/".join(f"{np.mean(self.hits[n]):.3f}" if n in self.hits else "-" for n in names)

    def row(self) -> list[str]:
        errors = [f"{np.median(e):.3f}" if e else "-" for e in (self.places, self.headings)]
        return [
            _times(self.spent[True]),
            _times(self.spent[False]),
            self.share("clear", "clear far"),
            self.share("hard", "hard far"),
            self.share(*(each.name for each in EMPTY)),
            *errors,
        ]


def frames_of(which: Set, seed: int, number: int) -> tuple[Sample, Hints]:
    made = sample(seed + number, which.kind, which.hard, which.height, which.whole_pad)
    return made, made.hints(np.random.default_rng([seed, number]))


def run(
    finders: dict[str, Find], sets: tuple[Set, ...], seed: int, frames: dict[str, int], into: dict[str, Tally]
) -> None:
    """Every frame is made once and given to all."""
    for which in sets:
        for number in range(max(frames[name] for name in finders)):
            made, hints = frames_of(which, seed, number)
            for name, find in finders.items():
                if number < frames[name]:
                    start = time.thread_time()
                    found = find(made, hints)
                    into.setdefault(name, Tally()).add(which, made, found, time.thread_time() - start)


def seen(found: list[Detection]) -> list[Seen]:
    return [Seen(d.u, d.v, d.heading, d.score) for d in found]


def ours() -> tuple[dict[str, Find], dict[str, Find]]:
    """The finders on all frames, and the one that can only be asked where there is a pad."""
    detectors: dict[float, Detector] = {}

    def detector(made: Sample) -> Detector:
        symbol = made.pad_specs[0].symbol_m if made.pad_specs else SYMBOL_M
        if symbol not in detectors:
            detectors.clear()
            detectors[symbol] = Detector(CAMERA, symbol)
            detectors[symbol].detect(np.zeros((480, 640, 3), dtype=np.uint8))  # makes what it keeps
        return detectors[symbol]

    def full(made: Sample, hints: Hints) -> list[Seen]:
        return seen(detector(made).detect(made.frame, *hints))

    def bare(made: Sample, hints: Hints) -> list[Seen]:
        return seen(detector(made).detect(made.frame))

    def track(made: Sample, hints: Hints) -> list[Seen]:
        truth = made.pads[0]
        rng = np.random.default_rng(round(1e3 * truth.u))
        u, v = rng.normal((truth.u, truth.v), 0.3 * truth.scale_px)
        last = Detection(float(u), float(v), truth.scale_px * rng.uniform(0.93, 1.07), truth.heading, 0.9)
        return seen(detector(made).detect(made.frame, *hints, near=last))

    def trusting(made: Sample, hints: Hints) -> list[Seen]:
        return seen(trusted.detect(made.frame, *hints))

    trusted = Detector(CAMERA, trust_height=True)
    return {"ours, height and attitude": full, "ours, no hints": bare}, {
        "ours, trust_height": trusting,
        "ours, tracking": track,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=200, help="frames of each of the ten sets")
    parser.add_argument("--slow-frames", type=int, default=30, help="of each set for what takes long")
    parser.add_argument("--seed", type=int, default=20_000_000, help="of the first frame of each set")
    parser.add_argument("--ours", action="store_true", help="only our detector")
    options = parser.parse_args()
    one_thread()
    everywhere, with_pad = ours()
    tallies: dict[str, Tally] = {}
    frames = dict.fromkeys([*everywhere, *with_pad, "AprilTag 36h11, OpenCV"], options.frames)
    pads, known = (CLEAR, CLEAR_FAR, HARD, HARD_FAR), {}
    if not options.ours:
        naive, match = Naive(), MatchTemplate()
        known["the paper's stages in plain loops, Otsu"] = lambda made, h: naive.find(made.frame, _scale(h))
        known["matchTemplate, 3 scales x 18 rotations"] = lambda made, h: match.find(made.frame, _scale(h))
        frames |= dict.fromkeys(known, options.slow_frames)
    run({**everywhere, **with_pad, **known}, pads, options.seed, frames, tallies)
    run(
        {**everywhere, "ours, trust_height": with_pad["ours, trust_height"], **known},
        EMPTY,
        options.seed,
        frames,
        tallies,
    )
    run(everywhere, (WHOLE, WHOLE_FAR), options.seed, frames, tallies)
    if not options.ours:
        tags = Tags()
        tag: dict[str, Find] = {"AprilTag 36h11, OpenCV": lambda made, h: tags.find(made.frame, _scale(h))}
        run(tag, tuple(dataclasses.replace(each, kind="tag") for each in pads), options.seed, frames, tallies)
        run(tag, EMPTY[:2], options.seed, frames, tallies)
    print("| detector | ms with a pad: median / p99 / max | without | clear | hard |", end="")
    print(" clutter/hard/look-alike/hard | centre px | heading deg |")
    print("|---|---|---|---|---|---|---|---|")
    for name, tally in tallies.items():
        print("| " + " | ".join([name, *tally.row()]) + " |")
    for name in everywhere:
        print(f"{name}: the whole pad 0.25 m, to 10 m / 10-12 m: {tallies[name].share('whole', 'whole far')}")


def _times(spent: list[float]) -> str:
    if not spent:
        return "-"
    median, late = np.percentile(spent, (50, 99))
    return f"{1e3 * median:.1f} / {1e3 * late:.1f} / {1e3 * max(spent):.1f}"


def _scale(hints: Hints) -> float:
    return FOCAL_PX * SYMBOL_M / hints[0]


if __name__ == "__main__":
    main()
