"""A response as a picture, where matplotlib is installed."""

from __future__ import annotations

from pathlib import Path

from agents.controllers.response import Report
from zmav.errors import missing_extra


def picture(report: Report, path: Path) -> None:
    """Draw it (PNG, or what the file's name says). Raises :class:`~zmav.errors.BadConfig` where matplotlib is not
    installed, and :class:`~zmav.errors.BadInput` for a file that cannot be.
    """
    try:
        from agents.controllers.drawing import draw
    except ImportError as e:
        raise missing_extra("a picture", e.name, "planner") from e
    draw(report, path)
