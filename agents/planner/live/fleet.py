"""The fleet as the planner sees it: who is heard, who flies, where everybody is and took off, what each can do."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace

import msgspec
import numpy as np

import zmav
from agents.planner.execute.following import Following
from agents.planner.goals.steps import GROUND, FleetView, VehicleView
from agents.planner.live.accuracy import Accuracies
from agents.planner.live.energy import Energy, Need, left_of
from agents.planner.live.tally import Tally
from zmav import geo, keys, wire
from zmav.config import body_of
from zmav.errors import BadInput, ZmavError
from zmav.wire import Vector

FRESH = keys.STATE.stale_after or 2.0
"""s after which a state is not relied upon"""
KNOWN = 30.0
"""s for which goals know a vehicle that is not heard: a bad link silences it for seconds, and it is waited for"""
TORN = 5.0
"""s of silence after which a vehicle counts as one on the far side of a torn network: longer than storms last"""
FORGOTTEN = 3600.0
"""s after which a vehicle that was last heard in the air is no longer reckoned with"""
BODY_AGAIN = 30.0
"""s after which a vehicle that answered is asked again: its agent may have been started with another fleet file"""
BODY_SOON = 3.0
"""s after which one that did not is asked again"""


class Bodies:
    """What vehicles said of themselves. Lives on the event loop."""

    def __init__(self, z: zmav.Client) -> None:
        self._z = z
        self._told: dict[str, wire.swarm.BodyReport] = {}
        self._next: dict[str, float] = {}

    def of(self, name: str, kind: str | None) -> wire.swarm.Body:
        """What it said, or what is usual for its kind."""
        told = self._told.get(name)
        return told.body if told is not None else body_of(kind)

    def returns_after(self, name: str) -> float | None:
        """s after its segment's end from which it would fly a way home by itself; None: it does not."""
        told = self._told.get(name)
        return None if told is None else told.returns_after

    def settle(self, names: Iterable[str]) -> None:
        """Forget all but these."""
        self._told = {name: self._told[name] for name in names if name in self._told}
        self._next = {name: self._next[name] for name in names if name in self._next}

    def due(self, names: list[str]) -> list[str]:
        """Those that should be asked now."""
        now = time.monotonic()
        return [name for name in names if self._next.get(name, 0.0) <= now]

    async def ask(self, name: str) -> None:
        """Ask one vehicle; no answer, or one that makes no sense, leaves what is known."""
        self._next[name] = time.monotonic() + BODY_SOON
        try:
            answers = await self._z.ask(keys.BODY.key(self._z.fleet_name, name), timeout=2.0, channel=keys.BODY)
        except ZmavError:
            return
        for answer in answers:
            if isinstance(answer, ZmavError):
                continue
            try:
                told = wire.decode(answer.payload, wire.swarm.BodyReport, f"body of {name}")
            except BadInput:
                continue
            if _sensible(told.body):
                self._told[name] = told
                self._next[name] = time.monotonic() + BODY_AGAIN


def _sensible(body: wire.swarm.Body) -> bool:
    """Numbers that a plan can be made with."""
    positive = (body.radius, body.speed, body.accel, body.climb, body.descend, body.sweep_width, body.endurance)
    others = (body.min_speed, body.turn_radius, body.position_error or 0.0)
    if not 0.0 <= body.reserve < 1.0:
        return False
    return all(0.0 < value < 1e6 for value in positive) and all(0.0 <= value < 1e6 for value in others)


@dataclass(frozen=True)
class HeardVehicle:
    """One vehicle, as last heard."""

    view: VehicleView
    age: float
    """s since its state came"""
    state: wire.VehicleState


@dataclass(frozen=True)
class Hearing:
    """``airborne``: all that fly, as far as known, heard now or not; ``heard``: those whose state is fresh.

    A planner moves the vehicles of a goal only while it hears all of them, or some of them and more than half of the
    fleet's airborne vehicles. So of two planners that cannot hear each other's vehicles, one at most goes on with any
    goal. Who is not heard keeps the way that it was last committed to, and the column where it was last heard, for
    its failsafe may land it. The smaller side moves nothing: its vehicles end what they are committed to, and rest.
    """

    airborne: frozenset[str]
    heard: frozenset[str]

    @property
    def majority(self) -> bool:
        """More than half of those in the air are heard; with nobody in the air there is nothing to be torn apart."""
        return not self.airborne or 2 * len(self.airborne & self.heard) > len(self.airborne)

    def may_move(self, vehicles: Iterable[str]) -> bool:
        """A goal of these vehicles may begin, or go on with another segment."""
        ours = set(vehicles)
        return ours <= self.heard or (self.majority and bool(ours & self.heard))

    @property
    def unheard(self) -> frozenset[str]:
        """Those in the air that are not heard: keep clear of where they may be."""
        return self.airborne - self.heard

    def words(self) -> str:
        """Why nothing is begun."""
        missing = ", ".join(sorted(self.unheard))
        part = f"{len(self.airborne & self.heard)} of {len(self.airborne)} vehicles in the air"
        return (
            f"only {part} are heard (not {missing}): this may be the smaller side of a torn network, so nothing moves"
        )


