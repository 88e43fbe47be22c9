"""The README's commands one after another, with receivers that drift as typical ones do: how near any two truly came.

They are planned by the planner's own code and flown in virtual time by the executor's.

What a vehicle says is where it believes to be; it truly is off that by what the simulator's typical receivers and
barometers are.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable
from types import SimpleNamespace
from typing import Any, NamedTuple

import msgspec
import numpy as np

from agents.planner.execute.flight import TRACKING
from agents.planner.execute.following import Following
from agents.planner.goals.goals import resolve
from agents.planner.goals.steps import FleetView, Fly, Orders, PlanTo, VehicleView
from agents.planner.live import jobs
from agents.planner.live import plan as planning
from agents.planner.live.accuracy import position_error, rooms
from agents.planner.live.frames import ned
from agents.planner.live.margins import TIGHT
from agents.planner.live.plan import Planned
from agents.planner.live.preview import preview
from agents.planner.live.settings import PlannerSettings
from agents.planner.live.tally import Tally
from agents.planner.live.worker import SolverProcess
from agents.planner.live.world import Pieces
from agents.planner.model.problem import Floats, Motion
from agents.planner.model.separation import separation
from tests.agents.planner.execute.virtual import STEP, History
from tests.agents.planner.live.flying import AFLOAT, DOWNWASH, Make, readme
from zmav import wire
from zmav.config import body_of
from zmav.sim.sensors.estimate import SMOOTHING_S
from zmav.sim.sensors.noise import NoiseRows, Wander, noise_profile
from zmav.sim.sensors.suite import SLOW_PERIOD_S

MARGIN, SIZE = 0.5, 4
SPARE = 0.1
"""m for curves and clocks"""
LONGEST_S, MOST_PLANS = 240.0, 5
COMMANDS = ("takeoff", "formation", "goto", "swap")
PROMISED = 2.0 * body_of("copter").radius
NAMES = [f"quad{i + 1}" for i in range(SIZE)]


class Row(NamedTuple):
    """One command of one team."""

    what: str
    seed: int
    said: float
    """s that the preview said"""
    planned: float
    """s that its plans take"""
    flown: float
    """s in virtual time, without planning and waiting"""
    nearest: float
    """m between the nearest two, where they truly were, height counted less by the downwash"""
    stops: tuple[str, ...]
    """why they came to rest where no plan said so"""


class Sort(NamedTuple):
    """How vehicles follow their ways, and what the planner knows of that."""

    known: str | None
    lean: float
    """m, root mean square, off it"""
    late: tuple[float, ...]
    """s"""

    @property
    def tracking(self) -> float:
        """m, as the planner has it of such vehicles"""
        return max(TRACKING, Following(self.known).within)

    @property
    def margin(self) -> float:
        return self.tracking + SPARE

    @property
    def margins(self) -> planning.Margins:
        """As PlanMargins has them where clocks are known well, without the best of them."""
        return (self.margin, 1.0), (self.tracking / TIGHT + SPARE, 1.0 / TIGHT)


ARDUCOPTER = Sort(None, 0.12, (0.0,) * SIZE)
PX4 = Sort("px4", 0.3, (0.4, 0.43, 0.47, 0.5))
"""in wind"""
PX4_IN_CALM_AIR = PX4._replace(lean=0.12)


class Drift:
    """What each is off where it says that it is: m ENU, at any time."""

    def __init__(self, seed: int) -> None:
        noise = noise_profile("typical")
        level = np.array([noise.gps_wander_m, noise.gps_wander_m, noise.baro_drift_m])
        spans = np.array([noise.gps_wander_s, noise.gps_wander_s, noise.baro_drift_s])
        self._wander = Wander(NoiseRows((seed,), "gps wander", SIZE, 3), level, spans, SLOW_PERIOD_S)
        self._rows = [np.array(self._wander.value)]

    def at(self, times: Floats) -> Floats:
        """(T, 3, SIZE)"""
        while len(self._rows) <= times[-1] / SLOW_PERIOD_S + 1.0:
            self._wander.step()
            held = self._rows[-1]
            self._rows.append(held + (self._wander.value - held) * min(SLOW_PERIOD_S / SMOOTHING_S, 1.0))
        return np.array(self._rows)[(times / SLOW_PERIOD_S).astype(np.int64)]


class Keeping(planning.Planner):
    """The planner's, and what it planned last."""

    def __init__(self, views: Callable[[], Iterable[VehicleView]]) -> None:
        """``views``: everybody, as heard now."""
        worker = SolverProcess(None)  # type: ignore[arg-type]

        async def do(job: jobs.Job[Any]) -> Any:
            if isinstance(job, jobs.Resolve):
                return resolve(job.goal, job.view, job.scene, None, job.floor)
            return worker.do(job)

        nothing = SimpleNamespace(walls=lambda *_: (), vehicles=lambda *_: set())
        context = SimpleNamespace(
            settings=PlannerSettings(name="seeds", margin=MARGIN, downwash=DOWNWASH, plan_seconds=15.0),
            airspace=nothing,
            kin=lambda goal: (),
            world=SimpleNamespace(pieces=lambda t, lasting: Pieces()),
            fleet=SimpleNamespace(all=lambda: [SimpleNamespace(view=view, age=0.0) for view in views()]),
            homes=SimpleNamespace(movers=lambda *_: ()),
            clocks=SimpleNamespace(clock=SimpleNamespace(now=lambda: 0.0)),
            say=lambda *args, **kinds: None,
        )
        super().__init__(context, "seeds", SimpleNamespace(do=do))  # type: ignore[arg-type]
        self.plans: list[Planned] = []

    async def next_to(self, step: PlanTo, view: FleetView, margins: planning.Margins = ()) -> Planned:
        self.plans.append(await super().next_to(step, view, margins))
        return self.plans[-1]

    async def check(self, step: Fly, view: FleetView, margins: planning.Margins = ()) -> tuple[Planned | None, str]:
        planned, why = await super().check(step, view, margins)
        self.plans += [planned] if planned is not None else []
        return planned, why


