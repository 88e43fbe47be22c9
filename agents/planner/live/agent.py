"""The planning agent: it hears the fleet, keeps the book, and has each goal flown when its turn comes.

Everything here only passes messages: plans are made in the solver's process, flown by the executor. ``zmav swarm
planner`` runs it; so may a script, in an event loop of its own.
"""

from __future__ import annotations

import asyncio
import collections
import contextlib
import math
import time
import uuid
from collections.abc import Coroutine
from types import TracebackType
from typing import Any

import msgspec

import zmav
from agents.planner.goals.steps import FleetView
from agents.planner.live.checks import FARTHEST, read_obstacle
from agents.planner.live.clocks import Clocks
from agents.planner.live.field import check_field
from agents.planner.live.fleet import Fleet
from agents.planner.live.leadership.election import LeaderElection
from agents.planner.live.leadership.tokens import Tokens, plans
from agents.planner.live.ledger import ENDED, GoalBook
from agents.planner.live.order_handlers import OrderHandlers
from agents.planner.live.publisher import StatusPublisher
from agents.planner.live.reserved import ReservedAirspace
from agents.planner.live.run import Run
from agents.planner.live.settings import FENCE, Settings, check
from agents.planner.live.solver import Solver
from agents.planner.live.world import World
from agents.planner.model.problem import MovingObstacle
from zmav import wire
from zmav.errors import BadInput, ZmavError
from zmav.process import say as log
from zmav.seldom import Seldom
from zmav.services.link.port import on_loop
from zmav.waiting import within
from zmav.wire import swarm

TICK = 0.2
HOMES_EVERY = 0.5
"""s between two questions for homes"""
MAPS = 8
"""maps of planners that are kept: one that dies may come again before its standby takes over"""
EVENTS = 30
"""what happened last, and is told in the status"""
SELDOM, KINDS = 1.0, 64
"""s between two words on what comes by itself (obstacles, faults, refusals), however many there are, and kinds that are
told apart
"""
LEAST = 0.1
"""s between two looks at what is flown in a world that has changed"""


