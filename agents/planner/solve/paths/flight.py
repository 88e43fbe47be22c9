"""A plane's way over the ground and in height, flown: how fast at each point, and where at which time.

A way is a pose (x, y, z, heading) and legs, one a row: curvature (1/m, left is positive), length over the ground (m),
rise over the leg (m, spread evenly). The speed is the greatest that the turns, the climb and the acceleration to the
next slower part leave (the usual two passes along the way). Where the slope changes, the height is averaged over some
metres, so that the change takes its time.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from agents.planner.model.geometry import segment_clear
from agents.planner.model.problem import Floats, Motion
from agents.planner.model.world import World
from agents.planner.solve.jit import jit
from agents.planner.solve.paths.dubins import advance

STEP, BEND, LEAST = 0.125, 0.035, 0.01
"""between samples: s at most; radians turned at most (the first chord is half as much off the heading); s at least, as
six decimals would tell too little of the speed"""
GRAIN = 0.5
"""m along the way between the points at which the speed is worked out"""
CHORD = 3.0
"""m: how long a straight piece of a bend is at most where it is checked"""
SIDEWAYS, UPWARDS, BOTH, ALTOGETHER = 0.96, 0.22, 0.985, 0.995
"""shares of the acceleration: for turning, for changing the slope, for both, and with a change of speed besides"""
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


@jit
def _profile(legs: Floats, grain: float, count: int, curvature: Floats, height: Floats) -> None:
    """The greatest curvature within each of ``count`` equal parts of the way, and the rise up to each part's end."""
    leg, begin, base = 0, 0.0, 0.0
    height[0] = 0.0
    for k in range(count):
        end = (k + 1) * grain
        curvature[k] = abs(legs[leg, 0])
        while leg < len(legs) - 1 and begin + legs[leg, 1] <= end:
            begin, base = begin + legs[leg, 1], base + legs[leg, 2]
            leg += 1
            if begin < end:
                curvature[k] = max(curvature[k], abs(legs[leg, 0]))
        height[k + 1] = base + legs[leg, 2] * min(1.0, (end - begin) / max(legs[leg, 1], 1e-9))


@jit
def _smooth(height: Floats, half: int) -> Floats:
    """The mean over ``half`` points to either side; turned over at both ends, so that these stay where they are."""
    count = len(height)
    sums = np.zeros(count + 2 * half + 1)
    for k in range(-half, count + half):
        if k < 0:
            value = 2.0 * height[0] - height[min(-k, count - 1)]
        elif k >= count:
            value = 2.0 * height[-1] - height[max(2 * (count - 1) - k, 0)]
        else:
            value = height[k]
        sums[k + half + 1] = sums[k + half] + value
    out = np.empty(count)
    for k in range(count):
        out[k] = (sums[k + 2 * half + 1] - sums[k]) / (2 * half + 1)
    return out


@jit
def _speeds(curvature: Floats, height: Floats, grain: float, wings: Wings, cap: float) -> Floats:
    """Speeds at the ends of the parts (m/s); empty where the least speed is too fast for a turn or a climb."""
    count = len(curvature)
    least = SLOW * wings.vmin
    speed = np.full(count + 1, max(least, min(cap, PART * wings.vmax)))
    bent = np.empty(count)
    for k in range(count):
        slope = (height[k + 1] - height[k]) / grain
        before = (height[k] - height[k - 1]) / grain if k > 0 else slope
        after = (height[k + 2] - height[k + 1]) / grain if k < count - 1 else slope
        bent[k] = math.hypot(curvature[k], max(abs(slope - before), abs(after - slope)) / grain)
        share = BOTH if bent[k] > curvature[k] else SIDEWAYS
        most = math.sqrt(share * wings.amax / max(bent[k], 1e-9))
        vertical = PART * (wings.climb if slope > 0.0 else wings.descend)
        if slope != 0.0:
            most = min(most, vertical * math.sqrt(1.0 + slope * slope) / abs(slope))
        if most < least * 0.9999:
            return np.empty(0)
        speed[k], speed[k + 1] = min(speed[k], max(most, least)), min(speed[k + 1], max(most, least))
    for turn in range(2):
        for n in range(count):
            k = n if turn == 0 else count - n
            part, after_it = (k, k + 1) if turn == 0 else (k - 1, k - 1)
            sideways = bent[part] * speed[k] * speed[k]
            left = math.sqrt(max((ALTOGETHER * wings.amax) ** 2 - sideways * sideways, 0.0))
            speed[after_it] = min(speed[after_it], math.sqrt(speed[k] * speed[k] + 2.0 * left * grain))
    return speed


