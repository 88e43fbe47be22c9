"""The right to command one vehicle, as its holder sees it."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING

from zmav import keys, wire
from zmav.errors import BadInput, NotHolder, ZmavError

if TYPE_CHECKING:
    from zmav.client import Client
    from zmav.vehicle.vehicle import Vehicle


class Lease:
    """The right to command one vehicle, and the stream of setpoints under it."""

    def __init__(self, vehicle: Vehicle, client: Client, holder: str, token: str, ttl: float) -> None:
        self.vehicle, self.holder, self.token = vehicle, holder, token
        self._client, self._ttl = client, ttl
        self._seq = 0
        self._lost: ZmavError | None = None
        self._key = keys.SETPOINT.key(vehicle.fleet, vehicle.name, agent=holder)

    def setpoint(
        self,
        *,
        pos: wire.Vector | None = None,
        vel: wire.Vector | None = None,
        acc: wire.Vector | None = None,
        yaw: float | None = None,
        valid: float = 0.5,
    ) -> None:
        """Put one point (m, m/s, m/s², rad; NED about the fleet's origin), not to be flown later than ``valid`` seconds
        from now. Repeat it at 5 Hz or more: half a second of silence and the vehicle holds. Raises what took the lease.
        """
        if self._lost is not None:
            raise self._lost
        self._seq += 1
        point = wire.Setpoint(
            lease=self.token, seq=self._seq, deadline=time.time() + valid, pos=pos, vel=vel, acc=acc, yaw=yaw
        )
        self._client.put(keys.SETPOINT, self._key, point)

    @property
    def sent(self) -> int:
        """Setpoints put so far."""
        return self._seq

    async def keep(self) -> None:
        """Renew until cancelled or until the vehicle says no; a bad network is no reason to stop trying."""
        while self._lost is None:
            await asyncio.sleep(self._ttl / 3)
            try:
                args = wire.TakeLease(holder=self.holder, ttl=self._ttl, lease=self.token)
                granted = (await self.vehicle.order("lease", args))["lease"]
                if granted != self.token:  # it had run out, and nobody knows who flew meanwhile: that is for our user
                    self._lost = NotHolder(f"the lease of {self.vehicle.name} ran out", vehicle=self.vehicle.name)
                    await self.vehicle.order("release", wire.DropLease(lease=granted))
            except (NotHolder, BadInput) as e:
                self._lost = e
            except ZmavError:
                continue
