"""Spare chunks from which lost ones are computed: sums over GF(2), that is XOR.

Parity chunk 0 is the XOR of all chunks of data, and mends any one of them. Parity chunk j > 0 is the XOR of a half of
them that looks random and is the same everywhere: bit i of SHAKE-128 of the two numbers (count, j). Any chunks that
came, data or parity, are equations; as many as there are chunks of data mend everything but for bad luck, and each one
more halves that bad luck. Source: random linear codes, MacKay, "Information Theory, Inference, and Learning
Algorithms", chapters 14 and 50.1.
"""

from __future__ import annotations

import hashlib
import math
import struct
from collections.abc import Mapping, Sequence

MOST = 255
"""parity chunks of one picture"""
TORN = 0.015
"""share of pictures that may stay torn"""


def cover(count: int, index: int) -> int:
    """Which chunks of data parity chunk ``index`` is the XOR of: bit i for chunk i of ``count``."""
    everything = (1 << count) - 1
    if index == 0:
        return everything
    digest = hashlib.shake_128(struct.pack(">HH", count, index)).digest((count + 7) // 8)
    return int.from_bytes(digest, "little") & everything


def encode(chunks: Sequence[bytes], size: int, parity: int) -> list[bytes]:
    """``parity`` chunks of ``size`` bytes for chunks of data that are at most so long (shorter ones: zeros follow)."""
    numbers = [int.from_bytes(chunk, "little") for chunk in chunks]
    return [_sum(numbers, cover(len(chunks), index)).to_bytes(size, "little") for index in range(parity)]


def mend(count: int, size: int, data: Mapping[int, bytes], parity: Mapping[int, bytes]) -> list[bytes] | None:
    """All ``count`` chunks of data, each filled up to ``size`` bytes; None where what came is not enough."""
    missing = [i for i in range(count) if i not in data]
    if len(parity) < len(missing):
        return None
    known = [int.from_bytes(data[i], "little") if i in data else 0 for i in range(count)]
    solved = _solve(missing, [(cover(count, j), int.from_bytes(p, "little")) for j, p in parity.items()], known)
    if solved is None:
        return None
    return [(solved[i] if i in solved else known[i]).to_bytes(size, "little") for i in range(count)]


def _solve(missing: list[int], sums: list[tuple[int, int]], known: list[int]) -> dict[int, int] | None:
    """Gauss-Jordan over GF(2): each missing chunk's bytes as a number, from (which chunks, their XOR)."""
    wanted = sum(1 << i for i in missing)
    rows: dict[int, tuple[int, int]] = {}  # lowest bit -> an equation in which that chunk stands, and in no other row
    for which, value in sums:
        if len(rows) == len(missing):
            break
        value ^= _sum(known, which & ~wanted)
        which &= wanted
        for bit, (others, total) in rows.items():
            if which & bit:
                which, value = which ^ others, value ^ total
        if which:
            bit = which & -which
            for at, (others, total) in rows.items():
                if others & bit:
                    rows[at] = others ^ which, total ^ value
            rows[bit] = which, value
    return {bit.bit_length() - 1: value for bit, (_, value) in rows.items()} if len(rows) == len(missing) else None


def _sum(numbers: Sequence[int], which: int) -> int:
    total = 0
    while which:
        bit = which & -which
        total ^= numbers[bit.bit_length() - 1]
        which ^= bit
    return total


def needed(count: int, loss: float) -> int:
    """How many parity chunks mend nearly all pictures of ``count`` chunks where a share ``loss`` of chunks is lost.

    With l chunks of data lost and p of parity there, about 2^(l - p) of pictures stay torn. Its mean over all l > 1 is
    in closed form; one lost chunk is mended by the first parity chunk alone, or by every second of the others.
    """
    if not loss < 1.0:
        return MOST
    one = count * loss * (1.0 - loss) ** (count - 1)
    more = (1.0 + loss) ** count - (1.0 - loss) ** count - 2.0 * one
    torn = max(more, 0.0) + one * loss * 2.0 / (1.0 + loss)
    if torn <= TORN:
        return 1
    return min(math.ceil(math.log(torn / TORN) / math.log(2.0 / (1.0 + loss))), MOST)
