"""One vehicle under our command: its lease, its clock against ours, and what it says of itself."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

import zmav
from agents.planner.execute.commit import Stamp
from agents.planner.execute.offset import Offset
from agents.planner.live.frames import enu, ned
from agents.planner.model.problem import Floats
from zmav import keys, wire
from zmav.errors import BadInput, Clash, Forbidden, NotHolder, Refused, ZmavError
from zmav.vehicle import Lease
from zmav.waiting import cancelled, within

if TYPE_CHECKING:
    from agents.planner.returning.ways import Way

PINGS, SURE, LONGEST = 4, 0.01, 5.0
"""questions of the time before the clock is believed, at least; more, for so many seconds, until it is known so well"""
PING_EVERY, PING_UNSURE, PING_SOON = 3.0, 0.5, 0.12
UNSURE = 0.05
"""s of error from which the time is asked for more often"""
PING_TIMEOUT = 2.0
AGAIN = ("gone", "expired", "failsafe")
"""how a lease ends that nobody took: it is asked for again; failsafe: nothing came for so long that the vehicle held"""
DENIED = (Forbidden, Refused, BadInput, Clash)
"""a vehicle's own word that it gives no lease, and not the network's silence"""
DENIED_FOR = 30.0
"""s for which it says so until it is given up: it may be about to change"""
RESTING = 0.5
"""m/s below which a vehicle rests"""
TTL = 12.0
"""s of a lease: renewed thrice, it outlasts storms; a holder that died is known by its token, long before"""


class Clock:
    """Our UTC as it was when we began, carried on by the monotonic clock: a step of the host's time moves nothing."""

    def __init__(self) -> None:
        self._ahead = time.time() - time.monotonic()

    def now(self) -> float:
        return self._ahead + time.monotonic()

    def of(self, monotonic: float) -> float:
        return self._ahead + monotonic


class VehicleCommand:
    """``async with VehicleCommand(...)``: takes the lease and measures the clock; both are kept until it is left.

    Raises :class:`~zmav.errors.NotHolder` while another commands the vehicle, and what else asking for a lease raises.
    """

    def __init__(self, z: zmav.Client, name: str, clock: Clock, holder: str, offset: Offset | None = None) -> None:
        self.vehicle, self.name = z.vehicle(name), name
        self.offset = Offset() if offset is None else offset
        self._z, self._clock, self._holder = z, clock, holder
        self._stack = contextlib.AsyncExitStack()
        self._lease: Lease | None = None
        self._tasks: list[asyncio.Task[None]] = []
        self._seen = -1.0
        self.taken = ""
        """who or what took it from us for good; empty: it is ours"""
        self.heading: float | None = None
        """rad clockwise from north that it looks to in what it is told; None: as its autopilot likes"""

    async def __aenter__(self) -> VehicleCommand:
        self._lease = await self._stack.enter_async_context(self.vehicle.lease(self._holder, TTL))
        try:
            await learn_time(self._z, self.name, self._clock, self.offset)
        except BaseException:
            await self._stack.aclose()
            raise
        self._tasks = [asyncio.create_task(self._measure()), asyncio.create_task(self._renew())]
        return self

    async def __aexit__(self, *exc: object) -> None:
        await cancelled(*self._tasks)
        self.offset.free()
        await self._stack.aclose()

    # What it says.

    def news(self) -> tuple[wire.VehicleState, float] | None:
        """Its state and when that came (our time), where it is newer than at the last call."""
        heard = self._z.heard(self.name, self.vehicle.fleet)
        if heard is None or heard.at <= self._seen:
            return None
        self._seen = heard.at
        came = self._clock.of(heard.at)
        self.offset.heard(heard.state.t, came)
        if self._lease is not None:
            self._lost(self._lease)
        return heard.state, came

    @property
    def place(self) -> Floats | None:
        """Where it last said that it was: (3,) ENU."""
        state = self.vehicle.last_state
        return None if state is None or state.local is None else np.array(enu(state.local))

    @property
    def rests(self) -> bool:
        """By what it said last it stands still, and is on no segment that moves it on."""
        state = self.vehicle.last_state
        if state is None or state.velocity is None or float(np.linalg.norm(state.velocity)) > RESTING:
            return False
        if state.mover == "failsafe":
            return False  # on its way home by itself, of which a moment's rest at a corner is part
        return self.ended

    @property
    def ended(self) -> bool:
        """By what it said last it is on no segment that moves it on."""
        state = self.vehicle.last_state
        return state is not None and (state.segment is None or state.segment.rests <= state.t)

    @property
    def ours(self) -> bool:
        """By what it said last nobody has taken it from us."""
        if self._lease is not None:
            self._lost(self._lease)
        return not self.taken

    @property
    def lease(self) -> int:
        """The number of ours; 0: we have none just now."""
        return 0 if self._lease is None or self._lost(self._lease) else self._lease.number

    @property
    def instance(self) -> str:
        """Of its agent; empty while nothing was heard of it."""
        state = self.vehicle.last_state
        return "" if state is None else state.instance

    # What it is told.

    def put(self, rows: Floats, deadline: float, home: Way | None = None) -> tuple[Stamp, float] | None:
        """Put a segment of rows t, place, velocity (ENU, our time), to be taken by ``deadline`` (our time).
        ``home``: what the vehicle flies if nothing comes after it.

        Gives its stamp and its deadline by the vehicle's clock; None where we do not have the lease just now.
        """
        lease = self._lease
        if lease is None or self._lost(lease):
            return None
        points = [_point(row, self.offset, self.heading) for row in rows.tolist()]
        until = self.offset.vehicle(deadline)
        try:
            way = None if home is None else way_home(home, self.offset)
            lease.segment(points, deadline=until, repeated=False, home=way)
        except NotHolder:
            self._lost(lease)
            return None
        return (lease.number, lease.sent), until

    def _lost(self, lease: Lease) -> bool:
        lost = lease.lost
        if lost is not None and not self.taken and lost.detail.get("reason") not in AGAIN:
            self.taken = str(lost)
        return lost is not None

    # What goes on behind.

    async def _measure(self) -> None:
        while True:
            unsure = self.offset.error(self._clock.now()) > UNSURE
            await asyncio.sleep(PING_UNSURE if unsure else PING_EVERY)
            await ask_time(self._z, self.name, self._clock, self.offset)

    async def _renew(self) -> None:
        """Where the lease ended and nobody took it (a cut network), ask for another one until it is denied for good."""
        while not self.taken:
            await asyncio.sleep(0.2)
            if self._lease is None or not self._lost(self._lease) or self.taken:
                continue
            self._lease = None
            with contextlib.suppress(asyncio.TimeoutError):
                await within(3.0, self._stack.aclose())
            self._stack = contextlib.AsyncExitStack()
            denied: float | None = None
            while self._lease is None:
                try:
                    self._lease = await self._stack.enter_async_context(self.vehicle.lease(self._holder, TTL))
                except NotHolder as e:
                    if e.detail.get("holder") != self._holder:
                        self.taken = str(e)
                        return
                except DENIED as e:
                    denied = self._clock.now() if denied is None else denied
                    if self._clock.now() - denied >= DENIED_FOR:
                        self.taken = str(e)
                        return
                except ZmavError:  # it says nothing
                    denied = None
                await asyncio.sleep(0.3)


