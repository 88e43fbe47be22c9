"""What vehicles and pads look like, at exact measures: vehicles are solid boxes, pads pictures that are drawn once."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from zmav.sim.camera.spec import PadSpec, bgr
from zmav.sim.camera.sprites import Sprite
from zmav.sim.dynamics.body import Body
from zmav.sim.dynamics.copter import CopterDynamics
from zmav.sim.dynamics.plane import PlaneDynamics
from zmav.sim.dynamics.rover import RoverDynamics

PAD_TEXELS = 1024
PROPELLER_OF_ARM = 0.45  # half side of the square that stands for a propeller
Vector = tuple[float, float, float]
Grid = NDArray[np.floating[Any]]
DARK, GREY, RED, WHITE = (34.0, 34.0, 36.0), (92.0, 96.0, 104.0), (36.0, 60.0, 205.0), (236.0, 238.0, 238.0)


class Box(NamedTuple):
    """A solid box in a vehicle's axes: middle (forward, right, height above the reference point), half sizes, BGR."""

    center: Vector
    half: Vector
    color: Vector


class Figure(NamedTuple):
    """One vehicle from outside."""

    boxes: tuple[Box, ...]
    pad: Sprite | None
    deck_m: float
    """the pad's height above the reference point"""
    reach: float
    """no part is farther from the reference point, metres"""


def figure(body: Body, pad: PadSpec | None) -> Figure:
    """What a vehicle with that body looks like, and the pad it carries."""
    if isinstance(body, RoverDynamics):
        frame = body.frame
        boxes = _rover((frame.length_m, frame.width_m, frame.height_m), frame.wheelbase_m, frame.track_m)
    elif isinstance(body, PlaneDynamics):
        boxes = _plane(body.wing.span_m)
    else:
        assert isinstance(body, CopterDynamics), body
        boxes = _copter([(rotor.forward_m, rotor.right_m) for rotor in body.airframe.rotors])
    top = max(box.center[2] + box.half[2] for box in boxes)
    deck = top + 0.005 if pad is None or pad.deck_m is None else pad.deck_m
    if pad is not None and deck > top + 0.01:  # the pad stands on a post
        boxes += (Box((0.0, 0.0, (top + deck - 0.01) / 2.0), (0.03, 0.03, (deck - 0.01 - top) / 2.0), GREY),)
    reach = max(sum(abs(c) + h for c, h in zip(box.center, box.half, strict=True)) for box in boxes)
    if pad is None:
        return Figure(boxes, None, deck, reach)
    return Figure(boxes, pad_sprite(pad), deck, max(reach, deck + pad.size_m + pad.symbol_m))


def _rover(size: Vector, wheelbase: float, track: float) -> tuple[Box, ...]:
    """Four wheels, a hull of that ``size`` (length, width, height, metres), and a bumper at its nose."""
    length, width, height = size
    radius = min(0.45 * height, 0.2 * length)
    low = 0.6 * radius
    wheel = (radius, 0.12 * width, radius)
    return (
        *(Box((f * wheelbase, r * track, radius), wheel, DARK) for f in (-0.5, 0.5) for r in (-0.5, 0.5)),
        Box((0.0, 0.0, (low + height) / 2.0), (length / 2.0, 0.36 * width, (height - low) / 2.0), GREY),
        Box((0.47 * length, 0.0, 0.8 * height), (0.035 * length, 0.3 * width, 0.1 * height), RED),
    )


def _copter(rotors: list[tuple[float, float]]) -> tuple[Box, ...]:
    """A hub with a mark at the nose, and its propellers as they look when they turn."""
    arm = max(math.hypot(*rotor) for rotor in rotors)
    side = PROPELLER_OF_ARM * arm
    return (
        Box((0.0, 0.0, 0.1), (0.3 * arm, 0.3 * arm, 0.06), GREY),
        Box((0.3 * arm, 0.0, 0.12), (0.1 * arm, 0.06 * arm, 0.05), RED),
        *(Box((forward, right, 0.15), (side, side, 0.005), DARK) for forward, right in rotors),
    )


