"""A plane's way over the ground and in height, flown at one speed: where it is at which time.

A way is a pose (x, y, z, heading) and legs, one a row: curvature (1/m, left is positive), length over the ground (m),
rise over the leg (m, spread evenly). The speed is the greatest that its turns and climbs leave. Where the slope
changes, the height is averaged over some metres, so that the change takes its time.

The shortest over the ground is a Dubins way: for what turns no tighter than a radius, whatever the heading at the
place. It is a turn and a straight line, or two turns (X.-N. Bui and others, 1994, after L. E. Dubins, *On curves of
minimal length with a constraint on average curvature*, 1957). Its poses are x, y (m) and the heading (rad
counter-clockwise from east), its legs curvature and length alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from agents.planner.model.geometry import segment_clear
from agents.planner.model.problem import Floats, Motion
from agents.planner.model.world import World
from agents.planner.solve.jit import jit

WORDS = 4
"""LS, RS, LR, RL"""
_TAU = 2.0 * math.pi


@jit
def advance(x: float, y: float, heading: float, curvature: float, length: float) -> tuple[float, float, float]:
    """The pose after a leg."""
    if abs(curvature) < 1e-9:
        return x + length * math.cos(heading), y + length * math.sin(heading), heading
    after = heading + curvature * length
    return (
        x + (math.sin(after) - math.sin(heading)) / curvature,
        y - (math.cos(after) - math.cos(heading)) / curvature,
        after,
    )


@jit
def _wrap(angle: float) -> float:
    """In [0, 2π); what rounding put just below a full turn is none."""
    angle = angle % _TAU
    return 0.0 if angle > _TAU - 1e-9 else angle


@jit
def to_point(x0: float, y0: float, h0: float, x1: float, y1: float, radius: float, word: int, legs: Floats) -> float:
    """Fill ``legs`` (2, 2) with the way of one of the four words to a place, whatever the heading there."""
    side = 1.0 if word in (0, 2) else -1.0
    # In a frame with the start at the origin, heading along x, the first turn to the left.
    dx, dy = x1 - x0, y1 - y0
    u = dx * math.cos(h0) + dy * math.sin(h0)
    v = side * (dy * math.cos(h0) - dx * math.sin(h0))
    if word < 2:
        square = u * u + (v - radius) ** 2 - radius * radius
        if square < -1e-9 * radius * radius:
            return np.inf  # within the circle
        straight = math.sqrt(max(square, 0.0))
        turn = _wrap(math.atan2(v - radius, u) + math.atan2(radius, straight))
        legs[0, 0], legs[0, 1] = side / radius, turn * radius
        legs[1, 0], legs[1, 1] = 0.0, straight
        return turn * radius + straight
    # The second circle touches the first and passes the place.
    far = math.hypot(u, v - radius)
    if far > 3.0 * radius or far < radius:
        return np.inf
    cosine = (5.0 * radius * radius - far * far) / (4.0 * radius * radius)
    apex = math.acos(min(max(cosine, -1.0), 1.0))  # at the second centre, between the first and the place
    sine = math.sin(apex) * radius / far
    lean = math.atan2(sine, (4.0 * radius * radius + far * far - radius * radius) / (4.0 * radius * far))
    turn = _wrap(math.atan2(v - radius, u) + lean + math.pi / 2.0)
    second = _TAU - apex
    legs[0, 0], legs[0, 1] = side / radius, turn * radius
    legs[1, 0], legs[1, 1] = -side / radius, second * radius
    return (turn + second) * radius


STEP, BEND, LEAST = 0.125, 0.035, 0.01
"""between samples: s at most; radians turned at most (the first chord is half as much off the heading); s at least, as
six decimals would tell too little of the speed"""
GRAIN = 0.5
"""m along the way between the points at which heights are worked out"""
CHORD = 3.0
"""m: how long a straight piece of a bend is at most where it is checked"""
SIDEWAYS, UPWARDS = 0.96, 0.22
"""shares of the acceleration, for turning and for changing the slope: both together are 0.985 of it"""
PART = 0.985
"""of the greatest speeds is used"""
SLOW = 1.003
"""times the least speed is flown at least: straight pieces of a bend are a little shorter than it"""


class Wings(NamedTuple):
    """What one plane can do; m, m/s, m/s²."""

    radius: float
    vmin: float
    vmax: float
    amax: float
    climb: float
    descend: float

    @property
    def tightest(self) -> float:
        """m: the radius of its slowest turn."""
        return self.turn(self.vmin)

    def turn(self, speed: float) -> float:
        """m: the radius of the turn at a speed."""
        return (SLOW * speed) ** 2 / (SIDEWAYS * self.amax) * 1.001

    def slope(self, rise: float) -> float:
        """Metres of height a metre over the ground at most, at the least speed, up or down as ``rise`` is."""
        vertical = PART * (self.climb if rise >= 0.0 else self.descend)
        speed = SLOW * self.vmin
        return vertical / math.sqrt(max(speed * speed - vertical * vertical, 1e-6))


@jit
def way_clear(world: World, posts: Floats, squash: float, pose: Floats, legs: Floats, radius: float) -> bool:
    """Whether a way keeps ``radius`` from all obstacles, is inside, and keeps off the posts.

    ``posts``: (M, 4) x, y, z and how far to stay away, with heights counting for 1/``squash``.
    """
    x, y, z, heading = pose
    p, q = np.empty(3), np.empty(3)
    for k in range(len(legs)):
        curvature, length, rise = legs[k]
        most = 8.0 * CHORD if curvature == 0.0 else CHORD
        count = math.ceil(length / most)
        for _ in range(count):
            p[0], p[1], p[2] = x, y, z
            x, y, heading = advance(x, y, heading, curvature, length / count)
            z += rise / count
            q[0], q[1], q[2] = x, y, z
            if not segment_clear(world, p, q, radius) or not off_posts(posts, squash, p, q):
                return False
    return True


@jit
def off_posts(posts: Floats, squash: float, p: Floats, q: Floats) -> bool:
    """Whether a straight line keeps off the posts."""
    dx, dy, dz = q[0] - p[0], q[1] - p[1], (q[2] - p[2]) / squash
    length = dx * dx + dy * dy + dz * dz
    for k in range(len(posts)):
        ax, ay, az = posts[k, 0] - p[0], posts[k, 1] - p[1], (posts[k, 2] - p[2]) / squash
        share = min(1.0, max(0.0, (ax * dx + ay * dy + az * dz) / max(length, 1e-12)))
        ax, ay, az = ax - share * dx, ay - share * dy, az - share * dz
        if ax * ax + ay * ay + az * az < posts[k, 3] * posts[k, 3]:
            return False
    return True


@jit
def motion_clear(world: World, posts: Floats, squash: float, motion: Motion, radius: float) -> bool:
    """:func:`way_clear` of the straight pieces that are flown in the end."""
    for k in range(len(motion) - 1):
        p, q = motion[k, 1:], motion[k + 1, 1:]
        if not segment_clear(world, p, q, radius) or not off_posts(posts, squash, p, q):
            return False
    return True


def fly(pose: Floats, legs: Floats, wings: Wings, cap: float) -> Motion:
    """The samples of a way flown at one speed, as fast as it can be and no faster than ``cap``; empty where its least
    speed is too fast for a turn or a climb.

    From t = 0, equally spaced, the last one at the way's end exactly as far as the legs lead there.
    """
    ends = np.concatenate(([0.0], np.cumsum(legs[:, 1])))
    rises = np.concatenate(([0.0], np.cumsum(legs[:, 2])))
    slopes = legs[:, 2] / np.maximum(legs[:, 1], 1e-9)
    curvature = float(np.abs(legs[:, 0]).max())
    least = SLOW * wings.vmin
    speed = max(least, min(cap, PART * wings.vmax))
    speed = min(speed, math.sqrt(SIDEWAYS * wings.amax / max(curvature, 1e-9)))
    for slope in slopes[slopes != 0.0]:
        vertical = PART * (wings.climb if slope > 0.0 else wings.descend)
        speed = min(speed, vertical * math.sqrt(1.0 + slope * slope) / abs(slope))
    if speed < 0.9999 * least:
        return np.empty((0, 4))
    count = max(2, math.ceil(ends[-1] / GRAIN))
    along = np.linspace(0.0, ends[-1], count + 1)
    half = math.ceil(np.abs(np.diff(slopes)).max(initial=0.0) * speed**2 / (UPWARDS * wings.amax) / GRAIN / 2.0)
    height = _smooth(np.interp(along, ends, rises), half)
    gone = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(along), np.diff(height)))))
    step = max(LEAST, min(STEP, BEND / max(curvature * speed, 1e-9)))
    times = np.linspace(0.0, gone[-1] / speed, max(2, math.ceil(gone[-1] / speed / step)) + 1)
    where = np.interp(times * speed, gone, along)
    motion = np.column_stack((times, where, where, pose[2] + np.interp(where, along, height)))
    x, y, heading = pose[0], pose[1], pose[3]
    for k, (bend, length, _) in enumerate(legs):
        for n in np.flatnonzero((where >= ends[k]) & ((where < ends[k + 1]) | (k == len(legs) - 1))):
            motion[n, 1:3] = advance(x, y, heading, bend, min(where[n] - ends[k], length))[:2]
        x, y, heading = advance(x, y, heading, bend, length)
    return motion


def _smooth(height: Floats, half: int) -> Floats:
    """The mean over ``half`` points to either side; turned over at both ends, so that these stay where they are."""
    half = min(half, len(height) - 1)
    before, after = 2.0 * height[0] - height[half:0:-1], 2.0 * height[-1] - height[-2 : -half - 2 : -1]
    wide = np.concatenate((before, height, after))
    return np.convolve(wide, np.full(2 * half + 1, 1.0 / (2 * half + 1)), mode="valid")


def join(start: Floats, end: Floats, turn: float, word: int) -> Floats | None:
    """The legs of one word from a pose to a place, the rise spread evenly; None where there are none."""
    flat = np.empty((2, 2))
    length = to_point(start[0], start[1], start[3], end[0], end[1], turn, word, flat)
    flat = flat[flat[:, 1] > 1e-6]
    if not math.isfinite(length) or not len(flat):  # it is above or below the place: a word without a circle is no way
        return None
    rise = (end[2] - start[2]) * flat[:, 1] / length
    return np.ascontiguousarray(np.column_stack((flat, rise)))


def end_of(pose: Floats, legs: Floats) -> Floats:
    """(4,): the pose after the legs."""
    x, y, z, heading = pose
    for curvature, length, rise in legs:
        x, y, heading = advance(x, y, heading, curvature, length)
        z += rise
    return np.array([x, y, z, heading])


def gentle(legs: Floats, wings: Wings) -> bool:
    """Whether no leg climbs or descends more than the plane can at its least speed."""
    slopes = legs[:, 2] / np.maximum(legs[:, 1], 1e-9)
    return bool(np.all(slopes <= 0.95 * wings.slope(1.0)) and np.all(slopes >= -0.95 * wings.slope(-1.0)))
