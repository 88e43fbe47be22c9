"""How ``zmav mission`` shows plans, and how far the work with each vehicle is."""

from __future__ import annotations

import math
import sys
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn
from rich.table import Table

from zmav import wire


class Lines:
    """One line of progress a vehicle on stderr, while the ``with`` lasts; none where nobody watches."""

    def __init__(self, quiet: bool) -> None:
        columns = (
            TextColumn("{task.fields[vehicle]}: {task.description}"),
            BarColumn(),
            TextColumn("{task.fields[at]}"),
        )
        self._progress = Progress(
            *columns, console=Console(stderr=True), transient=True, disable=quiet or not sys.stderr.isatty()
        )
        self._tasks: dict[str, TaskID] = {}

    def __enter__(self) -> Lines:
        self._progress.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._progress.stop()

    def tell(self, vehicle: str, news: dict[str, Any]) -> None:
        """What an order's progress says."""
        if vehicle not in self._tasks:
            self._tasks[vehicle] = self._progress.add_task("", total=None, vehicle=vehicle, at="")
        done, of = news.get("done", news.get("current")), news.get("of", news.get("total"))
        words = " ".join(str(news[name]) for name in ("kind", "phase") if name in news) or "flying"
        if "waiting_for" in news and "phase" not in news:
            words = f"waiting: {news['waiting_for']}"
        at = f"{done}/{of}" if done is not None else ""
        self._progress.update(self._tasks[vehicle], description=words, completed=done or 0, total=of, at=at)


def headline(name: str, mission: wire.Mission) -> str:
    """Whose plan it is, of what kind, and how long."""
    state = f", {mission.state.lower().replace('_', ' ')}" if mission.state else ""
    return f"{name}: {mission.kind}, {len(mission.items)} items{state}"


def table(mission: wire.Mission) -> Table:
    """A plan for a person to read: ``>`` is the item being flown, ``*`` those reached."""
    shown = Table()
    for column in ("", "item", "command", "frame", "params", "x", "y", "z"):
        shown.add_column(column, justify="right" if column in ("item", "x", "y", "z") else "left")
    for i, item in enumerate(mission.items):
        mark = ">" if i == mission.current else "*" if mission.reached is not None and i <= mission.reached else ""
        params = " ".join("-" if value is None else f"{value:g}" for value in item.params)
        command, frame = item.command.removeprefix("MAV_CMD_"), item.frame.removeprefix("MAV_FRAME_")
        shown.add_row(mark, str(i), command, frame, params, _place(item.x), _place(item.y), f"{item.z:g}")
    return shown


def kept(result: dict[str, Any]) -> str:
    """What an autopilot keeps otherwise than it was sent, in words."""
    notes = result.get("kept_otherwise", [])
    if not notes:
        return ""
    more = f" and {len(notes) - 3} more" if len(notes) > 3 else ""
    return f"; it keeps otherwise: {'; '.join(notes[:3])}{more}"


def _place(value: float) -> str:
    """Degrees to their seventh digit; whole numbers as they are."""
    return f"{value:g}" if value == math.floor(value) else f"{value:.7f}"
