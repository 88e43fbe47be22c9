"""Where segments go: to the vehicle's own setpoint service under a lease, or to a controller agent that flies them."""

from __future__ import annotations

import asyncio
import time

import zmav
from zmav import wire
from zmav.errors import NotHolder, Refused, Stale, TimedOut, ZmavError
from zmav.waiting import within

TAKEN, TRIES = 1.0, 3
"""s in which the vehicle says that it flies a segment, before it is put again; how often it is put"""
PASSING = (None, "late", "order", "link")
"""why a vehicle drops what a network held back, or nothing that it says of what it drops: put again, it may be flown"""
PRESENT = 4.0
"""s for a controller to answer that it is there"""


class ByLease:
    """The autopilot's own cascade flies: segments are put under the navigator's lease."""

    def __init__(self, vehicle: zmav.Vehicle, lease: zmav.Lease) -> None:
        self._vehicle, self._lease = vehicle, lease
        self._seen, self._taken = 0.0, 1
        """when it said that it flies what it took (monotonic s), and the first setpoint that brought that"""
        self._tries = 0
        """how often one was put that a vehicle which is heard did not take"""
        self._unsure: int | None = None
        """the first setpoint of what was put to a vehicle that is not heard since: it may fly by it"""
        self._refusal = self._word = ""
        """the vehicle's last words on setpoints: why one is not flown, however often it is put; and any other"""

    def hear(self, event: wire.Event) -> None:
        """What the vehicle says of setpoints."""
        if event.detail.get("why") in PASSING:
            self._word = event.text
        else:
            self._refusal = event.text

    async def give(self, points: list[wire.SegmentPoint]) -> bool | None:
        """Put it, and wait until the vehicle is committed to it. False: it flies on by what it has, and the way is to
        be given again; None: it is not heard, see :meth:`settled`. Raises what the vehicle has against it, or where it
        is heard and takes none in so many tries.
        """
        first, self._refusal, self._unsure = self._lease.sent + 1, "", None
        self._lease.segment(points)
        try:
            await self._vehicle.wait_until(lambda state: self._ended or self._flies(state, first), TAKEN)
        except TimedOut:
            if not self._heard:
                self._unsure, self._tries = first, 0
                return None
            self._tries += 1
            if self._refusal or self._tries >= TRIES:
                raise self._refused from None
            return False
        return self._took(first)

    def settled(self) -> bool | None:
        """Whether the vehicle took what was put last; None: it has not been heard since."""
        if self._unsure is None:
            return True
        state = self._vehicle.last_state
        if state is None or not self._heard:
            return None
        first, self._unsure = self._unsure, None
        return self._flies(state, first) and self._took(first)

    def _took(self, first: int) -> bool:
        self._taken, self._tries, self._word = first, 0, ""
        self.check()
        return True

    @property
    def _heard(self) -> bool:
        return (age := self._vehicle.age) is not None and age <= TAKEN

    def check(self) -> None:
        if self._lease.lost is not None:
            raise self._lease.lost
        state = self._vehicle.last_state
        if state is not None and self._flies(state, self._taken):
            self._seen = time.monotonic()
        elif time.monotonic() - self._seen > TAKEN:
            raise self._refused

    @property
    def _ended(self) -> bool:
        return self._lease.lost is not None

    def _flies(self, state: wire.VehicleState, first: int) -> bool:
        """A segment of ours of that number or later: all of them are of the same way."""
        flown = state.segment
        return flown is not None and flown.lease == self._lease.number and flown.seq >= first

    @property
    def _refused(self) -> ZmavError:
        text = self._refusal or self._word or "it does not say why"
        lost = self._lease.lost
        return lost or Refused(f"{self._vehicle.name} does not fly the segment: {text}", reasons=[text])


class ByController:
    """An agent that has taken over a part of the cascade is told to follow; it has a lease of its own."""

    def __init__(self, vehicle: zmav.Vehicle, controller: str) -> None:
        self._vehicle, self._controller = vehicle, controller
        self._told: asyncio.Task[object] | None = None
        self._lease: int | None = None

    async def open(self) -> None:
        """Raise where no agent of that name runs."""
        me, name = self._vehicle.name, self._controller
        try:
            await within(PRESENT, self._vehicle.tell(name, "params"))
        except asyncio.TimeoutError:
            raise Refused(
                f"no agent {name} answers: start 'zmav agent run {name} --vehicle {me}'", agent=name
            ) from None

    async def give(self, points: list[wire.SegmentPoint]) -> bool | None:
        """Returns when the controller has taken it, or goes on with it for long."""
        if self._told is not None:
            self._told.cancel()
        self._told = asyncio.create_task(self._vehicle.tell(self._controller, "follow", segment=points))
        await asyncio.wait({self._told}, timeout=TAKEN)
        self.check()
        return True

    def settled(self) -> bool | None:
        return True

    def check(self) -> None:
        if self._told is not None and self._told.done() and not self._told.cancelled():
            self._told.result()
        state = self._vehicle.last_state
        if state is None:
            raise Stale(f"{self._vehicle.name} has not been heard", vehicle=self._vehicle.name)
        if state.pilot is not None:
            raise NotHolder(f"the pilot has {self._vehicle.name}: {state.pilot}", reason="pilot")
        if self._lease is None:
            self._lease = state.lease.number if state.lease is not None else None
        elif state.lease is None or state.lease.number != self._lease:
            end = state.lease_end
            text = end.text if end is not None and end.number == self._lease else "its lease has ended"
            reason = end.reason if end is not None and end.number == self._lease else "gone"
            raise NotHolder(f"{self._controller} has the vehicle no more: {text}", reason=reason)

    def close(self) -> None:
        if self._told is not None:
            self._told.cancel()


Outlet = ByLease | ByController
"""``give`` lets points be flown from now on (False: the way is to be given again, as it is by then; None: nobody knows
before ``settled`` does), ``check`` raises the :class:`~zmav.errors.ZmavError` that ended it.
"""
