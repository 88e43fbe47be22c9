"""Why there is no plan: the typed errors of the plan format."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

from zmav.errors import ZmavError

Code = Literal[
    "invalid_scene",
    "start_in_obstacle",
    "goal_in_obstacle",
    "starts_overlap",
    "goals_overlap",
    "start_out_of_bounds",
    "goal_out_of_bounds",
    "unreachable",
    "timeout",
]


class PlanError(ZmavError):
    """No plan: ``kind`` is the format's code, ``ids`` are the vehicles it is about, in the scene's order."""

    code = "plan"

    def __init__(self, kind: Code, ids: Iterable[str], message: str) -> None:
        self.kind: Code = kind
        self.ids = list(ids)
        super().__init__(message, kind=kind, ids=self.ids)

    def __reduce__(self) -> tuple[type[PlanError], tuple[Code, list[str], str]]:
        """For a pipe between processes."""
        return PlanError, (self.kind, self.ids, self.message)
