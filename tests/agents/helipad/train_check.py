"""Make the weights of the detector's learned check: ``python tests/agents/helipad/train_check.py [FRAMES]``

Renders frames with and without a pad (seeds that no test and no benchmark uses), lets the detector's own stages propose
places in them, and fits one hidden layer to tell an H from all else. Writes agents/helipad/check.npz. Some minutes
for 4000 frames.
"""

from __future__ import annotations

import math
import sys

import cv2
import numpy as np
from numpy.typing import NDArray

from agents.helipad import channels
from agents.helipad.check import WEIGHTS, Check, scaled
from agents.helipad.geometry import View
from agents.helipad.refine import SIDE, heading
from agents.helipad.search import Searcher
from agents.helipad.templates import letter_h
from tests.agents.helipad.generator import CAMERA, SYMBOL_M, Sample, sample

Image = NDArray[np.float32]

FIRST_SEED = 10_000_000
HIDDEN = 48
VIEWS = 2
"""of each frame, with other errors of the hints"""
EPOCHS = 60
BATCH = 256
NEAR, TURNED = 0.15, math.radians(12.0)
"""an H that is this well placed counts as found"""
FAR = 0.4


def gather(frames: int) -> tuple[Image, Image]:
    """Patches (N, M) and labels (N,)."""
    searcher = Searcher(letter_h())
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
        pictures = [p for p in (channels.grey(made.frame), channels.yellow(made.frame)) if p is not None]
        for picture in pictures * VIEWS:
            height, roll, pitch = made.hints(rng)
            view = View(CAMERA, None, height * rng.uniform(0.9, 1.1) / symbol, roll, pitch)
            found = searcher.proposals(channels.Pyramid(picture), view)
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


def fit(patches: Image, labels: Image) -> Check:
    """Adam on the cross entropy; every patch is also seen mirrored, as an H looks the same."""
    rng = np.random.default_rng(1)
    size = patches.shape[1]
    start = [
        rng.normal(0.0, math.sqrt(2.0 / size), (size, HIDDEN)),
        np.zeros(HIDDEN),
        rng.normal(0.0, math.sqrt(2.0 / HIDDEN), HIDDEN),
        np.zeros(1),
    ]
    weights: list[Image] = [w.astype(np.float32) for w in start]
    first, second = ([np.zeros_like(w) for w in weights] for _ in range(2))
    inputs = scaled(patches)
    step = 0
    for epoch in range(EPOCHS):
        rate = 2e-3 * 0.5 * (1.0 + math.cos(math.pi * epoch / EPOCHS))
        order = rng.permutation(len(labels))
        for at in range(0, len(order) - BATCH + 1, BATCH):
            part = order[at : at + BATCH]
            grid = inputs[part].reshape(-1, SIDE, SIDE)
            x = grid[:, :: rng.choice([-1, 1]), :: rng.choice([-1, 1])].reshape(len(part), -1)
            x = x + rng.normal(0.0, 0.1, x.shape).astype(np.float32)
            hidden = np.maximum(x @ weights[0] + weights[1], 0.0)
            logit = hidden @ weights[2] + weights[3]
            error = (1.0 / (1.0 + np.exp(-np.clip(logit, -30, 30))) - labels[part]) / len(part)
            back = np.outer(error, weights[2]) * (hidden > 0.0)
            slopes = [x.T @ back + 2e-4 * weights[0], back.sum(axis=0), hidden.T @ error, error.sum(keepdims=True)]
            step += 1
            for w, m, s, g in zip(weights, first, second, slopes, strict=True):
                m += 0.1 * (g - m)
                s += 0.001 * (g * g - s)
                w -= rate * (m / (1 - 0.9**step)) / (np.sqrt(s / (1 - 0.999**step)) + 1e-8)
    return Check(*weights)


def main() -> None:
    cv2.setNumThreads(1)
    patches, labels = gather(int(sys.argv[1]) if len(sys.argv) > 1 else 4000)
    held = np.arange(len(labels)) >= 0.85 * len(labels)  # of later frames
    trial = fit(patches[~held], labels[~held])
    chance = trial.probability(patches[held])
    for limit in (0.5, 0.7, 0.9):
        seen = chance >= limit
        hits, false = seen[labels[held] > 0.5].mean(), seen[labels[held] < 0.5].mean()
        print(f"held back, limit {limit}: {hits:.4f} of those of an H, {false:.4f} of the others")
    final = fit(patches, labels)
    first, bias, second, offset = (a.astype(np.float16) for a in (final.first, final.bias, final.second, final.offset))
    np.savez_compressed(WEIGHTS, first=first, bias=bias, second=second, offset=offset)


if __name__ == "__main__":
    main()
