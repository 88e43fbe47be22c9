"""What vehicles, pads and roofs look like: drawn once each, at exact measures."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np

from zmav.sim.camera.coverage import Grid, box, dashes, disc, over, turned
from zmav.sim.camera.materials import mean_color, paint, texel_m
from zmav.sim.camera.scene import GroundKind
from zmav.sim.camera.spec import PadSpec, bgr
from zmav.sim.camera.sprites import Sprite, blank, grid_of, sprite_of
from zmav.sim.dynamics.airframe import Rotor

PAD_TEXELS = 1024
FIGURE_TEXELS = 384
ROOF_TEXELS = 1024
PROP_OF_SPACING = 0.42  # radius of a propeller, of the distance to the next one
Vector = tuple[float, float, float]


class Box(NamedTuple):
    """A solid box in a vehicle's axes: middle (forward, right, height above the reference point), half sizes, BGR."""

    center: Vector
    half: Vector
    color: Vector


class Figure(NamedTuple):
    """One vehicle from outside. ``sprite`` lies level in its axes, ``height`` above its reference point."""

    boxes: tuple[Box, ...] = ()
    sprite: Sprite | None = None
    """with still propellers"""
    spinning: Sprite | None = None
    height: float = 0.0
    pad: Sprite | None = None
    pad_at: Vector = (0.0, 0.0, 0.0)
    """forward, right, height above the reference point"""
    reach: float = 0.0
    """no part is farther from the reference point, metres"""


def pad_sprite(pad: PadSpec) -> Sprite:
    """The pad from above, the H's upright ahead."""
    half = 0.5 * max(_extent(pad), pad.size_m if pad.shape != "none" else 0.0)
    texel = 2.0 * half / PAD_TEXELS
    ahead, right = grid_of(half, half, texel)
    color, alpha = blank(ahead, right)
    color[:] = bgr(pad.background)
    paint_color = bgr(pad.color)
    if pad.shape in ("disc", "ring"):
        alpha = disc(ahead, right, pad.size_m / 2.0, texel)
    elif pad.shape == "square":
        alpha = box(ahead, right, pad.size_m / 2.0, pad.size_m / 2.0, texel)
    if pad.shape == "ring":
        over(color, 1.0 - disc(ahead, right, pad.size_m * (0.5 - pad.ring_ratio), texel), paint_color)
    if pad.symbol == "H":
        mark = letter_h(ahead, right, pad, texel)
        over(color, mark, paint_color)
        # Without a ground of its own only the letter is there, and its edge must not have the ground's colour.
        if pad.shape == "none":
            color[:] = paint_color
        alpha = np.maximum(alpha, mark)
    elif pad.symbol == "chessboard":
        _chessboard(ahead, right, pad, texel, color, alpha)
    return sprite_of(color, alpha, texel)


def letter_h(ahead: Grid, right: Grid, pad: PadSpec, texel: float) -> Grid:
    """How much of each texel the letter covers."""
    height, stroke = pad.symbol_m, pad.stroke_ratio * pad.symbol_m
    half_width = pad.width_ratio * height / 2.0
    upright = half_width - stroke / 2.0
    mark = box(ahead, right, stroke / 2.0, half_width - stroke, texel)
    for side in (-upright, upright):
        mark = mark + box(ahead, right - side, height / 2.0, stroke / 2.0, texel)
    result: Grid = np.minimum(mark, 1.0)
    return result


def _extent(pad: PadSpec) -> float:
    return pad.symbol_m if pad.symbol != "none" else 0.0


def _chessboard(ahead: Grid, right: Grid, pad: PadSpec, texel: float, color: Grid, alpha: Grid) -> None:
    """Squares of black on the pad's colour, with a white rim of one square where ``size_m`` leaves room for it."""
    across, along = pad.squares
    side = pad.symbol_m / max(across, along)
    inside = box(ahead, right, along * side / 2.0, across * side / 2.0, texel)
    column = dashes(right + across * side / 2.0, 2.0 * side, side, texel)
    row = dashes(along * side / 2.0 - ahead, 2.0 * side, side, texel)
    dark = column * row + (1.0 - column) * (1.0 - row)
    over(color, inside, bgr(pad.color))
    over(color, inside * dark, bgr("black"))
    np.maximum(alpha, inside, out=alpha)


def rover_figure(size: Vector, wheelbase: float, track: float, pad: PadSpec | None = None) -> Figure:
    """A four-wheeled rover of that ``size`` (length, width, height, metres) with a bumper at its nose."""
    length, width, height = size
    radius = min(0.45 * height, 0.2 * length)
    wheel = (radius, 0.12 * width, radius)
    places = [(f * wheelbase / 2.0, r * track / 2.0, radius) for f in (-1.0, 1.0) for r in (-1.0, 1.0)]
    wheels = tuple(Box(place, wheel, (28.0, 28.0, 30.0)) for place in places)
    low = 0.6 * radius
    hull = (length / 2.0, 0.36 * width, (height - low) / 2.0)
    body = Box((0.0, 0.0, (low + height) / 2.0), hull, (92.0, 96.0, 104.0))
    nose = Box((0.47 * length, 0.0, 0.8 * height), (0.035 * length, 0.3 * width, 0.1 * height), (36.0, 90.0, 200.0))
    boxes = (*wheels, body, nose)
    if pad is not None and pad.deck_m is not None and pad.deck_m > height:  # the pad stands on a post
        post = (height + pad.deck_m - 0.01) / 2.0
        boxes += (Box((pad.forward_m, pad.right_m, post), (0.03, 0.03, post - height), (60.0, 60.0, 62.0)),)
    return _padded(Figure(boxes=boxes, reach=length + height), pad, height + 0.005)


