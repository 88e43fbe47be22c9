"""The right to command one vehicle, as its holder sees it."""

from __future__ import annotations

import asyncio
import contextlib
import time
import uuid
from collections.abc import AsyncIterator, Sequence
from typing import TYPE_CHECKING, Any, Literal

from zmav import keys, wire
from zmav.errors import BadInput, NotHolder, ZmavError
from zmav.trust.seal import Exchange, seal
from zmav.waiting import within

if TYPE_CHECKING:
    from zmav.client import Client
    from zmav.vehicle.vehicle import Vehicle

RELEASE_TIMEOUT = 2.0
"""s to give a lease back to a vehicle that may be gone"""


class Lease:
    """The right to command one vehicle, and the stream of setpoints under it. Made by :meth:`Vehicle.lease`.

    It ends when another agent of a higher priority, an operator or the pilot takes it, when it is not renewed in time,
    or when this process dies; the vehicle then holds, as it does while the network brings nothing. From then on
    :meth:`setpoint` raises what took it.
    """

    def __init__(
        self, vehicle: Vehicle, client: Client, args: wire.TakeLease, granted: dict[str, Any], secret: bytes = b""
    ) -> None:
        self.vehicle, self.holder, self.priority = vehicle, args.holder, args.priority
        self.token, self.number = str(granted["lease"]), int(granted["number"])
        self._client, self._args, self._secret = client, args, secret
        self._seq = 0
        self._agent: str | None = None
        """the instance of the vehicle's agent that granted it"""
        heard = vehicle.last_state
        self._since = heard.t if heard else 0.0
        """by the vehicle's clock: what it said until then is of leases before this one"""
        self.abandoned = False
        """it is not given back at its end: whom it was held for is gone, and failsafes follow as for who has died"""
        self._lost: ZmavError | None = None
        self._key = keys.SETPOINT.key(vehicle.fleet, vehicle.name, agent=args.holder)
        self._points = client.session.declare_publisher(self._key, **keys.SETPOINT.publishing())

    @property
    def lost(self) -> ZmavError | None:
        """What took it: ``detail["reason"]`` as in :class:`~zmav.wire.LeaseEnd`; None while it is in force."""
        if self._lost is None:
            self._lost = self._ended()
        return self._lost

    @property
    def sent(self) -> int:
        """Setpoints put so far."""
        return self._seq

    def setpoint(
        self,
        *,
        pos: wire.Vector | None = None,
        lat_deg: float | None = None,
        lon_deg: float | None = None,
        alt_amsl: float | None = None,
        alt_rel: float | None = None,
        vel: wire.Vector | None = None,
        acc: wire.Vector | None = None,
        yaw: float | None = None,
        yaw_rate: float | None = None,
        attitude: wire.Quaternion | None = None,
        rates: wire.Vector | None = None,
        thrust: float | None = None,
        torque: wire.Vector | None = None,
        manual: wire.ManualControl | None = None,
        rc: Sequence[int | None] | None = None,
        servo: Sequence[int | None] | None = None,
        valid: float = 0.5,
    ) -> None:
        """Put one point, not to be flown later than ``valid`` seconds from now; fields as in :class:`wire.Setpoint`.

        Repeat it at 5 Hz or more: half a second of silence and the vehicle holds. Raises what took the lease.
        """
        frame: Literal["ned", "global"] = "global" if lat_deg is not None or lon_deg is not None else "ned"
        self._put(
            valid,
            frame=frame,
            pos=pos,
            lat_deg=lat_deg,
            lon_deg=lon_deg,
            alt_amsl=alt_amsl,
            alt_rel=alt_rel,
            vel=vel,
            acc=acc,
            yaw=yaw,
            yaw_rate=yaw_rate,
            attitude=attitude,
            rates=rates,
            thrust=thrust,
            torque=torque,
            manual=manual,
            rc=None if rc is None else list(rc),
            servo=None if servo is None else list(servo),
        )

    def segment(
        self,
        points: Sequence[wire.SegmentPoint],
        *,
        valid: float = 0.5,
        deadline: float | None = None,
        repeated: bool = True,
        home: wire.WayHome | None = None,
    ) -> None:
        """Commit the vehicle to a trajectory that ends at rest; it flies it by itself, however bad the network gets.

        ``valid``: seconds within which it must have arrived there; ``deadline``: the same as UTC seconds by the
        vehicle's own clock. The next segment or setpoint takes its place. ``repeated``: links send again what they
        lose, and later ones wait behind it; without, put it again until the vehicle's state names it.
        ``home``: what the vehicle flies if nothing comes after it and its fleet file has ``return = "together"``.
        """
        for point in points:  # null in its place would leave the heading to the vehicle; in vectors it is refused there
            if point.yaw is not None:
                wire.check_finite({"yaw": point.yaw}, "segment.")
        self._put(valid, deadline, repeated, segment=list(points), home=home)

    def close(self) -> None:
        """Nothing is put any more."""
        text = f"the lease of {self.holder} on {self.vehicle.name} was given back"
        self._lost = self.lost or NotHolder(text, vehicle=self.vehicle.name, reason="released")
        self._points.undeclare()

    def _put(self, valid: float, deadline: float | None = None, repeated: bool = False, **fields: Any) -> None:
        if self.lost is not None:
            raise self.lost
        self._seq += 1
        until = time.time() + valid if deadline is None else deadline
        point = wire.Setpoint(lease=self.token, seq=self._seq, deadline=until, **fields)
        data = wire.encode_request(point)
        proof = seal(self._secret, self._key, data) if self._secret else None
        self._client.put(keys.SETPOINT, self._key, data, proof, None if repeated else self._points)

    def _ended(self) -> ZmavError | None:
        """What the vehicle's state says of it."""
        state, name = self.vehicle.last_state, self.vehicle.name
        if state is None:
            return None
        if self._agent is None and state.lease is not None and state.lease.number == self.number:
            self._agent = state.instance
        if self._agent is not None and state.instance != self._agent:
            return NotHolder(f"the agent of {name} was restarted: the lease is gone", vehicle=name, reason="gone")
        end = state.lease_end
        if end is None or end.number != self.number or (self._agent is None and state.t <= self._since):
            return None
        detail = {"vehicle": name, "reason": end.reason, **({"by": end.by} if end.by else {})}
        return NotHolder(f"{name}: {end.text}", **detail)

    async def keep(self) -> None:
        """Renew until cancelled or until the vehicle says no; a bad network is no reason to stop trying."""
        while self.lost is None:
            await asyncio.sleep(self._args.ttl / 3)
            renewal = wire.TakeLease(
                holder=self.holder,
                ttl=self._args.ttl,
                priority=self.priority,
                instance=self._args.instance,
                router=_router(self._client),
                lease=self.token,
            )
            try:
                await self.vehicle.order("lease", renewal)
            except (NotHolder, BadInput) as e:
                self._lost = self._lost or e
            except ZmavError:
                continue


