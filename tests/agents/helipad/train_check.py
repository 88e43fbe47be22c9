"""Make the weights of the detector's learned check: ``python tests/agents/helipad/train_check.py [FRAMES [FOLDER]]``

Renders frames with pads, with pads of other letters, with clutter and with walls (seeds that no test and no benchmark
uses), lets the detector's own stages propose places in them, and fits three networks to tell an H from all else that is
built as one. Writes agents/helipad/check.npz, which holds the three side by side. FOLDER: photographs, as
tests/bench/helipad_foreign.py takes them; those it keeps apart are not seen. A quarter of an hour of processor time for
8000 frames and some twenty photographs.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from agents.helipad import channels, structure
from agents.helipad.check import WEIGHTS, LearnedCheck, features
from agents.helipad.geometry import View
from agents.helipad.refine import SIDE, heading
from agents.helipad.search import Effort, Searcher
from tests.agents.helipad.generator import CAMERA, FOCAL_PX, SIZE, SYMBOL_M, Sample, sample
from tests.agents.helipad.letters import LOOKALIKES
from tests.agents.helipad.scenery import wall
from tests.agents.helipad.typefaces import LEARNED, names
from tests.bench.helipad_foreign import cuts
from zmav.vision.threads import one_thread

Image = NDArray[np.float32]
Patches = NDArray[np.float16]

FIRST_SEED = 10_000_000
KINDS = ("pads", "pads", "pads", "letters", "clutter", "pads", "wall", "letters", "pads", "letters")
PADS = 6
THOROUGH = Effort(6.5, 120, 20, 0.0)
"""more than a search looks at: what it might take for an H"""
HIDDEN = (96, 32)
EPOCHS = 14
BATCH = 256
DECAY = np.float32(5e-5)
NOISE = np.float32(0.1)
"""standard deviation of what is added to patches, so that the weights do not learn these by heart"""
NEAR, TURNED = 0.15, math.radians(12.0)
"""an H that is this well placed counts as found"""
FAR = 0.4
CUTS = 200
"""of each photograph"""
OFTEN = 4
"""times that a photograph's patches are learned from: few of them are built as an H"""
FOURS = 32
"""a 4 that is open at the top is an H without a half bar, which may be hidden: so many more of it among the letters"""
NETS = 3
"""they err in different places, so the mean of their odds tells more than those of one"""
STEP = 250
"""frames that a process makes at a time"""
EVERY = 2
"""of the patches of frames without a letter, photographs too, one in so many is learned from"""


def rendered(glyphs: list[str], number: int) -> Sample:
    seed = FIRST_SEED + number
    rng = np.random.default_rng(seed)
    kind, hard, whole = KINDS[number % len(KINDS)], bool(rng.random() < 0.7), bool(rng.random() < 0.2)
    if kind == "wall":
        height = float(rng.uniform(1.5, 12.0))
        picture = wall(rng, SIZE, FOCAL_PX * SYMBOL_M / height)
        return Sample(np.rint(picture).astype(np.uint8), (), height, *rng.uniform(-0.2, 0.2, 2))
    if kind == "clutter":
        return sample(seed, kind, hard, (1.0, 12.5))
    height_range, pads = ((3.0, 12.5), PADS) if rng.random() < 0.8 else ((1.0, 3.0), 1)
    mix = ["H"] if kind == "pads" else glyphs
    return sample(seed, "lookalike", hard, height_range, whole_pad=whole, pads=pads, letters=mix)


def of_photographs(folder: Path) -> list[Sample]:
    """Cuts of those that are not kept apart, as seen from heights at random."""
    rng = np.random.default_rng(FIRST_SEED)
    return [
        Sample(cut, (), float(rng.uniform(1.5, 12.0)), *rng.uniform(-0.2, 0.2, 2))
        for _, cut in cuts(folder, False, FIRST_SEED, CUTS)
    ]


def gather(numbered: Iterable[tuple[int, Sample]]) -> tuple[Patches, Image]:
    """Patches (N, M) and labels (N,) of samples and their numbers."""
    searcher = Searcher()
    patches: list[Patches] = []
    labels: list[float] = []
    for i, made in numbered:
        rng = np.random.default_rng(FIRST_SEED + i)
        yellow = channels.yellow(made.frame)
        pictures = [(channels.grey(made.frame), (0, 0)), *([] if yellow is None else [yellow])]
        symbol = float(np.mean([pad.symbol_m for pad in made.pad_specs])) if made.pad_specs else SYMBOL_M
        for picture, origin in pictures:
            height, roll, pitch = made.hints(rng)
            view = View(CAMERA, None, height * rng.uniform(0.9, 1.1) / symbol, roll, pitch)
            found = searcher.proposals(channels.Pyramid(picture, origin), view, THOROUGH)
            for place, angle, patch in zip(found.middles, heading(found.affines), found.patches, strict=True):
                label = judged(made, place, float(angle))
                wanted = made.pad_specs or rng.integers(EVERY) == 0
                if label is not None and wanted and structure.sound(patch[None])[0]:
                    patches.append(patch.astype(np.float16))
                    labels.append(label)
    flat: Patches = np.array(patches, dtype=np.float16).reshape(-1, SIDE * SIDE)
    return flat, np.array(labels, dtype=np.float32)


def gather_rendered(glyphs: list[str], numbers: range) -> tuple[Patches, Image]:
    one_thread()
    return gather((number, rendered(glyphs, number)) for number in numbers)


