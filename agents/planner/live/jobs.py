"""What the agent's process and the solver's tell each other: jobs, answers, and how they travel through a pipe.

Frames of eight bytes of length and a pickle: only ever between a process and the child that it started itself.
"""

from __future__ import annotations

import pickle
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, BinaryIO, Generic, TypeVar

from agents.planner.goals.steps import FleetView, Step
from agents.planner.model.ground import Floor
from agents.planner.model.problem import Motion, MovingObstacle
from agents.planner.model.scene import Scene
from agents.planner.model.verify import Report
from zmav.wire import swarm

HEAD = struct.Struct("<Q")


T = TypeVar("T")
JudgedPlan = tuple[dict[str, Motion], Report]


class Job(Generic[T]):
    """Answered by a ``T``, or a typed error."""


@dataclass(frozen=True)
class Solve(Job[JudgedPlan]):
    """Plan a scene; answered by motions and what the verifier says of them."""

    scene: Scene
    movers: tuple[MovingObstacle, ...] = ()
    seconds: float = 10.0
    """of the processor; by the clock it may take :data:`agents.planner.model.deadline.WALL` times as long"""


@dataclass(frozen=True)
class Resolve(Job[list[Step]]):
    """What a goal comes down to; answered by a list of steps, or the error of a goal that cannot be."""

    goal: swarm.Goal
    view: FleetView
    scene: Scene
    """without vehicles: obstacles, bounds, fence"""
    floor: Floor | None


@dataclass(frozen=True)
class Judge(Job[Report]):
    """Verify motions; answered by the verifier's report."""

    scene: Scene
    motions: Mapping[str, Motion]
    movers: tuple[MovingObstacle, ...] = ()


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
    result: Any
    """what its job is answered by"""


def write(pipe: BinaryIO, message: object) -> None:
    send(pipe, frame(message))


def send(pipe: BinaryIO, data: bytes) -> None:
    pipe.write(data)
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
