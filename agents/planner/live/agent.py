"""The planning agent: it hears the fleet, keeps the book, and has each goal flown when its turn comes.

Everything here only passes messages: plans are made in the solver's process, flown by the executor. ``zmav swarm
planner`` runs it; so may a script, in an event loop of its own.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
import uuid
from typing import NamedTuple

import zmav
from agents.planner.live.checks import check_goal, check_obstacle, read_obstacle
from agents.planner.live.clocks import Clocks
from agents.planner.live.context import Context
from agents.planner.live.fleet import Fleet
from agents.planner.live.leadership.election import LeaderElection
from agents.planner.live.leadership.tokens import Tokens, plans
from agents.planner.live.ledger import ENDED
from agents.planner.live.order_handlers import OrderHandlers
from agents.planner.live.publisher import StatusPublisher
from agents.planner.live.run import Run
from agents.planner.live.settings import PlannerSettings
from agents.planner.live.solver import Solver
from agents.planner.live.traffic import TrafficWatch
from agents.planner.live.world import LATE
from zmav import wire
from zmav.errors import BadInput, ZmavError
from zmav.waiting import cancelled, within
from zmav.wire import swarm

TICK = 0.2
HOMES_EVERY, BATTERIES_EVERY = 0.5, 1.0
"""s between two questions for homes"""
MAPS = 8
"""maps of planners that are kept: one that dies may come again before its standby takes over"""
LEAST = 0.1
"""s between two looks at what is flown in a world that has changed"""


class ReadMap(NamedTuple):
    """What another planner keeps clear of, as far as it makes sense."""

    t: float
    obstacles: list[swarm.Obstacle]
    odd: dict[str, str]
    """by its name, why one is not kept"""

    @property
    def words(self) -> str:
        """One of those that are not kept, and how many more there are."""
        name, why = next(iter(self.odd.items()))
        more = f" (and {len(self.odd) - 1} more)" if len(self.odd) > 1 else ""
        return f"{name}: {why}{more}"


class Agent:
    """``async with Agent(z, settings) as agent: ...``: a planner among others. Lives on the event loop."""

    def __init__(self, z: zmav.Client, settings: PlannerSettings) -> None:
        self.z = z
        instance = uuid.uuid4().hex
        patience = settings.patience * (2.0 if settings.standby else 1.0)
        self.runs: dict[str, Run] = {}
        context = self.context = Context(
            z=z,
            settings=settings,
            instance=instance,
            charge=LeaderElection(settings.name, instance, lambda name: plans(z.member, name), patience),
            fleet=Fleet(z, settings.downwash),
            clocks=Clocks(z),
            solver=Solver(lambda text: context.say("solver", "info", text)),
            runs=self.runs,
        )
        self.publisher = StatusPublisher(context)
        self.handlers = OrderHandlers(context, z.member.credentials if z.member else None)
        hears = {"goal": self.on_book, "charge": self.on_charge, "obstacle": self.on_map, "traffic": self.on_traffic}
        self._traffic = TrafficWatch(settings.traffic)
        self._tokens = Tokens(context, hears, self.on_obstacle)
        self._task: asyncio.Task[None] | None = None
        self._held = ""
        """why nothing is begun, so that it is said once"""
        self._maps: dict[str, ReadMap] = {}
        """what planners said last that they keep clear of, by instance"""
        self._revision = 0
        """of the world, when what is flown was last looked at"""
        self._namesake = ""
        """the instance of another planner of our name"""
        self._looked = self._asked = self._batteries = 0.0
        self._homes = 0
        """how often somebody was asked for its home"""
        context.fence()

    async def __aenter__(self) -> Agent:
        await self.context.solver.__aenter__()
        self._tokens.start()
        self.handlers.orders.start()
        self.publisher.start()
        self._task = asyncio.create_task(self._live())
        self._say_ground()
        return self

    async def __aexit__(self, *exc: object) -> None:
        """Everybody comes to rest, and the goals stay in the book for anyone who stands by."""
        await cancelled(self._task, *self.publisher.tasks, *self.context.asking)
        await asyncio.gather(*(run.close() for run in self.runs.values()), return_exceptions=True)
        await self.handlers.close()
        if self.context.charge.in_charge:
            self.publisher.last_book()
        self._tokens.close()
        await self.context.solver.__aexit__(None, None, None)

    def _say_ground(self) -> None:
        settings = self.context.settings
        if settings.ground is not None and not settings.ground.empty:
            self.context.say("terrain", "info", f"{len(settings.ground.pieces)} pieces of ground are known")
        elif settings.field.asks_for_height:
            text = "no ground is known, and the fleet file asks for a height above it: goals are refused"
            self.context.say("terrain", "warning", f"{text}; start the planner with --terrain")

    # What is told.

    def on_obstacle(self, data: bytes) -> None:
        """From the network; what is none is left alone, and said. However many come, the log stays short."""
        try:
            obstacle = read_obstacle(data)
            moved = isinstance(obstacle.what, swarm.Ball) and self.context.world.find(obstacle.name) is not None
            text = self.context.take_obstacle(obstacle)
        except BadInput as e:
            self.context.say_seldom("refused", "warning", f"refused: {e}")
        else:
            if text and not moved:
                self.context.say_seldom("world", "info", text)

    def on_map(self, data: bytes) -> None:
        """What the planner in charge keeps clear of: anyone who stands by keeps it, too."""
        if self.context.charge.in_charge:
            return
        try:
            told = wire.decode(data, swarm.ObstacleMap, "map of obstacles")
        except BadInput as e:
            self.context.say_seldom("refused", "warning", f"refused: {e}")
            return
        before = self._maps.pop(told.instance, None)
        if before is not None and 0.0 < before.t - told.t < LATE:  # overtaken; else its clock was set back
            self._maps[told.instance] = before
            return
        self._maps[told.instance] = read = self._read(told)
        if len(self._maps) > MAPS:
            del self._maps[next(iter(self._maps))]
        if read.odd and (before is None or before.odd != read.odd):
            text = f"not kept of the obstacles that {told.planner} knows: {read.words}"
            self.context.say_seldom("refused", "warning", text)
        if self.context.charge.book is not None and told.instance == self.context.charge.book.instance:
            self.context.world.follow(read.obstacles, time.monotonic(), time.time())

    def _read(self, told: swarm.ObstacleMap) -> ReadMap:
        read = ReadMap(told.t, [], {})
        for each in told.obstacles:
            known = self.context.world.find(each.name)
            try:
                if known != each:  # what is kept was looked at
                    check_obstacle(each)
                read.obstacles.append(each)
            except BadInput as e:
                read.odd[each.name] = e.message
                read.obstacles.extend([known] if known else [])  # our own file's fence, perhaps: better than none
        return read

    def on_traffic(self, data: bytes) -> None:
        try:
            self._traffic.hear(data)
        except BadInput as e:
            self.context.say_seldom("refused", "warning", f"refused: {e}")

    def on_book(self, data: bytes) -> None:
        try:
            book = wire.decode(data, swarm.Book, "book")
        except BadInput:
            return  # a newer or a broken planner: its token is what we go by
        if book.planner == self.context.settings.name and book.instance not in {self.context.instance, self._namesake}:
            self._namesake = book.instance
            text = f"another planner is called {book.planner}, too, and either answers orders: give each its --name"
            self.context.say("name", "error", text)
        if self.context.charge.hear(book, time.monotonic()):
            who = f"{book.planner} is in charge (term {book.term})"
            self.context.say("charge", "warning", f"{who}: {self.context.settings.name} stands by, and commands nobody")
            self._step_down(book)
        elif self.context.charge.in_charge and book.instance != self.context.instance:
            self.publisher.book()  # it hears that it is not

    def on_charge(self, data: bytes) -> None:
        """Somebody is in charge."""
        with contextlib.suppress(BadInput):
            self.context.charge.beat(wire.decode(data, swarm.Charge, "who is in charge"), time.monotonic())

    # Life.

    async def _live(self) -> None:
        """Tick until cancelled; what goes wrong in one round is said, and the next one comes."""
        while True:
            try:
                self._round()
            except ZmavError as e:
                self.context.say_seldom("fault", "error", str(e))
            except Exception as e:  # or it would hold its token for ever, and do nothing
                self.context.say_seldom("fault", "error", f"the planner's own fault: {e!r}")
            with contextlib.suppress(asyncio.TimeoutError):
                await within(TICK, self.context.news.wait())
            self.context.news.clear()

    def _round(self) -> None:
        now = time.monotonic()
        self.context.charge.goals = bool(self.context.ledger.goals)
        self.context.fleet.watch()
        for name in self.context.fleet.bodies.due(self.context.fleet.names)[:10]:
            self.context.later(self.context.fleet.bodies.ask(name))
        self._ask_homes(now)
        self.context.clocks.hear()
        if name := self.context.clocks.due(now):
            self.context.later(self.context.clocks.ask(name))
        self.context.homes.tick()
        self.context.world.expire(now)
        states = (state for state, _ in self.context.fleet.last.values())
        self.context.world.traffic = self._traffic.obstacles(states, now, time.time())
        if self.context.world.revision != self._revision and now - self._looked > LEAST:
            self._revision, self._looked = self.context.world.revision, now
            for run in self.runs.values():
                run.world_changed()
            self.context.untold.set()
        if not self.context.charge.in_charge:
            if self.context.charge.lost(now):
                self.take_charge()
            return
        self._end_runs()
        if now - self._batteries > BATTERIES_EVERY:
            self._batteries = now
            for run in self.runs.values():
                run.look_at_batteries()
        if self.context.solver.ready:
            self._begin_runs()
        else:
            for entry in self.context.ledger.ready():
                entry.text = f"waits for the solver, which {self.context.solver.doing}"

    def _ask_homes(self, now: float) -> None:
        """One after the other and again, where we did not see them take off."""
        homeless = self.context.fleet.homeless
        if homeless and now - self._asked > HOMES_EVERY:
            self._asked = now
            self._homes += 1
            self.context.later(self.context.fleet.ask_home(homeless[self._homes % len(homeless)]))

    def take_charge(self) -> None:
        book = self.context.charge.take()
        again = self.context.ledger.take_over(book, check_goal) if book else []
        self._tokens.in_charge(True)
        text = f"{self.context.settings.name} is in charge (term {self.context.charge.term})"
        if book:
            text += f": {book.planner} was not heard for {self.context.charge.patience:.0f} s; {len(again)} goals go on"
        self.context.say("charge", "notice" if book else "info", text)
        if book:
            self.check_map(book, again)
        self._maps.clear()
        self.publisher.book()

    def check_map(self, book: swarm.Book, again: list[swarm.GoalEntry]) -> None:
        """Nothing is flown among obstacles that the one before us knew of and we do not."""
        world, read = self.context.world, self._maps.get(book.instance)
        if read is not None:
            world.follow(read.obstacles, time.monotonic(), time.time())
        known = sum(read is None or each.name not in read.odd for each in world.obstacles)
        if known >= book.obstacles or not again:
            return
        for entry in again:
            entry.state, entry.text = "paused", "paused: not all obstacles are known"
        text = f"of the {book.obstacles} obstacles that {book.planner} knew, {known} are known here"
        text += f" (not kept: {read.words})" if read is not None and read.odd else ""
        self.context.say("charge", "error", f"{text}: its goals are paused; tell them again, and resume")

    def _step_down(self, book: swarm.Book) -> None:
        """Command nobody from now on: segments end by themselves, the leases are given back."""
        self._tokens.in_charge(False)
        for run in self.runs.values():
            self.context.later(run.close())
        self.runs.clear()
        self.context.ledger.goals.clear()

    def _end_runs(self) -> None:
        """Stop what was cancelled, replaced or paused; forget what has ended."""
        for name, run in list(self.runs.items()):
            if run.done:
                del self.runs[name]
            elif run.entry.state in ENDED:
                run.stop(run.entry.text)

    def _begin_runs(self) -> None:
        busy = {vehicle for run in self.runs.values() for vehicle in run.vehicles}
        hearing, held = self.context.fleet.hearing(), ""
        for entry in self.context.ledger.ready():
            if entry.id in self.runs or busy & set(entry.goal.vehicles):
                continue
            if not hearing.may_move(entry.goal.vehicles):
                held = entry.text = hearing.words()
                continue
            busy |= set(entry.goal.vehicles)
            self.runs[entry.id] = Run(self.context, self.publisher, entry)
            self.context.untold.set()
        if held != self._held:
            self._held = held
            if held:
                self.context.say("partition", "warning", held)
