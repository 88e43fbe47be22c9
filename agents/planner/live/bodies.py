"""How much room each vehicle needs and what it can do: asked of each (``body``), and until it answers as usual."""

from __future__ import annotations

import time

import zmav
from zmav import keys, wire
from zmav.config import body_of
from zmav.errors import BadInput, ZmavError

AGAIN = 30.0
"""s after which a vehicle that answered is asked again: its agent may have been started with another fleet file"""
SOON = 3.0
"""s after which one that did not is asked again"""


class Bodies:
    """What vehicles said of themselves. Lives on the event loop."""

    def __init__(self, z: zmav.Client) -> None:
        self._z = z
        self._known: dict[str, wire.swarm.Body] = {}
        self._next: dict[str, float] = {}

    def of(self, name: str, kind: str | None) -> wire.swarm.Body:
        """What it said, or what is usual for its kind."""
        known = self._known.get(name)
        return known if known is not None else body_of(kind)

    def due(self, names: list[str]) -> list[str]:
        """Those that should be asked now."""
        now = time.monotonic()
        return [name for name in names if self._next.get(name, 0.0) <= now]

    async def ask(self, name: str) -> None:
        """Ask one vehicle; no answer, or one that makes no sense, leaves what is known."""
        self._next[name] = time.monotonic() + SOON
        try:
            answers = await self._z.ask(keys.BODY.key(self._z.fleet_name, name), timeout=2.0, channel=keys.BODY)
        except ZmavError:
            return
        for answer in answers:
            if isinstance(answer, ZmavError):
                continue
            try:
                body = wire.decode(answer.payload, wire.swarm.BodyReport, f"body of {name}").body
            except BadInput:
                continue
            if _sensible(body):
                self._known[name] = body
                self._next[name] = time.monotonic() + AGAIN


def _sensible(body: wire.swarm.Body) -> bool:
    """Numbers that a plan can be made with."""
    positive = (body.radius, body.speed, body.accel, body.climb, body.descend, body.sweep_width, body.endurance)
    others = (body.min_speed, body.turn_radius)
    return all(0.0 < value < 1e6 for value in positive) and all(0.0 <= value < 1e6 for value in others)
