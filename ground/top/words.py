"""Text and figures as a terminal may show them: nothing that came over the network moves its cursor."""

from __future__ import annotations

from rich.cells import cell_len, set_cell_size

from zmav.doctor.words import clean

ELLIPSIS = "~"
"""stands where a text was cut: every terminal has it"""


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


def percent(share: float | None) -> str:
    """Whole percents; what is lost at all is not shown as zero."""
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