def copter_figure(rotors: tuple[Rotor, ...], pad: PadSpec | None) -> Figure:
    """Arms, propellers and a hub with a mark at the nose."""
    arm = max(math.hypot(r.forward_m, r.right_m) for r in rotors)
    pairs = itertools.combinations(rotors, 2)
    near = min(math.hypot(a.forward_m - b.forward_m, a.right_m - b.right_m) for a, b in pairs)
    radius = PROP_OF_SPACING * near
    still, spinning = (_copter_sprite(rotors, arm, radius, turning) for turning in (False, True))
    return _padded(Figure(sprite=still, spinning=spinning, height=0.15, reach=arm + radius + 0.3), pad, 0.2)


def _copter_sprite(rotors: tuple[Rotor, ...], arm: float, radius: float, turning: bool) -> Sprite:
    half = arm + radius + 0.02
    texel = 2.0 * half / FIGURE_TEXELS
    ahead, right = grid_of(half, half, texel)
    color, alpha = blank(ahead, right)
    for rotor in rotors:
        angle = math.atan2(rotor.right_m, rotor.forward_m)
        along, across = turned(ahead, right, (rotor.forward_m / 2.0, rotor.right_m / 2.0), angle)
        length = math.hypot(rotor.forward_m, rotor.right_m) / 2.0
        _put(color, alpha, box(along, across, length, 0.012, texel), (34.0, 34.0, 36.0))
    _put(color, alpha, disc(ahead, right, 0.3 * arm, texel), (58.0, 60.0, 64.0))
    _put(color, alpha, box(ahead - 0.22 * arm, right, 0.10 * arm, 0.05 * arm, texel), (30.0, 30.0, 210.0))
    for i, rotor in enumerate(rotors):
        dn, de = ahead - rotor.forward_m, right - rotor.right_m
        _put(color, alpha, disc(dn, de, 0.022, texel), (20.0, 20.0, 22.0))
        if turning:
            _put(color, alpha, 0.32 * disc(dn, de, radius, texel), (70.0, 70.0, 72.0))
        else:
            along, across = turned(dn, de, (0.0, 0.0), 0.9 * i)
            _put(color, alpha, box(along, across, radius, 0.012, texel), (40.0, 40.0, 42.0))
    return sprite_of(color, alpha, texel)


def plane_figure(span: float, pad: PadSpec | None = None) -> Figure:
    """A high-wing aeroplane of that span."""
    length = 0.68 * span
    half = 0.55 * span
    texel = 2.0 * half / FIGURE_TEXELS
    ahead, right = grid_of(half, half, texel)
    color, alpha = blank(ahead, right)
    white, red = (236.0, 238.0, 238.0), (40.0, 40.0, 205.0)
    _put(color, alpha, box(ahead + 0.08 * length, right, length / 2.0, 0.035 * span, texel), white)
    _put(color, alpha, box(ahead - 0.08 * length, right, 0.075 * span, span / 2.0, texel), white)
    for side in (-1.0, 1.0):
        tip = box(ahead - 0.08 * length, right - side * 0.44 * span, 0.075 * span, 0.06 * span, texel)
        _put(color, alpha, tip, red)
    _put(color, alpha, box(ahead + 0.53 * length, right, 0.055 * span, 0.19 * span, texel), white)
    _put(color, alpha, disc(ahead - 0.44 * length, right, 0.03 * span, texel), (40.0, 40.0, 42.0))
    figure = sprite_of(color, alpha, texel)
    return _padded(Figure(sprite=figure, spinning=figure, height=0.2, reach=0.7 * span), pad, 0.25)


def roof_sprite(ground: GroundKind, size: tuple[float, float], seed: int) -> Sprite:
    """A roof of ``size`` metres along and across, with a rim."""
    texel = max(max(size) / ROOF_TEXELS, 0.004)
    ahead, right = grid_of(size[0] / 2.0, size[1] / 2.0, texel)
    level = max(round(math.log2(texel / texel_m(0))), 0)
    color = paint(ground, seed + 1, level, 0, 0, right.shape[1], len(ahead))
    rim = 1.0 - box(ahead, right, size[0] / 2.0 - 0.15, size[1] / 2.0 - 0.15, texel)
    base = mean_color(ground)
    over(color, rim, (0.62 * base[0], 0.62 * base[1], 0.62 * base[2]))
    return sprite_of(color, np.ones(color.shape[:2], dtype=np.float32), texel)


def _put(color: Grid, alpha: Grid, cover: Grid, paint_color: Vector) -> None:
    """Paint over what is there already, which may be nothing, in place."""
    total = cover + alpha * (1.0 - cover)
    share = np.divide(cover, total, out=np.zeros_like(total), where=total > 0.0)
    over(color, share, paint_color)
    alpha[:] = total


def _padded(figure: Figure, pad: PadSpec | None, top: float) -> Figure:
    if pad is None:
        return figure
    deck = top if pad.deck_m is None else pad.deck_m
    reach = max(figure.reach, math.hypot(pad.forward_m, pad.right_m) + deck + pad.size_m + pad.symbol_m)
    return figure._replace(pad=pad_sprite(pad), pad_at=(pad.forward_m, pad.right_m, deck), reach=reach)
