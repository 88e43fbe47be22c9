"""Fly a rotation: take off, change places under leases by streamed setpoints, land."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable
from typing import Any

import msgspec

import zmav
from agents.planner.straight import Route, rotate
from zmav import keys, wire
from zmav.errors import NotHolder, Refused, TimedOut, ZmavError
from zmav.waiting import together

NAME = "planner"
RATE = 10.0
TOLERANCE = 1.0
"""m from the goal over the ground, after landing"""
SETTLED = 0.15
"""m from the goal before landing; after five seconds of trying, half the tolerance will do"""


class Flown(msgspec.Struct):
    """How one vehicle's part ended."""

    arrived: bool = False
    away: float | None = None
    """m from its goal after landing"""
    setpoints: int = 0
    error: str | None = None


class Swap:
    """One rotation of several vehicles. ``say(state)`` is told of every step."""

    def __init__(self, z: zmav.Client, names: tuple[str, ...], node: str, say: Callable[[str], None]) -> None:
        self._z, self._names, self._node, self._say = z, names, node, say
        self.flown = {name: Flown() for name in names}
        self._state = ""
        self._taken: set[str] = set()
        """vehicles that a pilot took over: they are his"""

    async def fly(self) -> bool:
        """True when every vehicle landed at its goal."""
        vehicles = await self._z.wait_for(*self._names, timeout=30.0)
        starts = {v.name: await self._start_of(v) for v in vehicles}
        routes = rotate(starts)
        async with contextlib.AsyncExitStack() as held:
            leases = [await held.enter_async_context(v.lease(NAME)) for v in vehicles]
            self._tell("takeoff")
            await together(*(self._rise(v, routes[v.name]) for v in vehicles))
            self._tell("swap")
            await self._stream(leases, routes)
            self._tell("land")
            await together(*(self._land(lease.vehicle, routes[lease.vehicle.name]) for lease in leases))
        done = all(part.arrived for part in self.flown.values())
        self._tell("done" if done else "failed")
        return done

    async def _start_of(self, vehicle: zmav.Vehicle) -> wire.Vector:
        state = await vehicle.wait_until(lambda s: bool(s.connected and s.ready), timeout=90.0)
        if state.local is None:
            raise Refused(f"{vehicle.name} has no fleet origin: start 'zmav up' with --origin", vehicle=vehicle.name)
        return state.local

    async def _rise(self, vehicle: zmav.Vehicle, route: Route) -> None:
        try:
            await vehicle.arm()
            await vehicle.takeoff(route.height)
        except Refused as e:
            if "mode" in e.detail:
                self._taken.add(vehicle.name)
            raise

    async def _stream(self, leases: list[zmav.Lease], routes: dict[str, Route]) -> None:
        """Setpoints to all by one clock until the last line is flown and every vehicle is near its goal."""
        start = time.monotonic()
        lines = {name: route.line for name, route in routes.items()}
        ends = max(line.duration for line in lines.values())
        step = 0
        while True:
            now = time.monotonic() - start
            for lease in leases:
                self._put(lease, lines[lease.vehicle.name].at(now))
            near = SETTLED if now < ends + 5.0 else TOLERANCE / 2
            late = [lease.vehicle.name for lease in leases if self._away(lease.vehicle, routes) > near]
            if now > ends and not late:
                return
            if now > ends + 30.0:
                raise TimedOut(f"not at the goal 30 s after the plan's end: {', '.join(late)}")
            if step % int(RATE) == 0:
                self._tell("swap")
            step += 1
            await asyncio.sleep(max(0.0, start + step / RATE - time.monotonic()))

    def _put(self, lease: zmav.Lease, pos: wire.Vector) -> None:
        try:
            lease.setpoint(pos=pos)
        except NotHolder as e:
            if e.detail.get("reason") == "pilot":
                self._taken.add(lease.vehicle.name)
                raise Refused(f"{lease.vehicle.name} was taken over: {e}", **e.detail) from e
            raise
        self.flown[lease.vehicle.name].setpoints = lease.sent

    def _away(self, vehicle: zmav.Vehicle, routes: dict[str, Route]) -> float:
        """Metres over the ground from the goal, by a state that is fresh; raises Stale where it is not."""
        local = vehicle.state.local
        return math.inf if local is None else math.dist(local[:2], routes[vehicle.name].line.goal[:2])

    async def _land(self, vehicle: zmav.Vehicle, route: Route) -> None:
        await vehicle.land()
        part = self.flown[vehicle.name]
        part.away = self._away(vehicle, {vehicle.name: route})
        part.arrived = part.away < TOLERANCE

    def _tell(self, state: str) -> None:
        detail: dict[str, Any] = {name: msgspec.to_builtins(part) for name, part in self.flown.items()}
        status = wire.AgentStatus(t=time.time(), agent=NAME, state=state, detail=detail)
        self._z.put(keys.AGENT_STATUS, keys.AGENT_STATUS.key(self._z.fleet_name, self._node, agent=NAME), status)
        if state != self._state:
            self._state = state
            self._say(state)

    async def give_up(self) -> None:
        """Land all that are still ours."""
        landings = (self._z.vehicle(name).land() for name in self._names if name not in self._taken)
        await asyncio.gather(*landings, return_exceptions=True)


async def swap(z: zmav.Client, names: tuple[str, ...], node: str, say: Callable[[str], None]) -> dict[str, Flown]:
    """Fly it; on any error every vehicle that no pilot took over is told to land, and the error is raised."""
    flight = Swap(z, names, node, say)
    try:
        await flight.fly()
    except (ZmavError, asyncio.CancelledError):
        await flight.give_up()
        raise
    return flight.flown
