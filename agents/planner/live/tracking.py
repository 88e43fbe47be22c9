"""Staying beside something that moves: short segments again and again, each clear of everything and ending at rest."""

from __future__ import annotations

from typing import TYPE_CHECKING

from agents.planner.goals.steps import Track
from zmav.errors import Unsupported

if TYPE_CHECKING:
    from agents.planner.live.crew import Crew
    from agents.planner.live.run import Run


class Tracking:
    def __init__(self, run: Run, crew: Crew, step: Track) -> None:
        self._run, self._crew, self._step = run, crew, step

    async def go_on(self) -> None:
        raise Unsupported("following is not there yet")
