"""Numba kernels of the space-time optimiser: who comes near whom, what is violated, and one Gauss-Newton step.

``place`` is (M, K + 1, 3): the knots of all at a common step ``h``, the N to be moved first, then those that only are
avoided. Each moved vehicle has a banded system of normal equations: ``band`` (N, 3 K + 3, 9) holds the lower half
(entry [row, b] is column row - b) and ``right`` (N, 3 K + 3) the right side. A violated constraint adds one row of
least squares that says by how much the knots it touches should move along its gradient.
"""

from __future__ import annotations

import numpy as np

from agents.planner.model.geometry import World, away, outside
from agents.planner.model.problem import Floats, Ints
from agents.planner.solve.jit import jit

BAND = 9
HELD = 1e9
FINE = 0.2  # s; knots nearer to each other than this may become samples of a plan
LOOK = 4.0  # radii
SPARE = 0.4  # of what is aimed at on top of the radius must be there: places are looked at one by one


@jit
def near_pairs(place: Floats, last: Ints, reach: Floats, free: int, squeeze: float, block: int, out: Ints) -> int:
    """Write (i, j, first knot) of pairs that may come within reach[i] + reach[j] during a block of knots; their number.

    Where that exceeds the rows of ``out``, only the first fit. ``squeeze`` is 1 / downwash; i < j, i < free.
    """
    count = 0
    total, knots = place.shape[0], place.shape[1]
    low = np.empty((total, 3))
    high = np.empty((total, 3))
    for first in range(0, knots - 1, block):
        end = min(first + block, knots - 1)
        for i in range(total):
            for axis in range(3):
                least = most = place[i, first, axis]
                for k in range(first + 1, end + 1):
                    value = place[i, k, axis]
                    if value < least:
                        least = value
                    if value > most:
                        most = value
                scale = squeeze if axis == 2 else 1.0
                low[i, axis] = least * scale - reach[i]
                high[i, axis] = most * scale + reach[i]
        order = np.argsort(low[:, 0])
        for a in range(total):
            i = order[a]
            if first >= last[i]:
                continue
            for b in range(a + 1, total):
                j = order[b]
                if low[j, 0] > high[i, 0]:
                    break
                if first >= last[j] or (i >= free and j >= free):
                    continue
                if low[j, 1] > high[i, 1] or low[i, 1] > high[j, 1] or low[j, 2] > high[i, 2] or low[i, 2] > high[j, 2]:
                    continue
                if count < out.shape[0]:
                    out[count, 0] = min(i, j)
                    out[count, 1] = max(i, j)
                    out[count, 2] = first
                count += 1
    return count


@jit
def add_row(
    band: Floats, right: Floats, knot: int, coef: Floats, n: int, gradient: Floats, weight: float, by: float
) -> None:
    """Add weight * (sum of coef[m] * gradient . move[knot + m] - by)² to a vehicle's least squares."""
    for m in range(n):
        for a in range(3):
            row = 3 * (knot + m) + a
            left = weight * coef[m] * gradient[a]
            right[row] += left * by
            for m2 in range(m + 1):
                for a2 in range(3 if m2 < m else a + 1):
                    band[row, 3 * (m - m2) + a - a2] += left * coef[m2] * gradient[a2]


@jit
def keep_apart(
    place: Floats,
    pairs: Ints,
    count: int,
    block: int,
    last: Ints,
    size: Floats,
    squeeze: float,
    extra: float,
    slide: float,
    h: float,
    band: Floats,
    right: Floats,
    hurt: Floats,
) -> None:
    """Add rows for each piece on which two come nearer than size[i] + size[j] + extra.

    ``slide`` 1 pushes them apart across their relative motion only (they pass beside each other), 0 along the line
    between them (one comes earlier, one later). ``hurt[i]`` becomes the depth by which i's true separation is broken.
    Axis by axis, because an expression of arrays would make new ones for each piece of each pair.
    """
    knots, free = place.shape[1], band.shape[0]
    rel = np.empty(3)
    step = np.empty(3)
    normal = np.empty(3)
    coef = np.empty(3)
    for p in range(count):
        i, j, first = pairs[p, 0], pairs[p, 1], pairs[p, 2]
        need = size[i] + size[j]
        target = need + extra
        for k in range(first, min(first + block, knots - 1)):
            if k >= last[i] or k >= last[j]:
                break
            along = 0.0
            length = 0.0
            for axis in range(3):
                scale = squeeze if axis == 2 else 1.0
                rel[axis] = (place[i, k, axis] - place[j, k, axis]) * scale
                step[axis] = (place[i, k + 1, axis] - place[j, k + 1, axis]) * scale - rel[axis]
                along += rel[axis] * step[axis]
                length += step[axis] * step[axis]
            share = 0.0
            if along < 0.0:
                share = min(1.0, -along / length)
            dist = 0.0
            forward = 0.0
            for axis in range(3):
                rel[axis] += share * step[axis]
                dist += rel[axis] * rel[axis]
                forward += rel[axis] * step[axis]
            if dist >= target * target:
                continue
            dist = np.sqrt(dist)
            if dist < need:
                hurt[i] = max(hurt[i], need - dist)
                hurt[j] = max(hurt[j], need - dist)
            across = slide * length / (length + 0.25 * h * h)
            size2 = 0.0
            for axis in range(3):
                normal[axis] = rel[axis] - (across * forward / length * step[axis] if length > 0.0 else 0.0)
                size2 += normal[axis] * normal[axis]
            if size2 < 1e-6:  # they meet head-on: both keep to the right
                normal[0], normal[1], normal[2] = step[1], -step[0], 0.0
                size2 = normal[0] * normal[0] + normal[1] * normal[1]
                if size2 < 1e-12:
                    normal[0], size2 = 1.0, 1.0
            size2 = np.sqrt(size2)
            now = 0.0
            for axis in range(3):
                normal[axis] /= size2
                now += normal[axis] * rel[axis]
            gap = target - now
            normal[2] *= squeeze
            coef[0], coef[1] = 1.0 - share, share
            both = 0.5 if j < free else 1.0
            add_row(band[i], right[i], k, coef, 2, normal, 1.0, both * gap)
            if j < free:
                add_row(band[j], right[j], k, coef, 2, normal, 1.0, -both * gap)