def _plane(span: float) -> tuple[Box, ...]:
    """A high-wing aeroplane of that span."""
    length, wing = 0.68 * span, 0.08 * 0.68 * span
    return (
        Box((-0.08 * length, 0.0, 0.12), (length / 2.0, 0.035 * span, 0.06), WHITE),
        Box((wing, 0.0, 0.2), (0.075 * span, span / 2.0, 0.01), WHITE),
        *(Box((wing, side * 0.44 * span, 0.2), (0.075 * span, 0.06 * span, 0.012), RED) for side in (-1.0, 1.0)),
        Box((-0.53 * length, 0.0, 0.2), (0.055 * span, 0.19 * span, 0.01), WHITE),
    )


# ---- pads: how much of each texel a shape covers, 0 to 1, so that edges are smooth. Metres; s: a texel's side


def pad_sprite(pad: PadSpec) -> Sprite:
    """The pad from above, the H's upright ahead."""
    half = 0.5 * max(pad.symbol_m, pad.size_m)
    s = 2.0 * half / PAD_TEXELS
    right = ((np.arange(PAD_TEXELS) - (PAD_TEXELS - 1) / 2.0) * s).astype(np.float32)[None, :]
    ahead = -right.T
    color = np.full((PAD_TEXELS, PAD_TEXELS, 3), bgr(pad.background), dtype=np.float32)
    if pad.shape == "disc":
        alpha: Grid = np.clip(0.5 + (pad.size_m / 2.0 - np.sqrt(ahead * ahead + right * right)) / s, 0.0, 1.0)
    else:
        alpha = _box(ahead, right, pad.size_m / 2.0, pad.size_m / 2.0, s)
    if pad.symbol == "H":
        mark = _letter_h(ahead, right, pad, s)
        _over(color, mark, pad.color)
    else:
        across, along = pad.squares
        side = pad.symbol_m / max(across, along)
        mark = _box(ahead, right, along * side / 2.0, across * side / 2.0, s)
        column = _stripes(right + across * side / 2.0, side, s)
        row = _stripes(along * side / 2.0 - ahead, side, s)
        _over(color, mark, pad.color)
        _over(color, mark * (column * row + (1.0 - column) * (1.0 - row)), "black")
    alpha = np.maximum(alpha, mark)
    picture = np.dstack([color * alpha[..., None], 255.0 * alpha])
    return Sprite(np.asarray(cv2.convertScaleAbs(picture), dtype=np.uint8), s)  # rounds, and cuts off at 255


def _letter_h(ahead: Grid, right: Grid, pad: PadSpec, s: float) -> Grid:
    height, stroke = pad.symbol_m, pad.stroke_ratio * pad.symbol_m
    half_width = pad.width_ratio * height / 2.0
    mark = _box(ahead, right, stroke / 2.0, half_width - stroke, s)
    for side in (-1.0, 1.0):
        mark = mark + _box(ahead, right - side * (half_width - stroke / 2.0), height / 2.0, stroke / 2.0, s)
    result: Grid = np.minimum(mark, 1.0)
    return result


def _box(x: Grid, y: Grid, half_x: float, half_y: float, s: float) -> Grid:
    """A rectangle about the origin."""

    def covered(at: Grid, half: float) -> Grid:
        result: Grid = np.clip((np.minimum(at + 0.5 * s, half) - np.maximum(at - 0.5 * s, -half)) / s, 0.0, 1.0)
        return result

    return covered(x, half_x) * covered(y, half_y)


def _stripes(x: Grid, width: float, s: float) -> Grid:
    """Stripes of ``width``, one of which begins at 0, and as wide gaps."""

    def covered(at: Grid) -> Grid:
        whole = np.floor(at / (2.0 * width))
        result: Grid = whole * width + np.minimum(at - 2.0 * whole * width, width)
        return result

    return (covered(x + 0.5 * s) - covered(x - 0.5 * s)) / s


def _over(below: Grid, alpha: Grid, color: str) -> None:
    """Paint ``color`` with ``alpha`` (h, w) over ``below`` (h, w, 3), in place."""
    below += (np.array(bgr(color), dtype=np.float32) - below) * alpha[..., None]
