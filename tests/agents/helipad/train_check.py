"""Make the weights of the detector's learned check: ``python tests/agents/helipad/train_check.py [FRAMES]``

Renders frames with and without a pad (seeds that no test and no benchmark uses), lets the detector's own stages propose
places in them, and fits two hidden layers to tell an H from all else. Writes agents/helipad/check.npz. Some minutes
for 8000 frames.
"""

from __future__ import annotations

import math
import sys
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from agents.helipad import channels
from agents.helipad.check import WEIGHTS, LearnedCheck, scaled
from agents.helipad.geometry import View
from agents.helipad.refine import SIDE, heading
from agents.helipad.search import Searcher
from tests.agents.helipad.generator import CAMERA, SYMBOL_M, Sample, sample

Image = NDArray[np.float32]

FIRST_SEED = 10_000_000
HIDDEN = (96, 32)
VIEWS = 2
"""of each frame, with other errors of the hints"""
EPOCHS = 25
BATCH = 256
DECAY = np.float32(2e-4)
NOISE = np.float32(0.3)
"""standard deviation of what is added to patches of about 1, so that the weights do not learn these by heart"""
NEAR, TURNED = 0.15, math.radians(12.0)
"""an H that is this well placed counts as found"""
FAR = 0.4


def gather(frames: int) -> tuple[Image, Image]:
    """Patches (N, M) and labels (N,)."""
    searcher = Searcher()
    patches, labels = [], []
    for i in range(frames):
        seed = FIRST_SEED + i
        rng = np.random.default_rng(seed)
        kind = ("pad", "pad", "clutter", "lookalike")[i % 4]
        many = bool(rng.random() < 0.8)
        made = sample(
            seed,
            kind,
            bool(rng.random() < 0.7),
            (2.5, 12.5) if many else (1.0, 12.5),
            whole_pad=bool(rng.random() < 0.25),
            pads=3 if many else 1,
        )
        symbol = float(np.mean([pad.symbol_m for pad in made.pad_specs])) if made.pad_specs else SYMBOL_M
        yellow = channels.yellow(made.frame)
        pictures = [(channels.grey(made.frame), (0, 0)), *([] if yellow is None else [yellow])]
        for picture, origin in pictures * VIEWS:
            height, roll, pitch = made.hints(rng)
            view = View(CAMERA, None, height * rng.uniform(0.9, 1.1) / symbol, roll, pitch)
            found = searcher.proposals(channels.Pyramid(picture, origin), view)
            for place, angle, patch in zip(found.middles, heading(found.affines), found.patches, strict=True):
                label = judged(made, place, float(angle))
                if label is not None:
                    patches.append(patch)
                    labels.append(label)
        if i % 250 == 249:
            print(f"{i + 1} frames, {len(labels)} patches, {int(sum(labels))} of an H", flush=True)
    return np.array(patches, dtype=np.float32), np.array(labels, dtype=np.float32)


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


def fit(patches: Image, labels: Image) -> LearnedCheck:
    """Adam on the cross entropy; every patch is also seen mirrored, as an H looks the same."""
    rng = np.random.default_rng(1)
    sizes = (patches.shape[1], *HIDDEN, 1)
    net = LearnedCheck(
        [rng.normal(0.0, math.sqrt(2.0 / a), (a, b)).astype(np.float32) for a, b in pairwise(sizes)],
        [np.zeros(b, dtype=np.float32) for b in sizes[1:]],
    )
    learned = net.weights + net.biases
    first, second = ([np.zeros_like(w) for w in learned] for _ in range(2))
    inputs = scaled(patches)
    step = 0
    for epoch in range(EPOCHS):
        rate = 2e-3 * 0.5 * (1.0 + math.cos(math.pi * epoch / EPOCHS))
        order = rng.permutation(len(labels))
        for at in range(0, len(order) - BATCH + 1, BATCH):
            part = order[at : at + BATCH]
            grid = inputs[part].reshape(-1, SIDE, SIDE)
            x = grid[:, :: rng.choice([-1, 1]), :: rng.choice([-1, 1])].reshape(len(part), -1)
            x = x * np.float32(rng.uniform(0.85, 1.15)) + NOISE * rng.standard_normal(x.shape, dtype=np.float32)
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
    cv2.setNumThreads(1)
    patches, labels = gather(int(sys.argv[1]) if len(sys.argv) > 1 else 8000)
    held = np.arange(len(labels)) >= 0.85 * len(labels)  # of later frames
    trial = fit(patches[~held], labels[~held])
    chance = trial.probability(patches[held])
    for limit in (0.5, 0.7, 0.9):
        seen = chance >= limit
        hits, false = seen[labels[held] > 0.5].mean(), seen[labels[held] < 0.5].mean()
        print(f"held back, limit {limit}: {hits:.4f} of those of an H, {false:.4f} of the others")
    save(fit(patches, labels))


if __name__ == "__main__":
    main()
