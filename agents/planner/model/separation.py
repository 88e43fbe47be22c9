"""How near two motions come to each other: exact between the samples, at every instant.

The distance is the scene's, sqrt(dx² + dy² + (dz/c)²) with the downwash c. A motion's first position is held before its
first sample and the last one after its last, unless it leaves. Within an interval in which both motions are straight
their difference is straight too, so its least length has a closed form.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agents.planner.model.problem import Floats, Ints, Motion
from agents.planner.solve.jit import jit

WINDOW, WINDOWS = 1.6, 1000
"""s: motions whose boxes during so long are apart need no closer look; and how many of these there are at most"""


@jit
def place_at(motion: Motion, k: int, t: float) -> tuple[float, float, float]:
    """Where a motion is at ``t``, which is between its samples ``k`` and ``k + 1`` (-1: before the first)."""
    last = motion.shape[0] - 1
    if k < 0:
        return motion[0, 1], motion[0, 2], motion[0, 3]
    if k >= last:
        return motion[last, 1], motion[last, 2], motion[last, 3]
    u = (t - motion[k, 0]) / (motion[k + 1, 0] - motion[k, 0])
    return (
        motion[k, 1] + u * (motion[k + 1, 1] - motion[k, 1]),
        motion[k, 2] + u * (motion[k + 1, 2] - motion[k, 2]),
        motion[k, 3] + u * (motion[k + 1, 3] - motion[k, 3]),
    )


@jit
def last_until(motion: Motion, t: float) -> int:
    """The index of the last sample at or before ``t``; -1 where there is none."""
    low, high = 0, motion.shape[0]
    while low < high:
        middle = (low + high) // 2
        if motion[middle, 0] <= t:
            low = middle + 1
        else:
            high = middle
    return low - 1


@jit
def closest(a: Motion, b: Motion, inverse: float, begin: float, end: float) -> tuple[float, float]:
    """The least scaled distance of two motions within [begin, end], and when it first is so small.

    ``inverse`` is 1 / downwash; ``end`` may be infinite.
    """
    i, j = last_until(a, begin), last_until(b, begin)
    ax, ay, az = place_at(a, i, begin)
    bx, by, bz = place_at(b, j, begin)
    dx, dy, dz = bx - ax, by - ay, (bz - az) * inverse
    least, when, t = dx * dx + dy * dy + dz * dz, begin, begin
    while t < end:
        ta = a[i + 1, 0] if i + 1 < a.shape[0] else np.inf
        tb = b[j + 1, 0] if j + 1 < b.shape[0] else np.inf
        then = min(ta, tb, end)
        if then == np.inf:
            break
        ax, ay, az = place_at(a, i, then)
        bx, by, bz = place_at(b, j, then)
        fx, fy, fz = bx - ax, by - ay, (bz - az) * inverse
        ex, ey, ez = fx - dx, fy - dy, fz - dz
        square = ex * ex + ey * ey + ez * ez
        u = 1.0
        if square > 0.0:
            u = min(1.0, max(0.0, -(dx * ex + dy * ey + dz * ez) / square))
        gx, gy, gz = dx + u * ex, dy + u * ey, dz + u * ez
        distance = gx * gx + gy * gy + gz * gz
        if distance < least:
            least, when = distance, t + u * (then - t)
        dx, dy, dz, t = fx, fy, fz, then
        if then == ta:
            i += 1
        if then == tb:
            j += 1
    return np.sqrt(least), when


@jit
def least_between(
    a: Motion, b: Motion, inverse: float, a_leaves: bool, b_leaves: bool, since: float
) -> tuple[float, float]:
    """The least scaled distance from ``since`` on (-inf: ever), and when; inf where one is gone by then."""
    begin = max(since, min(a[0, 0], b[0, 0]))
    end = np.inf
    if a_leaves:
        end = a[a.shape[0] - 1, 0]
    if b_leaves:
        end = min(end, b[b.shape[0] - 1, 0])
    if begin > end:
        return np.inf, begin
    return closest(a, b, inverse, begin, end)


def separation(
    a: Motion, b: Motion, downwash: float, *, a_leaves: bool = False, b_leaves: bool = False, since: float = -np.inf
) -> tuple[float, float]:
    """The least scaled distance (m) of two (T, 4) motions from ``since`` on, and the time when it is reached first."""
    distance, when = least_between(
        np.ascontiguousarray(a), np.ascontiguousarray(b), 1.0 / downwash, a_leaves, b_leaves, since
    )
    return float(distance), float(when)


@jit
def _boxes(
    samples: Floats, offsets: Ints, leaves: Ints, inverse: float, start: float, width: float, count: int
) -> Floats:
    """(N, count, 6): what each motion touches within each window of time, z scaled; inside out where it is gone."""
    boxes = np.empty((offsets.shape[0] - 1, count, 6))
    boxes[:, :, :3] = np.inf
    boxes[:, :, 3:] = -np.inf
    for n in range(boxes.shape[0]):
        motion = samples[offsets[n] : offsets[n + 1]]
        end = motion[motion.shape[0] - 1, 0]
        for w in range(count):
            t = start + w * width
            if leaves[n] and t > end:
                break
            k = last_until(motion, t)
            then = t + width
            while True:
                place = place_at(motion, k, t)
                for axis in range(3):
                    value = place[axis] * (inverse if axis == 2 else 1.0)
                    boxes[n, w, axis] = min(boxes[n, w, axis], value)
                    boxes[n, w, 3 + axis] = max(boxes[n, w, 3 + axis], value)
                if t >= then:
                    break
                k += 1
                t = then
                if k < motion.shape[0] and motion[k, 0] < then:
                    t = motion[k, 0]
                else:
                    k -= 1
    return boxes


@jit
def _gap(a: Floats, b: Floats) -> float:
    """The distance of two boxes (6,); 0 where they overlap."""
    dx = max(0.0, a[0] - b[3], b[0] - a[3])
    dy = max(0.0, a[1] - b[4], b[1] - a[4])
    dz = max(0.0, a[2] - b[5], b[2] - a[5])
    return float(np.sqrt(dx * dx + dy * dy + dz * dz))


@jit
def _pairs(
    samples: Floats,
    offsets: Ints,
    radius: Floats,
    leaves: Ints,
    own: int,
    inverse: float,
    start: float,
    width: float,
    boxes: Floats,
    tolerance: float,
    found: Floats,
) -> tuple[int, int, int, float, float]:
    """Every pair with one of the first ``own`` in it.

    ``found``: rows i, j, least distance, time of those that are too near. Gives how many these are, and the pair with
    the least clearance: i, j, clearance, time.
    """
    count, n, windows = 0, boxes.shape[0], boxes.shape[1]
    best, best_i, best_j, best_t = np.inf, -1, -1, start
    for i in range(min(own, n)):
        a = samples[offsets[i] : offsets[i + 1]]
        for j in range(i + 1, n):
            b = samples[offsets[j] : offsets[j + 1]]
            end = a[a.shape[0] - 1, 0] if leaves[i] else np.inf
            if leaves[j]:
                end = min(end, b[b.shape[0] - 1, 0])
            need = radius[i] + radius[j]
            least, when = np.inf, start
            for w in range(windows):
                if _gap(boxes[i, w], boxes[j, w]) >= min(least, need + max(best, 0.0)):
                    continue
                begin = start + w * width
                distance, t = closest(a, b, inverse, begin, min(end, begin + width))
                if distance < least:
                    least, when = distance, t
            if least - need < best:
                best, best_i, best_j, best_t = least - need, i, j, when
            if least - need < -tolerance and count < found.shape[0]:
                found[count, 0], found[count, 1], found[count, 2], found[count, 3] = i, j, least, when
                count += 1
    return count, best_i, best_j, best, best_t


def all_pairs(
    motions: Sequence[Motion],
    radius: Floats,
    leaves: Sequence[bool],
    downwash: float,
    own: int | None = None,
    tolerance: float = 0.0,
) -> tuple[Floats, tuple[int, int, float, float]]:
    """Every pair of motions that has one of the first ``own`` (None: all) in it, from when the first of these begins.

    Gives those that come nearer than the sum of their radii less ``tolerance`` as rows i, j, distance, time, and the
    pair with the least clearance as i, j, clearance (distance less radii), time; -1, -1, inf, 0 where there is no pair.
    """
    if len(motions) < 2:
        return np.empty((0, 4)), (-1, -1, np.inf, 0.0)
    offsets = np.cumsum([0, *(len(motion) for motion in motions)], dtype=np.int64)
    samples = np.ascontiguousarray(np.concatenate(motions), dtype=np.float64)
    own = len(motions) if own is None else own
    start = float(min(motion[0, 0] for motion in motions[: max(1, own)]))
    span = max(float(motion[-1, 0]) for motion in motions) - start
    gone = np.array(leaves, dtype=np.int64)
    width = max(WINDOW, span / (WINDOWS - 1))
    boxes = _boxes(samples, offsets, gone, 1.0 / downwash, start, width, int(max(0.0, span) / width) + 1)
    found = np.empty((4096, 4))
    count, i, j, clearance, when = _pairs(
        samples, offsets, radius, gone, own, 1.0 / downwash, start, width, boxes, tolerance, found
    )
    return found[:count], (int(i), int(j), float(clearance), float(when))
