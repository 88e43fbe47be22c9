"""What the parts of a planner share: made once by the agent, and never another."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Coroutine, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

import msgspec

import zmav
from agents.planner.live.clocks import Clocks
from agents.planner.live.fleet import Fleet
from agents.planner.live.homeward import Homeward
from agents.planner.live.leadership.election import LeaderElection
from agents.planner.live.ledger import GoalBook
from agents.planner.live.reserved import ReservedAirspace
from agents.planner.live.settings import FENCE, PlannerSettings
from agents.planner.live.solver import Solver
from agents.planner.live.world import World
from agents.planner.model.problem import MovingObstacle
from zmav import wire
from zmav.process import say as log
from zmav.ratelimit import RateLimit
from zmav.waiting import on_loop
from zmav.wire import swarm

EVENTS = 30
"""what happened last, and is told in the status"""
SELDOM, KINDS = 1.0, 64
"""s between two words on what comes by itself (obstacles, faults, refusals), however many there are, and kinds that are
told apart
"""


class UnderWay(Protocol):
    """A goal that is being flown, as other goals and those who order it know it."""

    vehicles: tuple[str, ...]
    leader: str | None
    tracks: bool

    def committed(self) -> list[MovingObstacle]: ...

    def refresh(self) -> None: ...

    def pause(self) -> None: ...

    def resume(self) -> None: ...


@dataclass(frozen=True)
class Context:
    """Lives on the event loop."""

    z: zmav.Client
    settings: PlannerSettings
    instance: str
    charge: LeaderElection
    fleet: Fleet
    clocks: Clocks
    solver: Solver
    runs: Mapping[str, UnderWay]
    """by the goal's id"""
    world: World = field(default_factory=World)
    ledger: GoalBook = field(default_factory=GoalBook)
    airspace: ReservedAirspace = field(default_factory=ReservedAirspace)
    events: deque[wire.Event] = field(default_factory=lambda: deque(maxlen=EVENTS))
    news: asyncio.Event = field(default_factory=asyncio.Event)
    """something is to be looked at now"""
    untold: asyncio.Event = field(default_factory=asyncio.Event)
    """something is to be published now"""
    asking: set[asyncio.Task[None]] = field(default_factory=set)
    loop: asyncio.AbstractEventLoop = field(default_factory=asyncio.get_running_loop)
    _told: RateLimit[str] = field(default_factory=lambda: RateLimit(SELDOM, KINDS))

    @cached_property
    def homes(self) -> Homeward:
        """The ways home of all that it flies."""
        return Homeward(self.fleet, self.settings, self.world, self.clocks, self._flying, self.say)

    def _flying(self) -> set[str]:
        """The vehicles of all goals that are being flown."""
        return {name for run in self.runs.values() for name in run.vehicles}

    def say(self, kind: str, severity: wire.Severity, text: str, **detail: Any) -> None:
        """Something happened: in the log, in the status, and so to everybody who looks."""
        self.events.append(wire.Event(t=time.time(), kind=kind, severity=severity, text=text, detail=detail))
        log(f"{severity}: {text}" if severity != "info" else text)
        self.untold.set()

    def say_seldom(self, kind: str, severity: wire.Severity, text: str) -> None:
        """From any thread: one a second of a kind, and the next says how many were left out."""
        if (left_out := self._told.take(kind)) is not None:
            more = f" (and {left_out} more before)" if left_out else ""
            on_loop(self.loop, self.say)(kind, severity, text + more)

    def wake(self) -> None:
        """Something is to be looked at now."""
        self.news.set()
        self.untold.set()

    def later(self, work: Coroutine[Any, Any, None]) -> None:
        """Beside everything else, until it is done or we are."""
        task = asyncio.create_task(work)
        self.asking.add(task)
        task.add_done_callback(self.asking.discard)

    @property
    def state(self) -> str:
        """In a word."""
        if not self.charge.in_charge:
            return "standby"
        if not self.solver.ready:
            return "loading"
        return "flying" if self.runs else "ready"

    def book(self) -> swarm.Book:
        """Ours, or the last one of the planner in charge."""
        if not self.charge.in_charge and self.charge.book is not None:
            return self.charge.book
        return swarm.Book(
            t=time.time(),
            planner=self.settings.name,
            instance=self.instance,
            term=self.charge.term,
            paused=any(entry.state == "paused" for entry in self.ledger.goals),
            obstacles=len(self.world.obstacles),
            goals=self.ledger.goals,
        )

    # The world.

    def fence(self) -> None:
        """The fleet file's geofence, where there is one."""
        if self.settings.geofence is not None:
            self.world.fence = swarm.Obstacle(name=FENCE, t=0.0, what=self.settings.geofence)
            self.world.give(self.world.fence, time.monotonic())

    def take_obstacle(self, obstacle: swarm.Obstacle, by: str = "") -> str:
        """Something is there, moved or gone: what became of it, in words; empty: no news. Raises :class:`BadInput`."""
        if obstacle.t > (now := time.time()):  # or nobody whose clock is right could ever change it
            obstacle = msgspec.structs.replace(obstacle, t=now)
        known = self.world.find(obstacle.name) is not None
        if not self.world.give(obstacle, time.monotonic()):
            return ""
        self.wake()
        word = "gone" if obstacle.what is None else ("changed" if known else "new")
        return f"obstacle {obstacle.name}: {word}{by}"

    # Goals that follow each other.

    def kin(self, goal: str) -> set[str]:
        """The goal itself, and those whose vehicles it follows or is followed by: they go the same way, and are kept
        apart by what each is committed to instead of by room that is spoken for.
        """
        return {goal, *(name for name, run in self.runs.items() if self._follows(goal, run))}

    def _follows(self, goal: str, other: UnderWay) -> bool:
        run = self.runs.get(goal)
        if run is None:
            return False
        return (run.tracks and run.leader in other.vehicles) or (other.tracks and other.leader in run.vehicles)

    def committed(self, goal: str) -> list[MovingObstacle]:
        """What the vehicles of its kin are committed to, on our UTC."""
        return [mover for name in self.kin(goal) - {goal} for mover in self.runs[name].committed()]

    def told(self, goal: str) -> None:
        """A vehicle of this goal was committed to something: its kin keep clear of that from now on."""
        for name in self.kin(goal) - {goal}:
            self.runs[name].refresh()
