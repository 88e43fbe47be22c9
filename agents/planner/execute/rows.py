"""A vehicle's points as they are sent: what lies behind is left out, and where it rests it stays.

Rows are t, place, velocity; times are ours, ENU.
"""

from __future__ import annotations

import numpy as np

from agents.planner.execute.commit import Entry
from agents.planner.execute.track import REST_EVERY, Profile
from agents.planner.model.problem import Floats

SAME = 0.01
"""s within which two points of a trajectory are one: they are rounded on the wire"""


def standing(place: Floats, now: float) -> Entry:
    """Where it stands when it begins; nothing was sent for that."""
    row = np.concatenate(([0.0], np.round(place, 5), np.zeros(3)))
    rows = np.array([row, row])
    rows[:, 0] = (now - 1.0, now)
    return Entry(Profile.resting(0.0, now), rows, now, now)


def knot(entry: Entry, at: float) -> float:
    """The first of its points at ``at`` or later; after the last, any time will do."""
    times = entry.rows[:, 0]
    later = times[times >= at]
    return float(later[0]) if len(later) else max(at, float(times[-1]) + 0.1)


def head_of(before: Entry, d: float, now: float) -> Floats:
    """The points of what is known up to ``d``, from just before now; where it rests by then, its place."""
    rows = before.rows
    if d <= rows[-1, 0]:
        return ahead(rows[rows[:, 0] < d + SAME], now)
    moving = rows[rows[:, 0] > now - 0.3]
    rest = rows[-1].copy()
    rest[4:] = 0.0
    if not len(moving):
        times = np.arange(now - 0.3, d - 0.1, REST_EVERY)
        head = np.array([rest] * (len(times) + 1))
        head[:, 0] = np.round([*times, d], 6)
        return head
    rest[0] = d
    return np.vstack((ahead(rows, now), rest))


def ahead(rows: Floats, now: float) -> Floats:
    """Without what lies behind, but for the last point before now."""
    first = max(int(np.searchsorted(rows[:, 0], now - 0.2)) - 1, 0)
    return rows[min(first, len(rows) - 2) :]
