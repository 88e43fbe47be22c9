"""What the helipad detector takes for a pad that is none, beside what it finds: letters of six typefaces, photographs.

    python tests/bench/helipad_foreign.py [--frames 100] [--seed 50000000] [--photographs FOLDER [--apart]]
                                          [--fonts FOLDER]

Hints with noise, one detector, one thread, CPU time. FOLDER holds sample pictures of packages, such as skimage/data of
scikit-image 0.17.2's wheel, face and ascent of SciPy 1.5.4's and the two of scikit-learn's; those of ``APART`` (some
four in ten) are looked at with ``--apart`` alone. ``--fonts``: TrueType fonts in place of the six typefaces,
such as those of PyPI's font-roboto, font-source-sans-pro, font-source-serif-pro, font-hanken-grotesk,
font-caladea and font-manrope.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from agents.helipad import Detector
from tests.agents.helipad.generator import CAMERA, SIZE, Sample, sample
from tests.agents.helipad.typefaces import JUDGED, names
from tests.bench.helipad import CLEAR, CLEAR_FAR, HARD, HARD_FAR, NEAR, Set
from zmav.vision.threads import one_thread

APART = ("brick", "chelsea", "china", "gravel", "motorcycle_left", "motorcycle_right", "page", "retina", "rocket")
CLUTTER, HARD_CLUTTER = Set("clutter", "clutter", False, (1.0, 12.0)), Set("hard clutter", "clutter", True, (1.0, 12.0))
PADS = 4
"""with a foreign letter, in one frame"""
CUTS = 60
"""of a photograph, each at all of ``HEIGHTS``"""
HEIGHTS = (2.0, 4.0, 7.0, 11.0)
SMALLEST_CUT = 0.15
"""of a photograph's side"""
Hints = tuple[float, float, float]


def frames(which: Set, count: int, seed: int) -> Iterator[tuple[Sample, Hints]]:
    for number in range(count):
        made = sample(seed + number, which.kind, which.hard, which.height)
        yield made, made.hints(np.random.default_rng([seed, number]))


def lettered(count: int, seed: int, hard: bool, faces: tuple[str, ...] = JUDGED) -> Iterator[tuple[Sample, Hints]]:
    """Every glyph in its turn, at heights that leave room for ``PADS``."""
    order = np.random.default_rng(seed).permutation(names(faces))
    for number in range(count):
        some = np.roll(order, -PADS * number)[:PADS].tolist()
        made = sample(seed + number, "lookalike", hard, (2.0, 12.0), pads=PADS, letters=some)
        yield made, made.hints(np.random.default_rng([seed, number]))


def cuts(folder: Path, apart: bool, seed: int, count: int = CUTS) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    """Parts of photographs, turned by quarters, at random scales."""
    for number, path in enumerate(sorted(p for p in folder.iterdir() if (p.stem in APART) == apart)):
        picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if picture is None:
            continue
        rng = np.random.default_rng([seed, number])
        for _ in range(count):
            turned = np.rot90(picture, int(rng.integers(4)))
            most = min(turned.shape[1], turned.shape[0] * SIZE[0] / SIZE[1])
            width = most * math.exp(rng.uniform(math.log(SMALLEST_CUT), 0.0))
            height = width * SIZE[1] / SIZE[0]
            u, v = (
                int(rng.uniform(0.0, full - part))
                for full, part in zip(turned.shape[1::-1], (width, height), strict=True)
            )
            part = np.ascontiguousarray(turned[v : v + max(int(height), 8), u : u + max(int(width), 8)])
            yield path.stem, np.asarray(cv2.resize(part, SIZE, interpolation=cv2.INTER_AREA), dtype=np.uint8)


class Figures:
    """What one detector does; ``spent``: s of each call with a rendered frame."""

    def __init__(self, detector: Detector) -> None:
        self.detector = detector
        self.spent: list[float] = []

    def recall(self, made: Sample, hints: Hints) -> bool:
        found = self._found(made, hints)[:1]
        truth = made.pads[0]
        return any(math.hypot(f.u - truth.u, f.v - truth.v) < NEAR * truth.scale_px for f in found)

    def false(self, made: Sample, hints: Hints) -> int:
        return len(self._found(made, hints))

    def _found(self, made: Sample, hints: Hints) -> list:  # type: ignore[type-arg]
        start = time.thread_time()
        found = self.detector.detect(made.frame, *hints)
        self.spent.append(time.thread_time() - start)
        return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=100, help="of each set")
    parser.add_argument("--seed", type=int, default=50_000_000, help="of the first frame of each set")
    parser.add_argument("--photographs", type=Path, help="a folder of pictures without a pad")
    parser.add_argument("--apart", action="store_true", help="only those kept apart")
    parser.add_argument("--fonts", type=Path, help="a folder of typefaces")
    options = parser.parse_args()
    one_thread()
    faces = JUDGED if options.fonts is None else tuple(map(str, sorted(options.fonts.glob("*.ttf"))))
    figures = Figures(Detector(CAMERA))
    figures.detector.detect(np.zeros((480, 640, 3), dtype=np.uint8), 5.0)  # makes what it keeps
    for which in (CLEAR, CLEAR_FAR, HARD, HARD_FAR):
        found = [figures.recall(*each) for each in frames(which, options.frames, options.seed)]
        print(f"{which.name}: recall {np.mean(found):.3f} of {len(found)}")
    for which in (CLUTTER, HARD_CLUTTER):
        false = sum(figures.false(*each) > 0 for each in frames(which, options.frames, options.seed))
        print(f"{which.name}: {false} of {options.frames}")
    for hard in (False, True):
        made = list(lettered(options.frames, options.seed, hard, faces))
        taken = sum(figures.false(*each) for each in made)
        print(f"letters{', hard' if hard else ''}: {taken} of {sum(len(m.pad_specs) for m, _ in made)}")
    median, late = np.percentile(figures.spent, (50, 99))
    print(f"ms: median {1e3 * median:.1f}, p99 {1e3 * late:.1f}")
    if options.photographs is not None:
        taken_for: dict[str, int] = {}
        count = 0
        for name, cut in cuts(options.photographs, options.apart, options.seed):
            count += len(HEIGHTS)
            for height in HEIGHTS:
                taken_for[name] = taken_for.get(name, 0) + bool(figures.detector.detect(cut, height))
        print(f"photographs: {sum(taken_for.values())} of {count}: { {k: v for k, v in taken_for.items() if v} }")


if __name__ == "__main__":
    main()
