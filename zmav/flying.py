"""An agent that flies its vehicle: one flight at a time, begun by an order, under a lease of its own."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Coroutine
from typing import Any

import msgspec

from zmav.agent import Agent
from zmav.errors import ZmavError
from zmav.vehicle.lease import Lease
from zmav.waiting import cancelled

PATIENCE = 10.0
"""s for a vehicle that was not heard yet: over a bad link the first word takes some"""

Started = asyncio.Future[None]


class FlightSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Fixed while it runs."""

    priority: int = 0
    """of its lease"""
    lease_s: float = 6.0
    """it lasts without being renewed, which may take some over a bad link; unheard, the vehicle holds long before"""


class FlyingAgent(Agent):
    """Base of agents that fly. Lives on the event loop."""

    settings_type = FlightSettings
    flight: asyncio.Task[None] | None = None

    async def run(self) -> None:
        """Wait for orders, for ever."""
        self.status("idle", "waits for an order")
        try:
            await self.listen()
        finally:
            await self.end_flight()

    async def listen(self) -> None:
        """What it does beside its flights, without an end."""
        await asyncio.Event().wait()

    @property
    def flying(self) -> bool:
        """A flight is under way: from its order until it has ended."""
        return self.flight is not None and not self.flight.done()

    def lease(self) -> contextlib.AbstractAsyncContextManager[Lease]:
        """The right to move the vehicle."""
        return self.vehicle.lease(self.name, ttl=float(self.settings.lease_s), priority=self.settings.priority)

    async def begin_flight(self, fly: Callable[[Started], Coroutine[Any, Any, str]]) -> None:
        """Have it fly; returns when ``fly`` has set its future's result, and raises what kept it from that. ``fly``
        gives what became of the flight, in words.
        """
        started: Started = asyncio.get_running_loop().create_future()
        self.flight = asyncio.create_task(self._watch(fly, started))
        # How it ended was said: asyncio need not complain that nobody asked.
        self.flight.add_done_callback(lambda flight: flight.cancelled() or flight.exception())
        await started

    async def end_flight(self) -> None:
        """Cancel it, and wait until the lease is given back."""
        await cancelled(self.flight)

    async def on_broken_off(self, error: Exception, why: str) -> str:
        """What is done after an error in flight; gives the words for the status."""
        text = f"broken off: {why}"
        self.say("flight", "error", text)
        return text

    def on_ended(self, text: str) -> None:
        """The flight is over, or was not begun."""
        self.status("idle", text)

    async def _watch(self, fly: Callable[[Started], Coroutine[Any, Any, str]], started: Started) -> None:
        text = "was ended"
        try:
            text = await fly(started)
        except Exception as e:
            why = e.message if isinstance(e, ZmavError) else f"the {self.name}'s own fault: {e!r}"
            if not started.done():
                text = f"was not begun: {why}"
                started.set_exception(e)
                return
            text = await self.on_broken_off(e, why)
            raise
        finally:
            if not started.done():
                started.cancel()
            self.on_ended(text)
