"""Streams of setpoints for scripts: ``/setpoint/{vehicle}`` as often as one likes, ``/release/{vehicle}`` at the end.

The gateway takes the vehicle's lease for anyone who calls, and gives it back when the calls stop for :data:`SILENCE`
seconds; the vehicle then holds. A point stands for ``valid`` seconds and is put :data:`HZ` times a second meanwhile,
so that a caller of one a second flies as smoothly as his points allow.
"""

from __future__ import annotations

import asyncio
import time
from typing import Annotated, Any, NamedTuple

import msgspec
from msgspec import Meta
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from ground.http.arguments import arguments_of
from ground.http.documents import answer
from ground.http.gateway import Gateway
from zmav import keys, wire
from zmav.errors import BadInput, NotHolder, TimedOut, ZmavError
from zmav.vehicle import Vehicle
from zmav.vehicle.lease import Lease
from zmav.waiting import within

SILENCE = 1.5
"""s without a call after which the lease is given back"""
HZ = 5.0
TTL = 2.0
"""s that a lease outlives this process or its network"""
GRANT = 10.0
"""s for a vehicle to grant its lease"""
MOST = 200
"""streams at once"""


class Point(wire.Wire, kw_only=True):
    """One outer-loop point: fields as in :class:`zmav.wire.Setpoint`; ``n``, ``e``, ``d`` stand for ``pos``."""

    pos: Annotated[wire.Vector | None, Meta(description="m, north, east, down: [20,0,-6]")] = None
    n: Annotated[float | None, Meta(description="m north of the fleet's origin")] = None
    e: Annotated[float | None, Meta(description="m east")] = None
    d: Annotated[float | None, Meta(description="m down")] = None
    lat_deg: float | None = None
    lon_deg: float | None = None
    alt_amsl: float | None = None
    alt_rel: float | None = None
    vel: Annotated[wire.Vector | None, Meta(description="m/s, north, east, down")] = None
    acc: Annotated[wire.Vector | None, Meta(description="m/s², north, east, down")] = None
    yaw: Annotated[float | None, Meta(description="radians from north, clockwise")] = None
    yaw_rate: Annotated[float | None, Meta(description="radians a second")] = None
    valid: Annotated[float, Meta(gt=0.0, le=SILENCE, description="s from now for which it may be flown")] = 1.0
    priority: Annotated[int, Meta(ge=0, le=100, description="of the lease, when the first point takes it")] = 0

    def fields(self) -> dict[str, Any]:
        """What :meth:`Lease.setpoint` takes; raises :class:`BadInput` where nothing says where to go."""
        given = {name: value for name, value in msgspec.structs.asdict(self).items() if value is not None}
        for name in ("valid", "priority"):
            given.pop(name, None)
        ned = [given.pop(name, None) for name in ("n", "e", "d")]
        if any(part is not None for part in ned):
            if None in ned or self.pos is not None:
                text = "n, e and d are given all three, and without pos"
                raise BadInput(text, field="n", value=str(ned), expected="n, e and d in metres")
            given["pos"] = tuple(ned)
        if not any(name in given for name in ("pos", "lat_deg", "vel", "acc")):
            text = "nothing says where to go: give pos, or lat_deg, lon_deg and an altitude, or vel"
            raise BadInput(text, field="pos", value=None, expected="pos, lat_deg, vel or acc")
        return given


class Caller(NamedTuple):
    """Who streams to which vehicle: two of them on one host tell themselves apart by ``?as=NAME``."""

    vehicle: str
    host: str
    name: str


