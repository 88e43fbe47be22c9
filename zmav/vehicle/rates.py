"""What messages a vehicle sends, and how a reader says how fast it wants one."""

from __future__ import annotations

import contextlib
import math
import uuid
from collections.abc import Iterator
from typing import TYPE_CHECKING

from zmav import keys, wire
from zmav.errors import BadInput

if TYPE_CHECKING:
    from zmav.client import Client
    from zmav.vehicle.vehicle import Vehicle

MAX_HZ = 500.0


def want_key(key: str, hz: float, reader: str = "reader") -> str:
    """The key of the token that says: anyone who reads ``key`` (of ``mav/rx``) wants its message at ``hz``.

    The vehicle may be a pattern: then every vehicle it fits takes it for its own. Raises :class:`BadInput` where the
    key does not name one message, or the rate is not above 0 and at most 500 Hz.
    """
    chunks = key.split("/")
    name = chunks[-1]
    if len(chunks) != 8 or chunks[3:5] != ["mav", "rx"] or not keys.MESSAGE.match(name):
        text = f"a rate is for one message, as in 'quad1/ATTITUDE'; {key!r} names none"
        raise BadInput(text, field="key", value=key, expected="VEHICLE/MESSAGE")
    if not (math.isfinite(hz) and 0.0 < hz <= MAX_HZ):
        raise BadInput(f"no rate {hz:g} Hz: expected above 0, at most {MAX_HZ:g}", field="hz", value=hz, expected="Hz")
    return keys.WANT.key(chunks[1], chunks[2], msg=name, hz=f"{hz:g}", instance=f"{reader}-{uuid.uuid4().hex[:8]}")


class Rates:
    """The messages of one vehicle, as :attr:`zmav.vehicle.Vehicle.rates`."""

    def __init__(self, vehicle: Vehicle, client: Client) -> None:
        self._vehicle, self._client = vehicle, client

    async def table(self) -> wire.RateTable:
        """What comes from the autopilot, what it was asked for, what is wanted by whom, and what is slowed."""
        vehicle = self._vehicle
        answer = await vehicle._ask(keys.RATES.key(vehicle.fleet, vehicle.name))
        return wire.decode(answer, wire.RateTable, "reply to rates")

    @contextlib.contextmanager
    def want(self, name: str, hz: float) -> Iterator[None]:
        """Have the autopilot send a message at ``hz`` while the ``with`` lasts, no matter who reads it."""
        vehicle = self._vehicle
        key = keys.RX.key(vehicle.fleet, vehicle.name, sys="*", comp="*", msg=keys.check_message(name))
        token = self._client.session.liveliness().declare_token(want_key(key, hz))
        try:
            yield
        finally:
            token.undeclare()
