"""Plans as files: sampled trajectories, or the typed error."""

from __future__ import annotations

from typing import Literal

import msgspec

from agents.planner.errors import Code, PlanError

Sample = tuple[float, float, float, float]
"""t (s from the start of the plan), x, y, z (ENU metres)"""


class ErrorBody(msgspec.Struct, kw_only=True):
    code: Code
    ids: list[str] = []
    message: str = ""


class Plan(msgspec.Struct, kw_only=True, omit_defaults=True):
    """Piecewise linear, at least five samples a second while moving, from rest to rest (planes: flying)."""

    status: Literal["ok", "error"]
    planning_time_s: float | None = None
    trajectories: dict[str, list[Sample]] = {}
    error: ErrorBody | None = None

    @classmethod
    def failed(cls, error: PlanError, planning_time_s: float | None = None) -> Plan:
        body = ErrorBody(code=error.kind, ids=error.ids, message=error.message)
        return cls(status="error", planning_time_s=planning_time_s, error=body)

    @property
    def makespan(self) -> float:
        """s until the last vehicle is at its goal."""
        return max((samples[-1][0] for samples in self.trajectories.values()), default=0.0)
