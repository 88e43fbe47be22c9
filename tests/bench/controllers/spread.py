"""Times in µs, and what is said of many of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import msgspec
import numpy as np

from tests.bench.controllers.fake import Stick
from zmav.errors import Stale

LATEST = 4.0
"""s after which a stick's µs come again: what comes later is no effect of it"""


class Spread(msgspec.Struct):
    """Of times; all in µs but ``count``."""

    count: int
    median: float
    mean: float
    p99: float
    most: float
    times: list[float]
    """themselves, in the order they came"""


def spread(seconds: Iterable[float]) -> Spread:
    """Of times in seconds; raises :class:`~zmav.errors.Stale` where there is none."""
    row = np.array(list(seconds)) * 1e6
    if not len(row):
        raise Stale("nothing of what was measured came")
    return Spread(
        count=len(row),
        median=float(np.median(row)),
        mean=float(row.mean()),
        p99=float(np.quantile(row, 0.99)),
        most=float(row.max()),
        times=[round(float(each), 1) for each in row],
    )


def effects(moved: Sequence[Stick], seen: Sequence[Stick]) -> list[float]:
    """Seconds from each move of the stick to the first that shows it; moves that nothing shows are left out. Both in
    the order of time.
    """
    found, begin = [], 0
    for at, pwm in moved:
        while begin < len(seen) and seen[begin].at < at:
            begin += 1
        for each in seen[begin:]:
            if each.at - at > LATEST:
                break
            if each.pwm == pwm:
                found.append(each.at - at)
                break
    return found