class Agent:
    """``async with Agent(z, settings) as agent: ...``: a planner among others. Lives on the event loop.

    Raises :class:`~zmav.errors.BadConfig` for settings that make no sense.
    """

    def __init__(self, z: zmav.Client, settings: Settings) -> None:
        check(settings)
        self.z, self.settings = z, settings
        self.instance = uuid.uuid4().hex
        patience = settings.patience * (2.0 if settings.standby else 1.0)
        self.charge = LeaderElection(settings.name, self.instance, lambda name: plans(z.member, name), patience)
        self.fleet = Fleet(z, settings.downwash)
        self.clocks = Clocks(z, settings.clock_error)
        self.world = World()
        self.ledger = GoalBook()
        self.airspace = ReservedAirspace()
        self.runs: dict[str, Run] = {}
        self.solver = Solver(lambda text: self.say("solver", "info", text))
        self.previewer: Solver | None = None
        """a second process: a preview must not keep a vehicle in flight waiting for its plan"""
        self.events: collections.deque[wire.Event] = collections.deque(maxlen=EVENTS)
        self.publisher = StatusPublisher(self)
        self._handlers = OrderHandlers(self, z.member.credentials if z.member else None)
        self._tokens = Tokens(self)
        self._news = asyncio.Event()
        self.tasks: list[asyncio.Task[None]] = []
        self._asking: set[asyncio.Task[None]] = set()
        self._held = ""
        """why nothing is begun, so that it is said once"""
        self._maps: dict[str, swarm.ObstacleMap] = {}
        """what planners said last that they keep clear of, by instance"""
        self._changed = False
        """the world is another one, and what is flown was not looked at since"""
        self._namesake = ""
        """the instance of another planner of our name"""
        self._looked = self._asked = 0.0
        self._homes = 0
        """how often somebody was asked for its home"""
        self._told: Seldom[str] = Seldom(SELDOM, KINDS)
        self.fence()

    async def __aenter__(self) -> Agent:
        self._say_soon = on_loop(asyncio.get_running_loop(), self.say)
        await self.solver.__aenter__()
        self._tokens.start()
        self._handlers.orders.start()
        self.publisher.start()
        self.tasks.append(asyncio.create_task(self._live()))
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None
    ) -> None:
        """Everybody comes to rest, and the goals stay in the book for anyone who stands by."""
        for task in (*self.tasks, *self._asking):
            task.cancel()
        await asyncio.gather(*self.tasks, *self._asking, return_exceptions=True)
        await asyncio.gather(*(run.close() for run in self.runs.values()), return_exceptions=True)
        await self._handlers.orders.close()
        if self.charge.in_charge:
            self.publisher.last_book()
        self._tokens.close()
        await self.solver.__aexit__(None, None, None)
        if self.previewer is not None:
            await self.previewer.__aexit__(None, None, None)

    # What is going on.

    def say(self, kind: str, severity: wire.Severity, text: str, **detail: Any) -> None:
        """Something happened: in the log, in the status, and so to everybody who looks."""
        self.events.append(wire.Event(t=time.time(), kind=kind, severity=severity, text=text, detail=detail))
        log(f"{severity}: {text}" if severity != "info" else text)
        self.publisher.changed()

    def wake(self) -> None:
        """Something is to be looked at now."""
        self._news.set()
        self.publisher.changed()

    def status(self) -> dict[str, Any]:
        hearing = self.fleet.hearing()
        return {
            "planner": self.settings.name,
            "instance": self.instance,
            "state": self.state,
            "in_charge": self.charge.in_charge,
            "of": self.charge.of,
            "term": self.charge.term or self.charge.highest,
            "ready": self.solver.ready,
            "book": msgspec.to_builtins(self.book()),
            "vehicles": sorted(self.fleet.view().vehicles),
            "unheard": sorted(hearing.unheard),
            "silent": self.fleet.silent(),
            "obstacles": len(self.world.obstacles),
            "events": [msgspec.to_builtins(event, enc_hook=str) for event in self.events],
        }

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
        paused = any(entry.state == "paused" for entry in self.ledger.goals)
        return swarm.Book(
            t=time.time(),
            planner=self.settings.name,
            instance=self.instance,
            term=self.charge.term,
            paused=paused,
            obstacles=len(self.world.obstacles),
            goals=self.ledger.goals,
        )

    def check_known(self, goal: swarm.Goal) -> FleetView:
        """Raises :class:`BadInput` for vehicles that are not heard, and for places that are not in the field."""
        self.fleet.watch()
        view = self.fleet.view(self.settings.margin)
        silent = [name for name in goal.vehicles if name not in view.vehicles and name in self.fleet.silent()]
        if silent:
            text = f"{', '.join(silent)}: heard, but with no place in the fleet's frame: start 'zmav up' with --origin"
            raise BadInput(text, field="vehicles", value=silent, expected="vehicles with a local position")
        for seen in view.pick(goal.vehicles):
            if not max(map(abs, seen.pos_ned)) <= FARTHEST:
                away = math.hypot(*seen.pos_ned) / 1e3
                text = f"{seen.name} is {away:.0f} km from the fleet's origin: is the --origin of its 'zmav up' right?"
                raise BadInput(text, field="vehicles", value=seen.name, expected=f"within {FARTHEST / 1e3:.0f} km")
        check_field(goal, view, self.settings.field, self.settings.downwash, self._ball)
        return view

    def _ball(self, name: str) -> wire.Vector | None:
        found = self.world.ball(name, time.time())
        return found[0] if found else None

    async def preview_solver(self) -> Solver:
        """The solver itself while nobody flies, else one beside it."""
        if not self.runs:
            return self.solver
        if self.previewer is None:
            self.previewer = Solver(lambda text: self.say("solver", "info", text), "solver for previews")
            await self.previewer.__aenter__()
        return self.previewer

    # What is told.

    def fence(self) -> None:
        """The fleet file's geofence, where there is one."""
        if self.settings.geofence is not None:
            self.world.give(swarm.Obstacle(name=FENCE, t=0.0, what=self.settings.geofence), time.monotonic())

    def take_obstacle(self, obstacle: swarm.Obstacle, by: str = "") -> str:
        """Something is there, moved or gone: what became of it, in words; empty: no news. Raises :class:`BadInput`."""
        if obstacle.t > (now := time.time()):  # or nobody whose clock is right could ever change it
            obstacle = msgspec.structs.replace(obstacle, t=now)
        known = self.world.find(obstacle.name) is not None
        if not self.world.give(obstacle, time.monotonic()):
            return ""
        self._changed = True
        self.wake()
        word = "gone" if obstacle.what is None else ("changed" if known else "new")
        return f"obstacle {obstacle.name}: {word}{by}"

    def clear(self) -> int:
        """Forget all obstacles but the fleet file's fence; how many."""
        count = self.world.clear()
        self.fence()
        self._changed = True
        self.wake()
        return count

    def on_obstacle(self, data: bytes) -> None:
        """From the network; what is none is left alone, and said. However many come, the log stays short."""
        try:
            obstacle = read_obstacle(data)
            moved = isinstance(obstacle.what, swarm.Ball) and self.world.find(obstacle.name) is not None
            text = self.take_obstacle(obstacle)
        except BadInput as e:
            self.say_seldom("refused", "warning", f"refused: {e}")
        else:
            if text and not moved:
                self.say_seldom("world", "info", text)

    def say_seldom(self, kind: str, severity: wire.Severity, text: str) -> None:
        """From any thread: one a second of a kind, and the next says how many were left out."""
        if (left_out := self._told.take(kind)) is not None:
            self._say_soon(kind, severity, text + (f" (and {left_out} more before)" if left_out else ""))

    def on_map(self, data: bytes) -> None:
        """What the planner in charge keeps clear of: anyone who stands by keeps it, too."""
        if self.charge.in_charge:
            return
        with contextlib.suppress(BadInput):
            told = wire.decode(data, swarm.ObstacleMap, "map of obstacles")
            self._maps.pop(told.instance, None)
            self._maps[told.instance] = told
            if len(self._maps) > MAPS:
                del self._maps[next(iter(self._maps))]
            if self.charge.book is not None and told.instance == self.charge.book.instance:
                self.world.follow(told.obstacles, time.monotonic(), time.time())

    def on_book(self, data: bytes) -> None:
        try:
            book = wire.decode(data, swarm.Book, "book")
        except BadInput:
            return  # a newer or a broken planner: its token is what we go by
        if book.planner == self.settings.name and book.instance not in {self.instance, self._namesake}:
            self._namesake = book.instance
            text = f"another planner is called {book.planner}, too, and either answers orders: give each its --name"
            self.say("name", "error", text)
        if self.charge.hear(book, time.monotonic()):
            who = f"{book.planner} is in charge (term {book.term})"
            self.say("charge", "warning", f"{who}: {self.settings.name} stands by, and commands nobody")
            self._step_down(book)
        elif self.charge.in_charge and book.instance != self.instance:
            self.publisher.book()  # it hears that it is not

    def on_charge(self, data: bytes) -> None:
        """Somebody is in charge."""
        with contextlib.suppress(BadInput):
            self.charge.beat(wire.decode(data, swarm.Charge, "who is in charge"), time.monotonic())

    # Life.

    async def _live(self) -> None:
        """Tick until cancelled; what goes wrong in one round is said, and the next one comes."""
        while True:
            try:
                self._round()
            except ZmavError as e:
                self.say_seldom("fault", "error", str(e))
            except Exception as e:  # or it would hold its token for ever, and do nothing
                self.say_seldom("fault", "error", f"the planner's own fault: {e!r}")
            with contextlib.suppress(asyncio.TimeoutError):
                await within(TICK, self._news.wait())
            self._news.clear()

    def _round(self) -> None:
        now = time.monotonic()
        self.charge.goals = bool(self.ledger.goals)
        self.fleet.watch()
        for name in self.fleet.bodies.due(self.fleet.names)[:10]:
            self.later(self.fleet.bodies.ask(name))
        self._ask_homes(now)
        self.clocks.hear()
        if name := self.clocks.due(now):
            self.later(self.clocks.ask(name))
        self._changed |= bool(self.world.expire(now))
        if self._changed and now - self._looked > LEAST:
            self._changed, self._looked = False, now
            for run in self.runs.values():
                run.world_changed()
            self.publisher.changed()
        if not self.charge.in_charge:
            if self.charge.lost(now):
                self._take_charge()
            return
        self._end_runs()
        if self.solver.ready:
            self._begin_runs()
        else:
            for entry in self.ledger.ready():
                entry.text = "waits for the solver, which compiles for a minute or two once on a machine"

    def _ask_homes(self, now: float) -> None:
        """One after the other and again, where we did not see them take off."""
        homeless = self.fleet.homeless
        if homeless and now - self._asked > HOMES_EVERY:
            self._asked = now
            self._homes += 1
            self.later(self.fleet.ask_home(homeless[self._homes % len(homeless)]))

    def later(self, work: Coroutine[Any, Any, None]) -> None:
        """Beside everything else, until it is done or we are."""
        task = asyncio.create_task(work)
        self._asking.add(task)
        task.add_done_callback(self._asking.discard)

    def _take_charge(self) -> None:
        book = self.charge.take()
        again = self.ledger.take_over(book) if book else []
        self._tokens.in_charge(True)
        text = f"{self.settings.name} is in charge (term {self.charge.term})"
        if book:
            text += f": {book.planner} was not heard for {self.charge.patience:.0f} s; {len(again)} goals go on"
        self.say("charge", "notice" if book else "info", text)
        if book:
            self._check_map(book, again)
        self._maps.clear()
        self.publisher.book()

    def _check_map(self, book: swarm.Book, again: list[swarm.GoalEntry]) -> None:
        """Nothing is flown among obstacles that the one before us knew of and we do not."""
        if told := self._maps.get(book.instance):
            self.world.follow(told.obstacles, time.monotonic(), time.time())
        known = len(self.world.obstacles)
        if known >= book.obstacles or not again:
            return
        for entry in again:
            entry.state, entry.text = "paused", "paused: not all obstacles are known"
        text = f"of the {book.obstacles} obstacles that {book.planner} knew, {known} are known here"
        self.say("charge", "error", f"{text}: its goals are paused; tell them again, and resume")

    def _step_down(self, book: swarm.Book) -> None:
        """Command nobody from now on: segments end by themselves, the leases are given back."""
        self._tokens.in_charge(False)
        for run in list(self.runs.values()):
            task = asyncio.create_task(run.close())
            self._asking.add(task)
            task.add_done_callback(self._asking.discard)
        self.runs.clear()
        self.ledger = GoalBook()

    def _end_runs(self) -> None:
        """Stop what was cancelled, replaced or paused; forget what has ended."""
        for name, run in list(self.runs.items()):
            if run.done:
                del self.runs[name]
            elif run.entry.state in ENDED:
                run.stop(run.entry.text)

    def _begin_runs(self) -> None:
        busy = {vehicle for run in self.runs.values() for vehicle in run.vehicles}
        hearing, held = self.fleet.hearing(), ""
        for entry in self.ledger.ready():
            if entry.id in self.runs or busy & set(entry.goal.vehicles):
                continue
            if not hearing.may_move(entry.goal.vehicles):
                held = entry.text = hearing.words()
                continue
            busy |= set(entry.goal.vehicles)
            self.runs[entry.id] = Run(self, entry)
            self.publisher.changed()
        if held != self._held:
            self._held = held
            if held:
                self.say("partition", "warning", held)

    def kin(self, goal: str) -> set[str]:
        """The goal itself, and those whose vehicles it follows or is followed by: they go the same way, and are kept
        apart by what each is committed to instead of by room that is spoken for.
        """
        return {goal, *(name for name, run in self.runs.items() if self._follows(goal, run))}

    def _follows(self, goal: str, other: Run) -> bool:
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

    # Pause and resume.

    def pause(self, entry: swarm.GoalEntry, by: str = "") -> None:
        """It comes to rest along what it flies, and waits."""
        if entry.state in ENDED or entry.state == "paused":
            return
        entry.state, entry.text = "paused", f"paused{by}"
        if run := self.runs.get(entry.id):
            run.pause()
        self.say("goal", "notice", f"{entry.id}: paused{by}", goal=entry.id)

    def resume(self, entry: swarm.GoalEntry) -> None:
        run = self.runs.get(entry.id)
        entry.state, entry.text = ("flying" if run else "queued"), "goes on"
        if run:
            run.resume()
        self.say("goal", "notice", f"{entry.id}: goes on", goal=entry.id)
        self.wake()
