"""Text as a terminal may show it: nothing that came over the network moves its cursor."""

from __future__ import annotations

import unicodedata

MOST = 400
"""characters of any text that are looked at"""


def clean(text: str) -> str:
    """``text`` on one line, without control, format and combining characters: no escape sequences, nothing unseen."""
    text = text[:MOST]
    if text.isascii() and text.isprintable():
        return text
    return "".join(c if c.isprintable() else " " if c in "\t\r\n" else "?" for c in text if not _combines(c))


def few(names: list[str], most: int = 6) -> str:
    """The first ones, and how many there are besides."""
    return clean(", ".join(names[:most])) + (f" and {len(names) - most} more" if len(names) > most else "")


def _combines(character: str) -> bool:
    return unicodedata.category(character) in ("Mn", "Me")


def duration(seconds: float | None) -> str:
    """At most five characters: ``0.4s``, ``12s``, ``3m05``, ``2h10``, ``4d``."""
    if seconds is None:
        return "-"
    seconds = max(seconds, 0.0)
    if seconds < 9.95:
        return f"{seconds:.1f}s"
    whole = round(seconds)
    if whole < 100:
        return f"{whole}s"
    if whole < 3600:
        return f"{whole // 60}m{whole % 60:02d}"
    if whole < 86400:
        return f"{whole // 3600}h{whole % 3600 // 60:02d}"
    return f"{min(whole // 86400, 9999)}d"
