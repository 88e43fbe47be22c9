"""What is proven in the labs: each proof acts on a lab that runs and returns what it saw."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections import Counter
from collections.abc import AsyncIterator
from dataclasses import dataclass, field

import zenoh

import zmav
from mesh.lab.lab import Lab
from tests.mesh.proofs.rigs import PATIENCE, Events, Gaps, active, in_the_air
from tests.mesh.proofs.tap import STEP, Tap
from zmav import wire
from zmav.errors import NotHolder, ZmavError


@dataclass
class Orders:
    """Orders given one after the other, each seen through with its id."""

    done: int = 0
    lost: list[str] = field(default_factory=list)
    slowest: float = 0.0
    """s"""


@contextlib.asynccontextmanager
async def giving_orders(vehicle: zmav.Vehicle, every: float = 0.1) -> AsyncIterator[Orders]:
    """Give orders meanwhile."""
    orders, stop = Orders(), asyncio.Event()

    async def give() -> None:
        while not stop.is_set():
            start = time.monotonic()
            try:
                await vehicle.order("ping", wire.Order())
                orders.done += 1
            except ZmavError as e:
                orders.lost.append(str(e))
            orders.slowest = max(orders.slowest, time.monotonic() - start)
            await asyncio.sleep(every)

    giving = asyncio.create_task(give())
    try:
        yield orders
    finally:
        stop.set()
        await giving


@dataclass
class Recovery:
    """What cuts of the active path did."""

    gaps: list[float]
    """s without telemetry, cut by cut"""
    orders: Orders
    sent: int
    """setpoints"""
    flown: int
    ended: list[str]
    """why leases ended, each of which was followed by a new one"""


SIDES = {"ground-a1": ("ground-a1", "a1-a2", "a2-quad1"), "ground-b1": ("ground-b1", "b1-b2", "b2-quad1")}


async def recovery(lab: Lab, z: zmav.Client, cuts: int, rest: float = 3.0) -> Recovery:
    """Cut the path that is in use, on each of its links in turn, and wait until telemetry flows over the other."""
    vehicle, gaps = z.vehicle("quad1"), []
    one, other = SIDES
    sent: list[zmav.Lease] = []
    ended: list[str] = []
    stream, times = vehicle.stream("ATTITUDE", hz=50.0), Gaps(z, lab.fleet, "quad1")
    steering = asyncio.create_task(_steer(vehicle, sent, ended))
    async with stream, giving_orders(vehicle) as orders:
        await times.again(time.monotonic())
        _, before = active(lab, one, other, [0, 0])
        for i in range(cuts):
            await asyncio.sleep(1.0)
            side, _ = active(lab, one, other, before)
            link, at = SIDES[side][i % 3], time.monotonic()
            lab.cut(link)
            gaps.append(await times.again(at))
            lab.heal(link)
            await asyncio.sleep(rest)
            _, before = active(lab, one, other, [0, 0])
    steering.cancel()
    await asyncio.gather(steering, return_exceptions=True)
    times.close()
    counts = (await vehicle.wait_until(lambda state: True, PATIENCE)).setpoints
    flown = sum(n for why, n in counts.items() if why in ("flown", "engaging"))
    return Recovery(gaps, orders, sum(lease.sent for lease in sent), flown, ended)


async def _steer(vehicle: zmav.Vehicle, leases: list[zmav.Lease], ended: list[str]) -> None:
    """Velocities of zero, so that it stays where it is, under a new lease when one has ended."""
    while True:
        try:
            async with vehicle.lease("planner", ttl=30.0) as lease:
                leases.append(lease)
                while True:
                    lease.setpoint(vel=(0.0, 0.0, 0.0))
                    await asyncio.sleep(0.05)
        except ZmavError as e:
            ended.append(str(e))
            await asyncio.sleep(0.5)


@dataclass
class MustArrive:
    """Leases taken and given back over a bad network, and what the vehicle said of it."""

    given: list[str]
    """what its events ought to say, in order"""
    heard: list[str]
    """what a reader of its events was told"""
    failed: list[str]
    took: float


async def must_arrive(lab: Lab, z: zmav.Client, name: str, count: int) -> MustArrive:
    """Orders with an effect that shows how often they were done, and the events that tell of it.

    Not :meth:`zmav.Vehicle.lease`: it waits two seconds for its release and leaves the rest to the holder's token.
    """
    vehicle, events = z.vehicle(name), await _hearing(z, lab.fleet, name)
    given, failed, start = [], [], time.monotonic()
    for i in range(count):
        agent = f"agent{i}"
        try:
            granted = await vehicle.order("lease", wire.TakeLease(holder=agent, ttl=60.0))
            given.append(f"{agent} commands")
            await vehicle.order("release", wire.DropLease(lease=granted["lease"]))
            given.append(f"{agent} gave the lease back")
        except ZmavError as e:
            failed.append(str(e))
    took = time.monotonic() - start
    with contextlib.suppress(asyncio.TimeoutError):
        await events.until("lease", f"agent{count - 1} gave", 30.0)
    events.close()
    return MustArrive(given, events.texts("lease"), failed, took)


async def _hearing(z: zmav.Client, fleet: str, name: str) -> Events:
    """A reader that has heard what was before it: from then on it hears.

    One that subscribes while an event is on its way may get none of the past (docs/concepts.md): another one is asked.
    """
    deadline = time.monotonic() + 30.0
    while True:
        events = Events(z.session, fleet, name)
        try:
            await events.until("autopilot", "system id", 5.0)
            return events
        except asyncio.TimeoutError:
            events.close()
            if time.monotonic() > deadline:
                raise


@dataclass
class Partition:
    """A vehicle under a stream of setpoints, alone for a while."""

    sent: dict[int, float]
    """number -> monotonic s"""
    cut: float
    healed: float
    back: float
    """s from the healing until its state was heard again"""
    oldest: float
    """s between a setpoint's put and the last frame made from it"""
    during: set[int]
    """numbers of frames that the autopilot received while it was alone, from a second after the cut"""
    before: int
    """setpoints of the stream that the autopilot received before the cut"""
    alone: int
    """setpoints that were put while it was alone"""
    stale: set[int]
    """numbers put while it was alone that the autopilot received at any time"""
    again: int
    """frames of the stream under the new lease"""
    said: list[str]
    """what it said of its failsafes from the cut on"""
    lost: str
    """what the first lease's holder was told"""


