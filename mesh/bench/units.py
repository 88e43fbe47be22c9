"""Rates and sizes as people write them, and as iperf prints them: decimal, bits for rates, bytes for transfers."""

from __future__ import annotations

import math
import re

from zmav.errors import BadInput

_RATE = re.compile(r"\s*([0-9]*\.?[0-9]+)\s*([kMG]?)(bit/s|bps|b/s|B/s|)\s*\Z")
_FACTOR = {"": 1.0, "k": 1e3, "M": 1e6, "G": 1e9}


def bits_per_second(text: str, field: str = "rate") -> float:
    """``1 Mbit/s``, ``60kB/s`` or ``500k`` (bits); raises :class:`BadInput`."""
    found = _RATE.match(text)
    value = float(found[1]) * _FACTOR[found[2]] * (8.0 if found[3] == "B/s" else 1.0) if found else 0.0
    if not (math.isfinite(value) and value > 0.0):
        expected = "1Mbit/s, 60kB/s or the like"
        raise BadInput(f"{field} {text!r}: expected {expected}", field=field, value=text, expected=expected)
    return value


def rate(bits: float) -> str:
    """Bits a second."""
    return _scaled(bits, (("Gbit/s", 1e9), ("Mbit/s", 1e6), ("kbit/s", 1e3)), "bit/s")


def size(count: float) -> str:
    """Bytes."""
    return _scaled(count, (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)), "B")


def duration(seconds: float) -> str:
    if abs(seconds) >= 1.0:
        return f"{seconds:.2f} s"
    if abs(seconds) >= 1e-3:
        return f"{1e3 * seconds:.2f} ms"
    return f"{1e6 * seconds:.0f} µs"


def _scaled(value: float, units: tuple[tuple[str, float], ...], least: str) -> str:
    for name, factor in units:
        if value >= factor:
            return f"{value / factor:.2f} {name}"
    return f"{value:.0f} {least}"
