"""Text and figures as a terminal may show them: nothing that came over the network moves its cursor."""

from __future__ import annotations

import unicodedata

from rich.cells import cell_len, set_cell_size

MOST = 400
"""characters of any text that are looked at"""
ELLIPSIS = "~"
"""stands where a text was cut: every terminal has it"""


def clean(text: str) -> str:
    """``text`` on one line, without control, format and combining characters: no escape sequences, nothing unseen."""
    text = text[:MOST]
    if text.isascii() and text.isprintable():
        return text
    return "".join(c if c.isprintable() else " " if c in "\t\r\n" else "?" for c in text if not _combines(c))


def _combines(character: str) -> bool:
    return unicodedata.category(character) in ("Mn", "Me")


def cells(text: str) -> int:
    """Columns of a terminal that a clean text takes."""
    return len(text) if text.isascii() else cell_len(text)


def fit(text: str, width: int, *, right: bool = False) -> str:
    """Exactly ``width`` cells of a terminal: cleaned, cut with a mark, or filled with spaces."""
    text = clean(text)
    length = cells(text)
    if length > width:
        return set_cell_size(text, width - 1) + ELLIPSIS if width > 1 else ELLIPSIS[:width]
    space = " " * (width - length)
    return space + text if right else text + space


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


def percent(share: float | None) -> str:
    """Whole percents; what is lost at all is not shown as nought."""
    if share is None:
        return "-"
    return "<1%" if 0.0 < share < 0.005 else f"{share:.0%}"


def number(value: float | None, digits: int = 1, sign: str = "") -> str:
    if value is None:
        return "-"
    return f"{round(value, digits) + 0.0:{sign}.{digits}f}"  # no "-0.0"


def milliseconds(seconds: float | None) -> str:
    if seconds is None:
        return "-"
    value = 1e3 * seconds
    return f"{value:.1f}" if value < 9.95 else f"{value:.0f}"