async def partition(lab: Lab, z: zmav.Client, tap: Tap, link: str, seconds: float) -> Partition:
    """Cut ``link`` on the way to quad1, which flies a stream of numbered velocities, and go on streaming."""
    vehicle, events = z.vehicle("quad1"), Events(z.session, lab.fleet, "quad1")
    sent: dict[int, float] = {}
    why = "nothing"
    async with vehicle.lease("planner", ttl=3.0) as lease:
        await stream(lease, sent, 2.0)
        cut, began = time.monotonic(), time.time()
        lab.cut(link)
        await stream(lease, sent, seconds)
        healed = time.monotonic()
        lab.heal(link)
        try:
            while not (state := vehicle.age) or state > 1.0:
                await stream(lease, sent, 0.2)
            back = time.monotonic() - healed
            await stream(lease, sent, PATIENCE)
        except NotHolder as e:
            why, back = str(e), time.monotonic() - healed
    first = max(sent)
    await vehicle.set_mode("GUIDED")
    if not (await vehicle.wait_until(lambda state: True, PATIENCE)).armed:  # it has landed meanwhile
        await in_the_air(vehicle)
    async with vehicle.lease("planner", ttl=3.0) as lease:
        await stream(lease, sent, 1.0)
    events.close()
    alone = {n for n, at in sent.items() if cut + 0.1 < at < healed and n <= first}
    heard = [h for h in tap.heard if h.number > 0]
    return Partition(
        sent,
        cut,
        healed,
        back,
        max(h.at - sent[h.number] for h in heard),
        {h.number for h in heard if cut + 1.1 < h.at < healed},
        len({h.number for h in heard if h.at < cut}),
        len(alone),
        {h.number for h in heard} & alone,
        len({h.number for h in heard if h.number > first}),
        [event.text for event in events.events if event.kind in ("setpoint", "failsafe") and event.t > began],
        why,
    )


async def stream(lease: zmav.Lease, sent: dict[int, float], seconds: float) -> None:
    """Velocities that say their number, 20 a second; raises :class:`NotHolder` when the lease is known to be lost."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        number = max(sent, default=0) + 1
        sent[number] = time.monotonic()
        try:
            lease.setpoint(vel=(number * STEP, 0.0, 0.0))
        except ZmavError:
            del sent[number]
            raise
        await asyncio.sleep(0.05)


async def formed(session: zenoh.Session, hosts: int, timeout: float = PATIENCE) -> float:
    """Seconds until the routers of all ``hosts`` answer."""
    start = time.monotonic()
    while (seen := await asyncio.to_thread(answering, session)) < hosts:
        if time.monotonic() - start > timeout:
            raise asyncio.TimeoutError(f"{seen} of {hosts} routers answer")
        await asyncio.sleep(0.1)
    return time.monotonic() - start


def answering(session: zenoh.Session) -> int:
    """How many routers answer: of their sessions and not of their link states, a question that can freeze a router."""
    return sum(reply.ok is not None for reply in session.get("@/*/router", timeout=2.0))


def states_twice(samples: list[bytes]) -> int:
    """States that came more than once, by the time they carry."""
    times = Counter(json.loads(payload)["t"] for payload in samples)
    return sum(n - 1 for n in times.values())
