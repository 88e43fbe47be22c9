"""What the parts of a planner use of it, and of a goal under way: read here, whatever holds it together."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Any, Protocol

import zmav
from agents.planner.goals.steps import FleetView
from agents.planner.live.clocks import Clocks
from agents.planner.live.fleet import Fleet
from agents.planner.live.leadership.election import LeaderElection
from agents.planner.live.ledger import GoalBook
from agents.planner.live.reserved import ReservedAirspace
from agents.planner.live.settings import Settings
from agents.planner.live.solver import Solver
from agents.planner.live.world import World
from agents.planner.model.plans import Sample
from agents.planner.model.problem import MovingObstacle
from zmav import wire
from zmav.errors import ZmavError
from zmav.wire import Vector, swarm


class Publisher(Protocol):
    """Says what is flown."""

    def changed(self) -> None: ...

    def plan(self, goal: str, start: float, trajectories: dict[str, list[Sample]], clearance: float | None) -> None: ...

    def plan_over(self, goal: str) -> None: ...


class Context(Protocol):
    """The planner as its parts know it."""

    z: zmav.Client
    settings: Settings
    instance: str
    fleet: Fleet
    clocks: Clocks
    world: World
    charge: LeaderElection
    ledger: GoalBook
    airspace: ReservedAirspace
    solver: Solver
    events: deque[wire.Event]
    tasks: list[asyncio.Task[None]]

    @property
    def publisher(self) -> Publisher: ...

    @property
    def state(self) -> str: ...

    def book(self) -> swarm.Book: ...

    def say(self, kind: str, severity: wire.Severity, text: str, **detail: Any) -> None: ...

    def say_seldom(self, kind: str, severity: wire.Severity, text: str) -> None: ...

    def wake(self) -> None: ...

    def later(self, work: Any) -> None: ...

    def kin(self, goal: str) -> set[str]: ...

    def committed(self, goal: str) -> list[MovingObstacle]: ...

    def told(self, goal: str) -> None: ...


class Orderable(Context, Protocol):
    """The planner as who answers orders knows it."""

    def check_known(self, goal: swarm.Goal) -> FleetView: ...

    async def preview_solver(self) -> Solver: ...

    def pause(self, entry: swarm.GoalEntry, by: str = "") -> None: ...

    def resume(self, entry: swarm.GoalEntry) -> None: ...

    def take_obstacle(self, obstacle: swarm.Obstacle, by: str = "") -> str: ...

    def clear(self) -> int: ...

    def status(self) -> dict[str, Any]: ...


class Hearer(Context, Protocol):
    """The planner as who subscribes for it knows it."""

    def on_book(self, data: bytes) -> None: ...

    def on_charge(self, data: bytes) -> None: ...

    def on_map(self, data: bytes) -> None: ...

    def on_obstacle(self, data: bytes) -> None: ...


class GoalUnderWay(Protocol):
    """A goal that is being flown, as what flies it knows it."""

    entry: swarm.GoalEntry
    vehicles: tuple[str, ...]
    stopping: str
    failure: ZmavError | None

    @property
    def agent(self) -> Context: ...

    @property
    def goes(self) -> bool: ...

    def text(self, text: str) -> None: ...

    def say(self, kind: str, severity: wire.Severity, text: str, **detail: Any) -> None: ...

    def progress(self, share: float) -> None: ...

    def place(self, name: str) -> Vector: ...