@jit
def keep_limits(
    world: World,
    place: Floats,
    i: int,
    limit: Floats,
    weights: Floats,
    h: float,
    extra: float,
    band: Floats,
    right: Floats,
    worst: Floats,
) -> None:
    """Add rows where vehicle i breaks obstacles, bounds, speed or acceleration.

    ``limit``: radius, vmax, amax, climb, descend. ``weights``: of a m/s and of a m/s² too much, over that of a metre.
    ``worst``: depth in obstacles or out of bounds (m), greatest speed and greatest acceleration over their limits. In
    one piece, because all of it goes along the same knots and keeps what it found at the last one.
    """
    last = place.shape[1] - 1
    radius, vmax, amax = limit[0], limit[1], limit[2]
    v = np.empty(3)
    coef = np.empty(3)
    normal = np.empty(3)
    fenced = len(world.fence) > 0
    stride = 0.25 if h <= FINE else 0.5
    spare = -1.0  # no obstacle is nearer than this on top of what is kept clear of them
    if len(world.solids) == 0:
        spare = np.inf
    worst[0], worst[1], worst[2] = 0.0, 0.0, 0.0
    # Anyone who starts or ends in contact with something may stay in contact until it has left, or once it comes near.
    at_start = away(world, place[i, 0, 0], place[i, 0, 1], place[i, 0, 2], radius + SPARE * extra, normal)
    at_goal = away(world, place[i, last, 0], place[i, last, 1], place[i, last, 2], radius + SPARE * extra, normal)
    for k in range(last):
        at_ends = at_start if k < last // 2 else at_goal
        speed = 0.0
        for axis in range(3):
            v[axis] = (place[i, k + 1, axis] - place[i, k, axis]) / h
            speed += v[axis] * v[axis]
        speed = np.sqrt(speed)
        worst[1] = max(worst[1], speed / vmax)
        coef[0], coef[1] = -1.0 / h, 1.0 / h
        if speed > vmax:
            add_row(band[i], right[i], k, coef, 2, v / speed, weights[0], vmax - speed)
        bound = limit[3] if v[2] > 0 else limit[4]
        if abs(v[2]) > bound:
            worst[1] = max(worst[1], abs(v[2]) / bound)
            sign = 1.0 if v[2] > 0 else -1.0
            up = np.array([0.0, 0.0, 1.0])
            add_row(band[i], right[i], k, coef, 2, up, weights[0], sign * bound - v[2])
        # Obstacles, at places along the piece at most a quarter of the radius apart (half of it for coarse knots)
        # where something is near.
        pieces = 1 if spare > speed * h and not fenced else max(1, int(np.ceil(speed * h / (stride * radius))))
        for m in range(pieces):
            share = m / pieces
            x = place[i, k, 0] + share * v[0] * h
            y = place[i, k, 1] + share * v[1] * h
            z = place[i, k, 2] + share * v[2] * h
            depth = 0.0
            if (m == 0 or fenced) and outside(world, x, y, z) > 0.0:
                depth = away(world, x, y, z, radius, normal)
                worst[0] = max(worst[0], depth - at_ends)
                depth += extra
            elif spare <= 0.0:
                depth = away(world, x, y, z, radius * (1.0 + LOOK) + extra, normal) - radius * LOOK
                spare = -depth
                worst[0] = max(worst[0], depth - (1.0 - SPARE) * extra - at_ends)
            if depth > 0.0:
                coef[0], coef[1] = 1.0 - share, share
                add_row(band[i], right[i], k, coef, 2, normal, 1.0, depth)
            spare -= speed * h / pieces
        for m in range(len(world.fence)):  # a piece cuts a corner deepest where it passes nearest to it
            x, y = world.fence[m, 0] - place[i, k, 0], world.fence[m, 1] - place[i, k, 1]
            square = (v[0] * v[0] + v[1] * v[1]) * h * h
            if square == 0.0 or x * x + y * y > 4.0 * square:
                continue
            share = min(1.0, max(0.0, (x * v[0] + y * v[1]) * h / square))
            x = place[i, k, 0] + share * v[0] * h
            y = place[i, k, 1] + share * v[1] * h
            z = place[i, k, 2] + share * v[2] * h
            if outside(world, x, y, z) > 0.0:
                depth = away(world, x, y, z, radius, normal)
                worst[0] = max(worst[0], depth - at_ends)
                coef[0], coef[1] = 1.0 - share, share
                add_row(band[i], right[i], k, coef, 2, normal, 1.0, depth + extra)
    for k in range(last + 1):
        before, after = max(k - 1, 0), min(k + 1, last)
        if k == 0:
            before = 1
        if k == last:
            after = last - 1
        size = 0.0
        for axis in range(3):
            v[axis] = (place[i, before, axis] - 2.0 * place[i, k, axis] + place[i, after, axis]) / (h * h)
            size += v[axis] * v[axis]
        size = np.sqrt(size)
        worst[2] = max(worst[2], size / amax)
        if size > amax:
            if k == 0 or k == last:
                coef[0] = 2.0 / (h * h)
                add_row(band[i], right[i], before, coef, 1, v / size, weights[1], amax - size)
            else:
                coef[0], coef[1], coef[2] = 1.0 / (h * h), -2.0 / (h * h), 1.0 / (h * h)
                add_row(band[i], right[i], k - 1, coef, 3, v / size, weights[1], amax - size)


