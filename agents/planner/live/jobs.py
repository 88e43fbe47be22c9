"""What the agent's process and the solver's tell each other: jobs, answers, and how they travel through a pipe.

Frames of eight bytes of length and a pickle: only ever between a process and the child that it started itself.
"""

from __future__ import annotations

import pickle
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, BinaryIO

from agents.planner.goals.steps import FleetView, Step
from agents.planner.model.ground import Floor
from agents.planner.model.problem import Motion, MovingObstacle
from agents.planner.model.scene import Scene
from agents.planner.model.verify import Report
from zmav.wire import swarm

HEAD = struct.Struct("<Q")


@dataclass(frozen=True)
class Solve:
    """Plan a scene; answered by motions and what the verifier says of them, or a typed error."""

    scene: Scene
    movers: tuple[MovingObstacle, ...] = ()
    seconds: float = 10.0
    """of the processor; by the clock it may take :data:`agents.planner.model.deadline.WALL` times as long"""


@dataclass(frozen=True)
class Resolve:
    """What a goal comes down to; answered by a list of steps, or the typed error of a goal that cannot be."""

    goal: swarm.Goal
    view: FleetView
    scene: Scene
    """without vehicles: obstacles, bounds, fence"""
    floor: Floor | None


@dataclass(frozen=True)
class Judge:
    """Verify motions; answered by the verifier's report."""

    scene: Scene
    motions: Mapping[str, Motion]
    movers: tuple[MovingObstacle, ...] = ()


Job = Solve | Resolve | Judge
JudgedPlan = tuple[dict[str, Motion], Report]


@dataclass(frozen=True)
class Compiling:
    """So many kernels are compiled for this machine, of so many."""

    done: int
    of: int


@dataclass(frozen=True)
class Ready:
    """The kernels are compiled and the stages loaded."""


@dataclass(frozen=True)
class Done:
    number: int
    result: JudgedPlan | list[Step] | Report


@dataclass(frozen=True)
class Failed:
    """A typed error, as it would cross the wire."""

    number: int
    code: str
    message: str
    detail: dict[str, Any] = field(default_factory=dict)


def write(pipe: BinaryIO, message: object) -> None:
    pipe.write(frame(message))
    pipe.flush()


def frame(message: object) -> bytes:
    data = pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
    return HEAD.pack(len(data)) + data


def read(pipe: BinaryIO) -> Any:
    """The next message; raises EOFError when the other side is gone."""
    head = pipe.read(HEAD.size)
    if len(head) < HEAD.size:
        raise EOFError
    (size,) = HEAD.unpack(head)
    data = pipe.read(size)
    if len(data) < size:
        raise EOFError
    return pickle.loads(data)
