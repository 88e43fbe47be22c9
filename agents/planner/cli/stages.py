"""How ``zmav plan`` shows what it is at: a bar on a terminal, a line a stage elsewhere, and the time each took."""

from __future__ import annotations

import sys
import time
from types import TracebackType

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

PREPARING = ("read", "validate", "load", "warm up")
"""stages that are no part of the planning"""


class Stages:
    """Give it to the solver as its ``progress``, between :meth:`begin` and :meth:`end`, while the ``with`` lasts."""

    def __init__(self, quiet: bool = False) -> None:
        terminal = sys.stderr.isatty()
        self._bar, self._plain = terminal and not quiet, not terminal and not quiet
        self._progress: Progress | None = None
        self._task = TaskID(0)
        self._scene = ""
        self._stage = ""
        self._since = 0.0
        self.ready: set[bool] = set()
        """the planner is warm: False without planes, True with them"""
        self.seconds: dict[str, float] = {}
        """s spent in each stage, in the order in which they were first entered"""

    def __enter__(self) -> Stages:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.end()

    def begin(self, scene: str) -> None:
        """A new scene: the times start again."""
        self._scene, self.seconds = scene, {}
        self._stage, self._since = "", time.perf_counter()
        if self._bar:
            columns = (
                TextColumn("{task.fields[scene]}: {task.description:<10}"),
                BarColumn(),
                TextColumn("{task.percentage:3.0f} %"),
                TimeElapsedColumn(),
            )
            self._progress = Progress(*columns, console=Console(stderr=True), transient=True)
            self._task = self._progress.add_task("", total=1.0, scene=scene)
            self._progress.start()

    def say(self, text: str) -> None:
        """A line that stays."""
        if self._progress is not None:
            self._progress.console.print(text, highlight=False)
        elif self._plain:
            click.echo(text, err=True)

    def __call__(self, stage: str, share: float) -> None:
        """The solver is in ``stage``, of which ``share`` (0 to 1) is done."""
        if stage != self._stage:
            self._close()
            self._stage = stage
            if self._plain and stage not in self.seconds and stage not in PREPARING:
                click.echo(f"{self._scene}: {stage}", err=True)
            self.seconds.setdefault(stage, 0.0)
        if self._progress is not None:
            self._progress.update(self._task, description=stage, completed=min(1.0, max(0.0, share)))

    def end(self) -> dict[str, float]:
        """The scene is through, and the bar gone: s by stage."""
        self._close()
        self._stage = ""
        if self._progress is not None:
            self._progress.stop()
            self._progress = None
        return self.seconds

    def _close(self) -> None:
        now = time.perf_counter()
        if self._stage:
            self.seconds[self._stage] += now - self._since
        self._since = now