class Fleet:
    """Follows the states that the client hears. Lives on the event loop."""

    def __init__(self, z: zmav.Client, downwash: float = 1.5) -> None:
        self._z, self.downwash = z, downwash
        self.bodies, self.accuracies, self.energy = Bodies(z), Accuracies(), Energy()
        self._homes: dict[str, Vector] = {}
        self._followings: dict[str, Following] = {}
        self.last: dict[str, tuple[wire.VehicleState, float]] = {}

    def watch(self) -> None:
        """A few times a second: take in what was heard, and remember who it was when it is heard no more, for
        :data:`FORGOTTEN` s: who comes again after that may be another vehicle.
        """
        for vehicle in self._z.fleet():
            state, age = vehicle.last_state, vehicle.age
            if state is None or age is None or state.local is None:
                continue
            self.last[vehicle.name] = (state, time.monotonic() - age)
            declared = self.bodies.of(vehicle.name, state.kind).position_error
            self.accuracies.heard(vehicle.name, state, declared, time.monotonic())
            flies = _flies(state, state.kind or "copter")
            self.energy.heard(vehicle.name, state, np.array(state.local), flies)
            if state.landed or not state.armed:
                self._homes[vehicle.name] = state.local
        now = time.monotonic()
        self.last = {name: (s, at) for name, (s, at) in self.last.items() if now - at < FORGOTTEN}
        for parts in (self.accuracies, self.energy, self.bodies):
            parts.settle(self.last)
        self._homes = {name: home for name, home in self._homes.items() if name in self.last}
        self._followings = {name: each for name, each in self._followings.items() if name in self.last}

    @property
    def names(self) -> list[str]:
        """Everybody that was heard with a place."""
        return sorted(self.last)

    def silent(self) -> list[str]:
        """Present, but without a place in the fleet's frame: nothing can be planned for these."""
        known = {name for name, (_, at) in self.last.items() if time.monotonic() - at < FRESH}
        return [v.name for v in self._z.fleet() if v.name not in known and v.age is not None and v.age < FRESH]

    def seen(self, name: str) -> HeardVehicle | None:
        """As last heard, however old; None: never, or without a place. Its radius has room for what its place may be
        off.
        """
        found = self.last.get(name)
        if found is None or found[0].local is None:
            return None
        state, at = found
        assert state.local is not None
        kind = state.kind or "copter"
        body, room = self.bodies.of(name, state.kind), self.accuracies.room(name)
        view = VehicleView(
            name=name,
            kind=kind,
            body=msgspec.structs.replace(body, radius=body.radius + room),
            room=room,
            pos_ned=state.local,
            vel_ned=state.velocity or (0.0, 0.0, 0.0),
            airborne=_flies(state, kind),
            home_ned=self._homes.get(name),
            ground=None if state.position is None else state.local[2] + state.position.alt_rel,
            armed=bool(state.armed),
        )
        return HeardVehicle(view, time.monotonic() - at, state)

    def followings_of(self, names: Iterable[str]) -> dict[str, Following]:
        """How these follow what they are told, as far as that was seen; it goes on to be."""
        found = {}
        for name in names:
            state = self.last[name][0] if name in self.last else None
            which = None if state is None else "rover" if state.kind in GROUND else state.autopilot
            found[name] = self._followings.setdefault(name, Following(which))
        return found

    def battery_of(self, name: str) -> float | None:
        """The share that is left in it; None: not known."""
        found = self.last.get(name)
        return None if found is None else left_of(found[0])

    def needs(self, tally: Tally, view: FleetView) -> dict[str, Need]:
        """What a goal that comes to that takes from each one's battery."""
        return self.energy.needs(tally, view, {name: self.battery_of(name) for name in tally.parts})

    @property
    def homeless(self) -> list[str]:
        """Those that were in the air when we came, and did not say yet where they took off: they cannot return."""
        return [name for name in self.last if name not in self._homes]

    async def ask_home(self, name: str) -> None:
        """Of its autopilot (HOME_POSITION); no answer, or one that makes no sense, leaves what is known."""
        try:
            told = (await self._z.vehicle(name).message("HOME_POSITION")).fields
            lat, lon, alt = float(told["latitude"]) / 1e7, float(told["longitude"]) / 1e7, float(told["altitude"]) / 1e3
        except (ZmavError, KeyError, TypeError, ValueError):
            return
        found = self.last.get(name)
        if found is None or found[0].local is None or found[0].position is None:
            return
        local = found[0].local
        north, east, down = geo.to_ned(found[0].position, lat, lon, alt)
        self._homes.setdefault(name, (local[0] + north, local[1] + east, local[2] + down))

    def all(self) -> list[HeardVehicle]:
        return [seen for name in self.names if (seen := self.seen(name)) is not None]

    def view(self, margin: float = 0.0, also: Collection[str] = (), tight: Collection[str] = ()) -> FleetView:
        """Those that were heard in the last :data:`KNOWN` seconds, and ``also`` these, with radii that are larger by
        ``margin``; those of ``tight`` without room for what their places may be off.
        """
        heard = [seen.view for seen in self.all() if seen.age < KNOWN or seen.view.name in also]
        return FleetView({view.name: _widened(view, margin, view.name in tight) for view in heard})

    def hearing(self) -> Hearing:
        airborne = frozenset(seen.view.name for seen in self.all() if seen.view.airborne)
        heard = frozenset(seen.view.name for seen in self.all() if seen.age < TORN)
        return Hearing(airborne, heard)


def _widened(view: VehicleView, margin: float, tight: bool) -> VehicleView:
    less = view.room if tight else 0.0
    body = msgspec.structs.replace(view.body, radius=view.body.radius + margin - less)
    return replace(view, body=body, room=view.room - less)


def _flies(state: wire.VehicleState, kind: str) -> bool:
    if kind in GROUND or not state.armed:
        return False
    if state.landed is None:  # its autopilot does not say
        return state.position is not None and state.position.alt_rel > 1.0
    return not state.landed