async def ask_time(z: zmav.Client, name: str, clock: Clock, offset: Offset) -> None:
    """Ask a vehicle of the client's fleet for its time, and take the answer in; none that makes sense: nothing."""
    with contextlib.suppress(ZmavError, KeyError, TypeError, ValueError):
        asked = clock.now()
        answers = await z.ask(keys.DO.key(z.fleet_name, name, verb="ping"), timeout=PING_TIMEOUT)
        came = clock.now()
        if answers and not isinstance(answers[0], ZmavError):
            outcome = wire.decode(answers[0].payload, wire.Outcome, "reply to do/ping")
            offset.answered(asked, float(outcome.result["t"]), came)


async def learn_time(z: zmav.Client, name: str, clock: Clock, offset: Offset, longest: float = LONGEST) -> None:
    """Ask a vehicle for its time again and again, not waiting for one answer before the next question, for so many
    seconds at most. One answer is enough where it is known well: the vehicle's clock may have been set since.
    """
    begun, asking = clock.now(), list[asyncio.Task[None]]()
    known = offset.error(begun) < SURE
    try:
        while (now := clock.now()) < begun + longest:
            asked_enough = any(task.done() for task in asking) if known else len(asking) >= PINGS
            if asked_enough and offset.error(now) < SURE:
                return
            asking.append(asyncio.create_task(ask_time(z, name, clock, offset)))
            await asyncio.sleep(PING_SOON)
    finally:
        await cancelled(*asking)


def way_home(home: Way, offset: Offset) -> wire.WayHome:
    """By the vehicle's clock, NED."""
    points = [(round(t - home.begins, 3), ned((x, y, z)), ned((u, v, w))) for t, x, y, z, u, v, w in home.rows.tolist()]
    return wire.WayHome(start=round(offset.vehicle(home.begins), 4), points=points)


def _point(row: Sequence[float], offset: Offset, heading: float | None) -> wire.SegmentPoint:
    t, x, y, z, vx, vy, vz = row
    return wire.SegmentPoint(t=round(offset.vehicle(t), 4), pos=ned((x, y, z)), vel=ned((vx, vy, vz)), yaw=heading)