def _router(client: Client) -> str:
    """Zenoh id of the router that the client is at; empty while it is at none."""
    return next(map(str, client.session.info.routers_zid()), "")


@contextlib.asynccontextmanager
async def take_lease(vehicle: Vehicle, client: Client, holder: str, ttl: float, priority: int) -> AsyncIterator[Lease]:
    """Take the lease, renew it, give it back. The liveliness token goes before it: its loss tells the vehicle that
    this process has died.
    """
    instance = uuid.uuid4().hex
    key = keys.HOLDER.key(vehicle.fleet, vehicle.name, holder=keys.check_name(holder, "holder"), instance=instance)
    token = client.session.liveliness().declare_token(key)
    try:
        exchange = Exchange() if client.member is not None else None
        public = exchange.public if exchange else ""
        args = wire.TakeLease(
            holder=holder, ttl=ttl, priority=priority, instance=instance, router=_router(client), key=public
        )
        granted, secret = await vehicle.order("lease", args), b""
        if exchange and "key" in granted:  # a vehicle without credentials asks for no seal
            secret = exchange.secret(str(granted["key"]), f"{vehicle.fleet}/{vehicle.name}", str(granted["lease"]))
        lease = Lease(vehicle, client, args, granted, secret)
        renewer = asyncio.create_task(lease.keep())
        try:
            yield lease
        finally:
            renewer.cancel()
            lease.close()
            with contextlib.suppress(ZmavError, asyncio.TimeoutError):  # where it does not arrive, the token's end does
                if not lease.abandoned:
                    await within(RELEASE_TIMEOUT, vehicle.order("release", wire.DropLease(lease=lease.token)))
    finally:
        token.undeclare()