@jit
def fly(pose: Floats, legs: Floats, wings: Wings, cap: float) -> Motion:
    """The samples of a way flown as fast as it can be, and no faster than ``cap``; empty where it cannot be flown.

    From t = 0, equally spaced, the last one at the way's end exactly as far as the legs lead there.
    """
    total = legs[:, 1].sum()
    count = max(2, math.ceil(total / GRAIN))
    grain = total / count
    curvature, height = np.empty(count), np.empty(count + 1)
    _profile(legs, grain, count, curvature, height)
    bend = 0.0
    for k in range(1, count):
        bend = max(bend, abs(height[k + 1] - 2.0 * height[k] + height[k - 1]) / grain)
    speed = np.empty(0)
    if bend <= 1e-6:
        speed = _speeds(curvature, height, grain, wings, cap)
    sharp = height
    for wider in range(1, 4):  # where slopes change in the tightest turns they may have to change more slowly
        half = math.ceil(wider * bend * (SLOW * wings.vmin) ** 2 / (UPWARDS * wings.amax) / grain / 2.0)
        if len(speed) > 0 or bend <= 1e-6 or half >= count:
            break
        height = _smooth(sharp, half)
        speed = _speeds(curvature, height, grain, wings, cap)
    if len(speed) == 0:
        return np.empty((0, 4))
    times = np.zeros(count + 1)
    for k in range(count):
        way = math.hypot(grain, height[k + 1] - height[k])
        times[k + 1] = times[k] + 2.0 * way / (speed[k] + speed[k + 1])
    step = min(STEP, BEND / max((np.abs(curvature) * speed[:count]).max(), 1e-9))
    return _sample(pose, legs, grain, times, speed, height, max(step, LEAST))


@jit
def _sample(
    pose: Floats, legs: Floats, grain: float, times: Floats, speed: Floats, height: Floats, step: float
) -> Motion:
    """Where it is at equal steps of time, of ``step`` s at most; within a part the acceleration is constant."""
    steps = max(2, math.ceil(times[-1] / step))
    motion = np.empty((steps + 1, 4))
    x, y, z, heading = pose
    part, leg, begin = 0, 0, 0.0
    for n in range(steps + 1):
        t = times[-1] * n / steps
        while part < len(times) - 2 and times[part + 1] <= t:
            part += 1
        lasts = times[part + 1] - times[part]
        into = min(max(t - times[part], 0.0), lasts)
        way = (speed[part] + (speed[part + 1] - speed[part]) * into / lasts / 2.0) * into
        share = min(1.0, way / ((speed[part] + speed[part + 1]) / 2.0 * lasts))
        s = (part + share) * grain
        while leg < len(legs) - 1 and begin + legs[leg, 1] <= s:
            x, y, heading = advance(x, y, heading, legs[leg, 0], legs[leg, 1])
            begin += legs[leg, 1]
            leg += 1
        px, py, _ = advance(x, y, heading, legs[leg, 0], min(s - begin, legs[leg, 1]))
        motion[n, 0], motion[n, 1], motion[n, 2] = t, px, py
        motion[n, 3] = z + height[part] + (height[part + 1] - height[part]) * share
    return motion


@jit
def apart(a: Motion, b: Motion, keep: float, squash: float, a_leaves: bool, b_leaves: bool) -> bool:
    """Whether two motions keep ``keep`` from each other at every instant, heights counting for 1/``squash``.

    Between two samples of either the difference goes straight, so that the least distance has a closed form. Before
    its first sample each is there; after its last one it is gone where it leaves.
    """
    begin = min(a[0, 0], b[0, 0])
    end = max(a[-1, 0], b[-1, 0])
    if a_leaves:
        end = min(end, a[-1, 0])
    if b_leaves:
        end = min(end, b[-1, 0])
    i, j, t, least = 0, 0, begin, keep * keep
    ax, ay, az = a[0, 1] - b[0, 1], a[0, 2] - b[0, 2], (a[0, 3] - b[0, 3]) / squash
    if begin > end:
        return True
    while True:
        if ax * ax + ay * ay + az * az < least:
            return False
        if t >= end:
            return True
        while i < len(a) - 1 and a[i + 1, 0] <= t:
            i += 1
        while j < len(b) - 1 and b[j + 1, 0] <= t:
            j += 1
        after = end
        if t < a[i, 0]:
            after = min(after, a[i, 0])
        elif i < len(a) - 1:
            after = min(after, a[i + 1, 0])
        if t < b[j, 0]:
            after = min(after, b[j, 0])
        elif j < len(b) - 1:
            after = min(after, b[j + 1, 0])
        u, v = _share(a, i, after), _share(b, j, after)
        bx, by = _place(a, i, u, 1) - _place(b, j, v, 1), _place(a, i, u, 2) - _place(b, j, v, 2)
        bz = (_place(a, i, u, 3) - _place(b, j, v, 3)) / squash
        dx, dy, dz = bx - ax, by - ay, bz - az
        length = dx * dx + dy * dy + dz * dz
        share = -(ax * dx + ay * dy + az * dz) / max(length, 1e-300)
        if 0.0 < share < 1.0:
            cx, cy, cz = ax + share * dx, ay + share * dy, az + share * dz
            if cx * cx + cy * cy + cz * cz < least:
                return False
        ax, ay, az, t = bx, by, bz, after


@jit
def _share(motion: Motion, k: int, t: float) -> float:
    """How far the piece from sample ``k`` on is done at ``t``."""
    if k >= len(motion) - 1:
        return 0.0
    return float(min(1.0, max(0.0, (t - motion[k, 0]) / (motion[k + 1, 0] - motion[k, 0]))))


@jit
def _place(motion: Motion, k: int, share: float, axis: int) -> float:
    last = min(k + 1, len(motion) - 1)
    return float(motion[k, axis] + share * (motion[last, axis] - motion[k, axis]))
