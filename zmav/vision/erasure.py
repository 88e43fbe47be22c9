"""Spare chunks of which any mend as many lost ones: a Reed-Solomon code over GF(2^8) by Cauchy matrices.

A picture a second torn is no loss, but of video each torn access unit costs all up to the next key frame, and most are
of a few chunks only, where :mod:`zmav.vision.parity` would send more than the unit itself. Spare chunk j of a group
is the sum of its chunks i, each times 1 / (i + x_j) with x_j = 255 - j: every square part of such a matrix can be
inverted. Source: Bloemer et al., "An XOR-based erasure-resilient coding scheme", 1995; the field is that of x^8 + x^4
+ x^3 + x^2 + 1.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence

GROUP = 100
"""chunks that are mended together at most: chunk i is of group i modulo the number of groups"""
MOST = 120
"""spare chunks of a unit"""
TORN = 0.005
"""share of units that may stay torn"""


def _powers() -> list[int]:
    """Of the field's generator 2, twice around, so that sums of logarithms need no remainder."""
    found, value = [], 1
    for _ in range(255):
        found.append(value)
        value = (value << 1) ^ (0x11D if value & 0x80 else 0)
    return found * 2


EXP = _powers()
LOG = {value: power for power, value in enumerate(EXP[:255])}


@functools.cache
def _times(factor: int) -> bytes:
    """The table by which ``bytes.translate`` multiplies each byte with ``factor``, which is not 0."""
    return bytes([0] + [EXP[LOG[factor] + LOG[value]] for value in range(1, 256)])


def _inverse(value: int) -> int:
    return EXP[255 - LOG[value]]


def _weight(place: int, spare: int) -> int:
    return _inverse(place ^ (255 - spare))


def _scaled(factor: int, data: bytes) -> int:
    return int.from_bytes(data.translate(_times(factor)), "little")


def groups_of(count: int) -> int:
    return -(-count // GROUP)


def encode(chunks: Sequence[bytes], size: int, spare: int) -> list[bytes]:
    """``spare`` chunks of ``size`` bytes for chunks of data that are at most so long (shorter ones: zeros follow)."""
    groups = groups_of(len(chunks))
    found = []
    for number in range(spare):
        row, total = number // groups, 0
        for place, chunk in enumerate(chunks[number % groups :: groups]):
            total ^= _scaled(_weight(place, row), chunk)
        found.append(total.to_bytes(size, "little"))
    return found


def mend(count: int, size: int, data: Mapping[int, bytes], spare: Mapping[int, bytes]) -> list[bytes] | None:
    """All ``count`` chunks of data, each filled up to ``size`` bytes; None where what came is not enough."""
    groups = groups_of(count)
    torn = []
    for group in range(groups):  # before anything is computed: this is asked again with each chunk that comes
        places = range(group, count, groups)
        missing = [i for i in places if i not in data]
        rows = [j for j in sorted(spare) if j % groups == group][: len(missing)]
        if len(rows) < len(missing) or any(j // groups >= 256 - len(places) for j in rows):
            return None
        torn.append((places, missing, rows))
    whole = {i: chunk.ljust(size, b"\0") for i, chunk in data.items()}
    for places, missing, rows in torn:
        equations = []
        for j in rows:
            total = int.from_bytes(spare[j], "little")
            for i in places:
                if i in data:
                    total ^= _scaled(_weight(i // groups, j // groups), whole[i])
            equations.append(([_weight(i // groups, j // groups) for i in missing], total.to_bytes(size, "little")))
        whole.update(zip(missing, _solved(equations), strict=True))
    return [whole[i] for i in range(count)]


def _solved(equations: list[tuple[list[int], bytes]]) -> list[bytes]:
    """Gauss-Jordan: what the unknowns are. Each part of a Cauchy matrix is regular, and so is what remains of it."""
    rows = list(equations)
    for at in range(len(rows)):
        pivot = next(k for k in range(at, len(rows)) if rows[k][0][at])
        rows[at], rows[pivot] = rows[pivot], rows[at]
        factor = _times(_inverse(rows[at][0][at]))
        weights, value = [factor[w] for w in rows[at][0]], rows[at][1].translate(factor)
        rows[at] = weights, value
        for k, (others, total) in enumerate(rows):
            if k != at and others[at]:
                times = _times(others[at])
                less = int.from_bytes(total, "little") ^ int.from_bytes(value.translate(times), "little")
                rows[k] = (
                    [a ^ times[w] for a, w in zip(others, weights, strict=True)],
                    less.to_bytes(len(value), "little"),
                )
    return [value for _, value in rows]


@functools.lru_cache(4096)
def needed(count: int, percent: int) -> int:
    """How many spare chunks mend all but :data:`TORN` of units of ``count`` chunks, of which ``percent`` are lost."""
    loss, groups = min(max(percent, 0), 60) / 100.0, groups_of(count)
    size = -(-count // groups)
    for spare in range(1, MOST // groups + 1):
        sent = size + spare
        torn = 1.0 - sum(math.comb(sent, k) * loss**k * (1.0 - loss) ** (sent - k) for k in range(spare + 1))
        if torn * groups <= TORN:
            return spare * groups
    return MOST // groups * groups
