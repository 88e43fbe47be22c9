"""Messages that somebody asked the gateway for: the autopilots are told, for as long as it is asked for again.

An autopilot sends what somebody reads. The gateway reads whatever flows, which says nothing; so anyone who asks for a
message by its name has a token declared for it (see :mod:`zmav.vehicle.rates`), which goes a while after the last
time.
"""

from __future__ import annotations

import asyncio
import time

import zenoh

from zmav import keys
from zmav.client import Client
from zmav.errors import BadInput
from zmav.services.rates.demand import NOT_STREAMED
from zmav.vehicle.rates import want_key

LASTING = 30.0
"""s that an asked message is wanted for"""
MOST = 256
"""tokens at once: more messages are not asked for"""


class Wants:
    """Tokens by fleet, vehicle, message and rate. On the event loop."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._tokens: dict[tuple[str, str, str, float], zenoh.LivelinessToken] = {}
        self._until: dict[tuple[str, str, str, float], float] = {}
        self._timer: asyncio.TimerHandle | None = None

    def __len__(self) -> int:
        return len(self._tokens)

    def want(self, vehicle: str, message: str, hz: float, fleet: str = "") -> bool:
        """Have a message sent at ``hz`` for :data:`LASTING` seconds from now.

        ``vehicle`` and ``fleet`` may be ``*``; no ``fleet`` is the client's. True where it was not wanted before and is
        now. Nobody is asked for what the dialect lacks, nor for answers, events and the heartbeat, which come when they
        come, nor for more than :data:`MOST` at once.
        """
        place = (fleet or self._client.fleet_name, vehicle, message, hz)
        new = place not in self._tokens
        if new:
            if len(self._tokens) >= MOST or not self._is_streamed(message):
                return False
            try:
                rx = keys.RX.key(place[0], vehicle, sys="*", comp="*", msg=message)
                self._tokens[place] = self._client.session.liveliness().declare_token(want_key(rx, hz, "http"))
            except BadInput:
                return False
        self._until[place] = time.monotonic() + LASTING
        if self._timer is None:
            self._sweep()
        return new

    def _is_streamed(self, message: str) -> bool:
        found = self._client.dialect.by_name.get(message)
        return found is not None and found.target_system is None and message not in NOT_STREAMED

    def close(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        for token in self._tokens.values():
            token.undeclare()
        self._tokens.clear()
        self._until.clear()

    def _sweep(self) -> None:
        now = time.monotonic()
        for place in [place for place in self._tokens if self._until[place] < now]:
            del self._until[place]
            self._tokens.pop(place).undeclare()
        self._timer = asyncio.get_running_loop().call_later(1.0, self._sweep) if self._tokens else None
