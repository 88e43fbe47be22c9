"""Rates, sizes and times as people read them: decimal, bits for rates, bytes for transfers. Each writes a dash for what
is not known.
"""

from __future__ import annotations


def rate(bits: float | None) -> str:
    """Bits a second."""
    return _scaled(bits, (("Gbit/s", 1e9), ("Mbit/s", 1e6), ("kbit/s", 1e3)), "bit/s")


def size(count: float | None) -> str:
    """Bytes."""
    return _scaled(count, (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)), "B")


def duration(seconds: float | None) -> str:
    return _scaled(seconds, (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)), "s")


def milliseconds(seconds: float | None) -> str:
    """Three digits, without the unit."""
    if seconds is None:
        return "-"
    value = 1e3 * seconds
    return f"{value:.2f}" if value < 10.0 else f"{value:.1f}" if value < 100.0 else f"{value:.0f}"


def percent(share: float | None) -> str:
    if share is None:
        return "-"
    return f"{share:.1%}" if 0.0 < share < 0.1 else f"{share:.0%}"


def _scaled(value: float | None, units: tuple[tuple[str, float], ...], least: str) -> str:
    if value is None:
        return "-"
    for name, factor in units:
        if abs(value) >= factor:
            return f"{value / factor:.2f} {name}"
    return f"{value:.0f} {least}"