class SetpointStream:
    """A lease held for one caller, and his last point put again and again. Lives on the event loop."""

    def __init__(self, vehicle: Vehicle, holder: str, priority: int) -> None:
        self._vehicle, self._holder, self._priority = vehicle, holder, priority
        self._called = time.monotonic()
        self._until = 0.0
        self._fields: dict[str, Any] = {}
        self._stop = asyncio.Event()
        self.over = False
        """no more points are taken: the lease is lost, or on its way back"""
        self.lease: asyncio.Future[Lease] = asyncio.get_running_loop().create_future()
        self.task = asyncio.create_task(self._hold())

    async def put(self, fields: dict[str, Any], valid: float) -> Lease:
        """Fly this now; raises what keeps the vehicle from granting its lease, or has taken it."""
        self._called = time.monotonic()
        await asyncio.wait({self.lease}, timeout=GRANT)
        if not self.lease.done():
            raise TimedOut(f"{self._vehicle.name} has not granted its lease", vehicle=self._vehicle.name)
        lease = self.lease.result()
        self._fields, self._called, self._until = fields, time.monotonic(), time.monotonic() + valid
        lease.setpoint(**fields, valid=min(valid, 0.5))
        return lease

    async def end(self) -> None:
        """Give the lease back; returns when that is done."""
        self._stop.set()
        await asyncio.gather(self.task, return_exceptions=True)

    async def _hold(self) -> None:
        try:
            async with self._vehicle.lease(self._holder, ttl=TTL, priority=self._priority) as lease:
                self.lease.set_result(lease)
                try:
                    await self._repeat(lease)
                finally:
                    self.over = True
        except ZmavError as e:
            self.over = True
            if not self.lease.done():
                self.lease.set_exception(e)
                self.lease.exception()  # anyone who waits has it; that nobody does is no fault

    async def _repeat(self, lease: Lease) -> None:
        """Until it is asked to end, its caller is silent, or the lease is lost."""
        self._called = time.monotonic()
        while not self._stop.is_set() and time.monotonic() - self._called < SILENCE:
            try:
                await within(1.0 / HZ, self._stop.wait())
            except asyncio.TimeoutError:
                left = self._until - time.monotonic()
                if left > 0.0:
                    lease.setpoint(**self._fields, valid=min(left, 0.5))


class SetpointStreams:
    """Every caller's stream, by caller and vehicle."""

    def __init__(self, gateway: Gateway) -> None:
        self._gateway = gateway
        self._streams: dict[Caller, SetpointStream] = {}

    def __len__(self) -> int:
        return len(self._streams)

    def cancel(self) -> None:
        for stream in self._streams.values():
            stream.task.cancel()

    async def setpoint(self, request: Request) -> Response:
        """Fly to a point: m, north, east, down about the fleet's origin, as long as it is called once a second."""
        caller = _caller(request)
        point = wire.build(await arguments_of(request, Point), Point, "setpoint")
        fields = point.fields()
        stream = self._streams.get(caller)
        if stream is not None and stream.over:
            await stream.end()
            stream = self._streams.get(caller)
        if stream is None or stream.over:
            stream = self._start(caller, point.priority)
        try:
            lease = await stream.put(fields, point.valid)
        except ZmavError:
            await stream.end()
            raise
        return answer(_said(lease))

    async def release(self, request: Request) -> Response:
        """End the caller's stream and give the lease back; the vehicle holds."""
        caller = _caller(request)
        stream = self._streams.pop(caller, None)
        if stream is None or stream.over:
            text = f"{caller.name} streams nothing to {caller.vehicle}"
            raise NotHolder(text, vehicle=caller.vehicle, holder=caller.name)
        await stream.end()
        return answer({"vehicle": caller.vehicle, "released": True})

    def _start(self, caller: Caller, priority: int) -> SetpointStream:
        self._streams = {each: stream for each, stream in self._streams.items() if not stream.over}
        if len(self._streams) >= MOST:
            text = f"{MOST} streams run already: use zmav.Vehicle.lease for more"
            raise BadInput(text, field="vehicle", value=caller.vehicle, expected=f"at most {MOST} streams")
        stream = SetpointStream(self._gateway.client.vehicle(caller.vehicle), caller.name, priority)
        self._streams[caller] = stream
        return stream


def _said(lease: Lease) -> dict[str, Any]:
    """``lease`` lets orders through beside the stream; ``setpoints``: the vehicle's count of what became of them."""
    state = lease.vehicle.last_state
    return {
        "vehicle": lease.vehicle.name,
        "holder": lease.holder,
        "lease": lease.token,
        "sent": lease.sent,
        "setpoints": state.setpoints if state else {},
    }


def routes(gateway: Gateway) -> list[BaseRoute]:
    streams = SetpointStreams(gateway)
    gateway.at_end(streams.cancel)
    gateway.figures["streams"] = lambda: len(streams)
    return [
        Route("/setpoint/{vehicle}", streams.setpoint, methods=["GET", "POST"]),
        Route("/release/{vehicle}", streams.release, methods=["GET", "POST"]),
    ]


def _caller(request: Request) -> Caller:
    """Raises :class:`~zmav.errors.BadKey` for a name that cannot be a holder's."""
    host = request.client.host if request.client else ""
    own = "http" if host in ("", "127.0.0.1", "::1") else "http-" + "".join(c if c.isalnum() else "-" for c in host)
    name = keys.check_name(request.query_params.get("as", own), "as")
    return Caller(request.path_params["vehicle"], host, name)