def judged(made: Sample, place: NDArray[np.float64], angle: float) -> float | None:
    """1 for a well placed H, 0 for something else, None for what is neither."""
    for pad in made.pads:
        away = math.hypot(place[0] - pad.u, place[1] - pad.v) / pad.scale_px
        off = abs((angle - pad.heading + math.pi / 2.0) % math.pi - math.pi / 2.0)
        if away < NEAR and off < TURNED:
            return 1.0
        if away < FAR:
            return None
    return 0.0


def save(net: LearnedCheck) -> None:
    """As what :meth:`LearnedCheck.built_in` gives."""
    arrays = {f"weights{i}": w.astype(np.float16) for i, w in enumerate(net.weights)}
    arrays |= {f"biases{i}": b.astype(np.float16) for i, b in enumerate(net.biases)}
    np.savez_compressed(WEIGHTS, **arrays)  # type: ignore[arg-type]  # its stub takes the names for allow_pickle


def fit(patches: Patches, labels: Image) -> LearnedCheck:
    with ProcessPoolExecutor() as pool:
        return side_by_side(list(pool.map(partial(fit_one, patches, labels), range(NETS))))


def side_by_side(nets: list[LearnedCheck]) -> LearnedCheck:
    """One network whose odds are the mean of those of these, of two hidden layers each."""
    firsts, middles, lasts = zip(*(net.weights for net in nets), strict=True)
    rows, columns = (np.cumsum([0, *(each.shape[axis] for each in middles)]) for axis in (0, 1))
    middle = np.zeros((rows[-1], columns[-1]), dtype=np.float32)
    for i, each in enumerate(middles):
        middle[rows[i] : rows[i + 1], columns[i] : columns[i + 1]] = each
    *biases, offsets = zip(*(net.biases for net in nets), strict=True)
    mean: Image = np.mean(offsets, axis=0, dtype=np.float32)
    last: Image = np.vstack(lasts, dtype=np.float32) / np.float32(len(nets))
    return LearnedCheck([np.hstack(firsts), middle, last], [*map(np.hstack, biases), mean])


def fit_one(patches: Patches, labels: Image, seed: int) -> LearnedCheck:
    """Adam on the cross entropy."""
    rng = np.random.default_rng(seed)
    sizes = (patches.shape[1], *HIDDEN, 1)
    net = LearnedCheck(
        [rng.normal(0.0, math.sqrt(2.0 / a), (a, b)).astype(np.float32) for a, b in pairwise(sizes)],
        [np.zeros(b, dtype=np.float32) for b in sizes[1:]],
    )
    learned = net.weights + net.biases
    first, second = ([np.zeros_like(w) for w in learned] for _ in range(2))
    step = 0
    for epoch in range(EPOCHS):
        rate = 2e-3 * 0.5 * (1.0 + math.cos(math.pi * epoch / EPOCHS))
        order = rng.permutation(len(labels))
        for at in range(0, len(order) - BATCH + 1, BATCH):
            part = order[at : at + BATCH]
            some = patches[part].astype(np.float32) * np.float32(rng.uniform(0.85, 1.15))
            some += NOISE * rng.standard_normal(some.shape, dtype=np.float32)
            x = features(some)
            outputs = net.outputs(x)
            error = (1.0 / (1.0 + np.exp(-np.clip(outputs[-1], -30, 30))) - labels[part, None]) / len(part)
            slopes: list[Image] = []
            biases: list[Image] = []
            for i in reversed(range(len(outputs))):
                before = np.maximum(outputs[i - 1], 0.0) if i else x
                slopes.insert(0, before.T @ error + DECAY * net.weights[i])
                biases.insert(0, error.sum(axis=0))
                if i:
                    error = (error @ net.weights[i].T) * (outputs[i - 1] > 0.0)
            step += 1
            for w, m, s, g in zip(learned, first, second, slopes + biases, strict=True):
                m += 0.1 * (g - m)
                s += 0.001 * (g * g - s)
                w -= np.float32(rate / (1 - 0.9**step)) * m / (np.sqrt(s / (1 - 0.999**step)) + 1e-8)
    return net


def main() -> None:
    one_thread()
    glyphs = [*LOOKALIKES * 8, *["4"] * FOURS, *names(LEARNED)]
    frames = int(sys.argv[1]) if len(sys.argv) > 1 else 8000
    parts: list[tuple[Patches, Image]] = []
    if len(sys.argv) > 2:
        parts = [gather(enumerate(of_photographs(Path(sys.argv[2]))))] * OFTEN
    numbers = [range(i, min(i + STEP, frames)) for i in range(0, frames, STEP)]
    with ProcessPoolExecutor() as pool:
        for part in pool.map(partial(gather_rendered, glyphs), numbers):
            parts.append(part)
            print(f"{sum(len(labels) for _, labels in parts)} patches", flush=True)
    patches, labels = (np.concatenate(each) for each in zip(*parts, strict=True))
    held = np.arange(len(labels)) >= 0.85 * len(labels)  # of later frames
    odds = fit(patches[~held], labels[~held]).odds(patches[held].astype(np.float32))
    for limit in (0.0, 1.0, 2.0, 3.0, 4.0):
        seen = odds >= limit
        hits, false = seen[labels[held] > 0.5].mean(), seen[labels[held] < 0.5].mean()
        print(f"held back, limit {limit}: {hits:.4f} of those of an H, {false:.4f} of the others")
    save(fit(patches, labels))


if __name__ == "__main__":
    main()