@jit
def move(place: Floats, i: int, flat: bool, stiff: float, cap: float, h: float, band: Floats, right: Floats) -> float:
    """Solve vehicle i's least squares with ``stiff`` * |change of acceleration|², move its knots; by how far at most.

    Uses up ``band[i]`` and ``right[i]``. ``flat`` keeps the height; no knot moves further than ``cap``.
    """
    a, b = band[i], right[i]
    rows = b.shape[0]
    knots = rows // 3
    s = stiff / (h * h * h * h)
    for k in range(knots):
        for axis in range(3):
            row = 3 * k + axis
            if k == 0 or k == knots - 1:
                a[row, 0] += HELD * s
                b[row] = 0.0
                continue
            a[row, 0] += s * (9.0 if k == 1 or k == knots - 2 else 6.0) + 1e-6
            if k > 1:
                a[row, 3] -= 4.0 * s
            if k > 2:
                a[row, 6] += s
            if flat and axis == 2:
                a[row, 0] += HELD * s
                b[row] = 0.0
    for row in range(rows):  # Cholesky in place: a becomes the lower factor
        for d in range(min(row, BAND - 1), -1, -1):
            col = row - d
            total = a[row, d]
            for m in range(max(0, row - BAND + 1), col):
                total -= a[row, row - m] * a[col, col - m]
            if d > 0:
                a[row, d] = total / a[col, 0]
            else:
                a[row, 0] = np.sqrt(max(total, 1e-12))
    for row in range(rows):
        total = b[row]
        for d in range(1, min(row, BAND - 1) + 1):
            total -= a[row, d] * b[row - d]
        b[row] = total / a[row, 0]
    for row in range(rows - 1, -1, -1):
        total = b[row]
        for d in range(1, min(rows - 1 - row, BAND - 1) + 1):
            total -= a[row + d, d] * b[row + d]
        b[row] = total / a[row, 0]
    most = 0.0
    for k in range(1, knots - 1):
        most = max(most, b[3 * k] ** 2 + b[3 * k + 1] ** 2 + b[3 * k + 2] ** 2)
    most = np.sqrt(most)
    scale = min(1.0, cap / most) if most > 0.0 else 0.0
    for k in range(1, knots - 1):
        for axis in range(2 if flat else 3):
            place[i, k, axis] += scale * b[3 * k + axis]
    return float(most * scale)


@jit
def look(
    world: World,
    place: Floats,
    moved: Floats,
    limits: Floats,
    weights: Floats,
    h: float,
    extra: float,
    band: Floats,
    right: Floats,
    own: Floats,
) -> None:
    """:func:`keep_limits` for each vehicle that ``moved`` since; the others' ``own`` (N, 3) are as they were."""
    for i in range(band.shape[0]):
        if moved[i] != 0.0:
            keep_limits(world, place, i, limits[i], weights, h, extra, band, right, own[i])
            moved[i] = 0.0


@jit
def bend(
    place: Floats, flat: Floats, stiff: float, cap: float, h: float, band: Floats, right: Floats, moved: Floats
) -> float:
    """:func:`move` each vehicle that has rows, and clear these; how far the furthest went."""
    most = 0.0
    for i in range(band.shape[0]):
        if np.any(right[i] != 0.0):
            most = max(most, move(place, i, flat[i] != 0.0, stiff, cap, h, band, right))
            moved[i] = 1.0
            band[i] = 0.0
            right[i] = 0.0
    return float(most)