class Team:
    """Four copters whose pads are 10 m apart in a row, as the quickstart has them."""

    def __init__(
        self, seed: int, sort: Sort = ARDUCOPTER, *, loss: float = 0.0, apart: float = 10.0, room: bool = True
    ) -> None:
        """``loss``: share of messages; ``room``: for what positions may be off."""
        self.seed, self.rng, self.drift, self.now = seed, np.random.default_rng(seed), Drift(seed), 0.0
        self.sort, self.loss = sort, loss
        noise = noise_profile("typical")
        gps = wire.Gps(fix="3D_FIX", satellites=10, hdop=1.21, h_acc=noise.gps_wander_m)
        error, _ = position_error(wire.VehicleState(t=0.0, fleet="demo", name="quad", instance="a", gps=gps))
        self.room = rooms(dict.fromkeys(NAMES, error))[NAMES[0]] if room else 0.0
        pads = np.array([(apart * i, 0.0, 0.0) for i in range(SIZE)])
        self.places = pads + self.drift.at(np.array([0.0]))[0].T  # where each believes to stand
        self.homes, self.up = self.places.copy(), False
        self.planner = Keeping(lambda: self.view().vehicles.values())

    def view(self) -> FleetView:
        body = body_of("copter")
        body = msgspec.structs.replace(body, radius=body.radius + MARGIN + self.room)
        return FleetView(
            {
                name: VehicleView(
                    name,
                    "copter",
                    body,
                    ned(tuple(place.tolist())),
                    airborne=self.up,
                    home_ned=ned(tuple(home.tolist())),
                    room=self.room,
                )
                for name, place, home in zip(NAMES, self.places, self.homes, strict=True)
            }
        )

    async def fly(self, what: str, make: Make) -> Row:
        goal, view = make(NAMES, 0.0), self.view()
        tally, self.planner.plans = Tally(goal.vehicles, view), []
        told = await preview(self.planner, goal, view, tally, self.sort.margins)
        begun, stops, nearest = self.now, list[str](), math.inf
        for step in await self.planner.resolve(goal, view):
            if isinstance(step, Orders):
                nearest = min(nearest, self._true(self._climb(step, view)))
        for planned in list(self.planner.plans):
            nearest = min(nearest, await self._through(planned, stops))
        planned_s = sum(planned.makespan for planned in self.planner.plans)
        return Row(what, self.seed, told["seconds"], planned_s, self.now - begun, nearest, tuple(stops))

    async def _through(self, planned: Planned, stops: list[str]) -> float:
        """Flown to its end, and planned again from where they rest as long as it is not; gives the nearest two."""
        nearest, ends = math.inf, np.array([motion[-1, 1:] for motion in planned.motions.values()])
        for _ in range(MOST_PLANS):
            history = self._history(planned)
            rows = np.repeat(self.places[None], len(history.places), axis=0)
            for i, part in enumerate(history.parts):
                rows[:, NAMES.index(part.id)] = [place[i] for place in history.places]
            nearest = min(nearest, self._true(rows))
            if (phase := history.conductor.phase(history.now)) == "done":
                return nearest
            blocked = ", ".join(f"{one} for {other}" for one, other in history.conductor.blocked.items())
            stops.append(history.conductor.halting or f"{phase}: {blocked}")
            there = PlanTo(tuple(planned.motions), ends, True)
            planned = await self.planner.next_to(there, self.view(), self.sort.margins)
        raise AssertionError(f"team {self.seed} did not come to its places: {stops}")

    def _history(self, planned: Planned) -> History:
        """As LeasedVehicles and the executor have it flown, for copters whose clocks are known well."""
        tracking = self.sort.tracking
        history = History(
            dict(planned.motions),
            self.rng,
            radius={vehicle.id: vehicle.radius - planned.margin for vehicle in planned.scene.vehicles},
            margin=max(tracking / TIGHT, tracking + min(0.0, planned.margin - self.sort.margin)),
            accel=planned.scene.vehicles[0].amax,
            loss=self.loss,
            delay=(0.05, 0.2) if self.loss else (0.01, 0.05),
            late=self.sort.late,
            lean=self.sort.lean,
        )
        for part in history.parts:
            part.follows(Following(self.sort.known))
        history.run(LONGEST_S, lambda it: it.conductor.phase(it.now) in ("done", "stuck", "halted"))
        return history

    def _climb(self, step: Orders, view: FleetView) -> Floats:
        """(T, SIZE, 3) up as ordered, some seconds after the order, each once those before it are there."""
        ends, ways = list[float](), dict[str, Motion]()
        for order in step.orders:
            i, top = NAMES.index(order.vehicle), float(order.args["alt_rel"])
            start = max((ends[k] for k in order.after), default=0.0) + float(self.rng.uniform(1.0, 4.0))
            ends.append(start + top / view.vehicles[order.vehicle].body.climb)
            x, y, z = self.places[i]
            ways[order.vehicle] = np.array([(0.0, x, y, z), (start, x, y, z), (ends[-1], x, y, z + top)])
        times = np.arange(0.0, max(ends) + STEP, STEP)
        self.up = True
        return np.stack([_along(ways[name], times) for name in NAMES], axis=1)

    def _true(self, places: Floats) -> float:
        """The nearest two of them, where they truly were; time has gone on by as much."""
        times: Floats = np.asarray(self.now + np.arange(len(places)) * STEP, dtype=np.float64)
        real = np.subtract(places, self.drift.at(times).transpose(0, 2, 1))
        self.now, self.places = float(times[-1]), places[-1]
        pairs = itertools.combinations(range(SIZE), 2)
        return min((_near(real[:, i], real[:, j]) for i, j in pairs), default=math.inf)


def _along(way: Motion, times: Floats) -> Floats:
    return np.column_stack([np.interp(times, way[:, 0], way[:, axis]) for axis in (1, 2, 3)])


def _near(one: Floats, other: Floats) -> float:
    """On the ground they stand as their pads do."""
    afloat = np.minimum(one[:, 2], other[:, 2]) > AFLOAT
    if not afloat.any():
        return math.inf
    begins = int(np.argmax(afloat))
    times = np.arange(len(one) - begins) * STEP
    tracks = [np.column_stack((times, each[begins:])) for each in (one, other)]
    return separation(tracks[0], tracks[1], DOWNWASH)[0]


async def team_rows(seed: int, sort: Sort = ARDUCOPTER, **how: Any) -> list[Row]:
    """Every command, one after another, by one team."""
    team, makes = Team(seed, sort, **how), readme()
    return [await team.fly(what, makes[what]) for what in COMMANDS]
