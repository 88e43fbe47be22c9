"""Plans as files: sampled trajectories, or the typed error."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from agents.planner.model.errors import Code, PlanError
from agents.planner.model.problem import Motion
from agents.planner.model.scene import LARGEST, read_file
from zmav.errors import BadInput

Sample = tuple[float, float, float, float]
"""t (s from the start of the plan), x, y, z (ENU metres)"""

STAY = 0.1
"""s"""


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
    def of(cls, motions: Mapping[str, Motion], planning_time_s: float | None = None) -> Plan:
        """Of motions (T, 4) by vehicle's id, rounded to the file's six decimals.

        A vehicle that stays where it is gets a second sample, so that every trajectory has a piece to look at.
        """
        samples: dict[str, list[Sample]] = {}
        for name, motion in motions.items():
            rounded = np.round(motion, 6) + 0.0  # and no -0.0
            if len(rounded) == 1:
                rounded = rounded[[0, 0]] + [[0.0] * 4, [STAY, 0.0, 0.0, 0.0]]
            samples[name] = [(t, x, y, z) for t, x, y, z in rounded.tolist()]
        return cls(status="ok", planning_time_s=planning_time_s, trajectories=samples)

    @classmethod
    def failed(cls, error: PlanError, planning_time_s: float | None = None) -> Plan:
        body = ErrorBody(code=error.kind, ids=error.ids, message=error.message)
        return cls(status="error", planning_time_s=planning_time_s, error=body)

    @property
    def makespan(self) -> float:
        """s until the last vehicle is at its goal."""
        return max((samples[-1][0] for samples in self.trajectories.values()), default=0.0)

    def motions(self) -> dict[str, Motion]:
        """(T, 4) by vehicle's id; (0, 4) for one without samples."""
        return {name: np.array(s, dtype=np.float64).reshape(-1, 4) for name, s in self.trajectories.items()}


def write_plan(path: str | Path, plan: Plan) -> None:
    """Write a plan file, whole or not at all. Raises :class:`BadInput` where that cannot be."""
    target = Path(path)
    part = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        if target.exists() and not target.is_file():  # a pipe or a device: there is nothing to put in place
            target.write_bytes(encode(plan))
            return
        part.write_bytes(encode(plan))
        part.replace(target)
    except OSError as e:
        part.unlink(missing_ok=True)
        raise BadInput(f"cannot write {path}: {e.strerror}", field="output", value=str(path)) from e


def encode(plan: Plan) -> bytes:
    """As in a file; ``planning_time_s`` to the millisecond."""
    if plan.planning_time_s is not None:
        plan = msgspec.structs.replace(plan, planning_time_s=round(plan.planning_time_s, 3))
    return msgspec.json.encode(plan) + b"\n"


def read_plan(path: str | Path, largest: int = LARGEST) -> Plan:
    """A plan file of anyone's. Raises :class:`BadInput` that names the field and what is wrong."""
    try:
        data = read_file(path, largest)
    except OSError as e:
        raise BadInput(f"cannot read {path}: {e.strerror}", field="plan", value=str(path)) from e
    try:
        return msgspec.json.decode(data, type=Plan)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as e:
        raise BadInput(f"{path} is no plan: {e}", field="plan", value=str(path), expected="a plan file") from e
