"""Figures as tables and labels show them; a dash for what is not known."""

from __future__ import annotations


def milliseconds(seconds: float | None) -> str:
    """Three digits."""
    if seconds is None:
        return "-"
    value = 1e3 * seconds
    return f"{value:.2f}" if value < 10.0 else f"{value:.1f}" if value < 100.0 else f"{value:.0f}"


def percent(share: float | None) -> str:
    if share is None:
        return "-"
    return f"{share:.1%}" if 0.0 < share < 0.1 else f"{share:.0%}"


def rate(value: float | None) -> str:
    """bytes/s, in bits as radios are sold."""
    if value is None:
        return "-"
    bits = 8.0 * value
    for unit, factor in (("Gbit/s", 1e9), ("Mbit/s", 1e6), ("kbit/s", 1e3)):
        if bits >= factor:
            return f"{bits / factor:.3g} {unit}"
    return f"{bits:.0f} bit/s"


def duration(seconds: float | None) -> str:
    return "-" if seconds is None else f"{seconds:.1f} s" if seconds < 100.0 else f"{seconds:.0f} s"
