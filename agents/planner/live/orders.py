"""Steps that vehicles carry out by themselves: takeoff, landing, circles for planes, a hold."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Iterable, Mapping
from collections.abc import Set as AbstractSet
from typing import Any

import msgspec
import numpy as np

import zmav
from agents.planner.goals.steps import Loiter, Orders, VehicleOrder
from agents.planner.live.frames import enu
from agents.planner.live.leased_vehicles import GoalUnderWay, LeasedVehicles
from agents.planner.live.reserved import Tube, tube
from agents.planner.solve.loiter import STEADY, LoiterCircle
from zmav import wire
from zmav.errors import BadInput, Refused, Stale, ZmavError
from zmav.verbs import VERBS
from zmav.waiting import together
from zmav.wire import Vector

SOON = 0.5
AGAIN = 40
"""times, :data:`SOON` apart, that a vehicle is told to land again whose autopilot is silent"""
CIRCLING = 1.5
"""radii from its circle's centre at which a plane on it may be"""
SLOWEST, CRAWL, SLACK = 60.0, 0.5, 3.0
"""s, m/s up or down, and times what the way takes: how long planes are given"""


async def carry_out(run: GoalUnderWay, leased: LeasedVehicles, step: Orders, gone: AbstractSet[str]) -> None:
    """Each order once those before it are done. When one fails the others hold, and what it raises is raised at once;
    of landings the others go on first, but for those that wait for a way down that the one who failed may be in.

    ``gone``: vehicles that somebody else has, or that nobody hears: theirs count as failed.
    """
    places = {name: run.place(name) for name in step.vehicles if name not in gone}
    await speak_for(run, {name: _columns(run, name, step.orders, place) for name, place in places.items()})
    over, done, failed = [asyncio.Event() for _ in step.orders], set[int](), dict[str, str]()

    async def one(number: int, order: VehicleOrder) -> None:
        if order.vehicle not in gone:
            for before in order.after:
                await over[before].wait()
            try:
                _check_way(order, {step.orders[before].vehicle for before in order.after} & (failed.keys() | gone))
                run.text(f"{order.verb} of {order.vehicle}")
                vehicle, args = leased.vehicle(order.vehicle), order.args
                await (land(vehicle, args) if order.verb == "land" else give(vehicle, order.verb, args))
            except ZmavError as e:
                if not step.lands:
                    raise
                failed[order.vehicle] = f"{order.vehicle}: {e.message}"
                run.context.say("land", "warning", f"{failed[order.vehicle]}; the others land", goal=run.entry.id)
            else:
                done.add(number)
        over[number].set()

    try:
        await together(*(one(number, order) for number, order in enumerate(step.orders)))
    except (asyncio.CancelledError, ZmavError):
        await halt(run, leased, {order.vehicle for number, order in enumerate(step.orders) if number not in done})
        raise
    if failed:
        raise Refused("; ".join(failed.values()), vehicles=sorted(failed))


def _check_way(order: VehicleOrder, lost: AbstractSet[str]) -> None:
    if lost:
        text = f"it stays where it is: {', '.join(sorted(lost))} may be in its way down"
        raise Refused(text, vehicle=order.vehicle)


async def give(vehicle: zmav.Vehicle, verb: str, args: Mapping[str, Any]) -> None:
    """One order as it stands in a step; who is to take off is armed first."""
    try:
        order = msgspec.convert(dict(args), VERBS[verb].args)
    except (msgspec.ValidationError, KeyError) as e:
        raise BadInput(f"{verb}: {e}", field=verb, value=dict(args), expected="the order's arguments") from e
    if verb == "takeoff" and not vehicle.state.armed:
        await vehicle.arm()
    await vehicle.order(verb, order)


async def land(vehicle: zmav.Vehicle, args: Mapping[str, Any], again: int = AGAIN) -> None:
    """As :func:`give`. It lands on while its agent does not hear its autopilot, and to be told so ``again`` does no
    harm: raises :class:`Stale` only where that was in vain so many times.
    """
    for _ in range(again):
        with contextlib.suppress(Stale):
            await give(vehicle, "land", args)
            return
        await asyncio.sleep(SOON)
    await give(vehicle, "land", args)


async def halt(run: GoalUnderWay, leased: LeasedVehicles, names: Iterable[str]) -> None:
    """Have those that move stop where they are, under our leases, which go on. Who was taken from us is another's: a
    hold of ours would end his lease. Anyone who does not answer is told of.
    """
    moving = [name for name in names if _in_the_air(run, name)]
    ours = [name for name in moving if name in leased.commands and leased.commands[name].ours]
    results = await asyncio.gather(*(leased.vehicle(name).hold() for name in ours), return_exceptions=True)
    for name, result in zip(ours, results, strict=True):
        if isinstance(result, ZmavError):
            run.context.say("hold", "warning", f"{name} was told to hold, and did not: {result}", goal=run.entry.id)


async def speak_for(run: GoalUnderWay, volumes: Mapping[str, list[Tube]]) -> None:
    """Wait until nobody else has spoken for that room, and do."""
    context = run.context
    while blocker := context.airspace.blocker(context.kin(run.entry.id), volumes, context.settings.downwash):
        run.text(f"waits for room beside {blocker}")
        await asyncio.sleep(SOON)
    context.airspace.hold(run.entry.id, volumes)


async def loiter(run: GoalUnderWay, leased: LeasedVehicles, step: Loiter) -> None:
    """Planes to their circles; done when all circle."""
    await speak_for(run, {circle.vehicle: _around(run, circle) for circle in step.circles})
    await circle({name: leased.vehicle(name) for name in step.vehicles}, step)


async def circle(vehicles: Mapping[str, zmav.Vehicle], step: Loiter) -> None:
    """Each to the height of its circle where it is, once those before it have reached theirs; then on its way.

    An order to a plane is done when it circles there, at whatever height: the heights are waited for besides.
    """
    risen = {name: asyncio.Event() for name in step.vehicles}

    async def one(slot: LoiterCircle) -> None:
        for other in slot.first:
            await risen[other].wait()
        vehicle, centre, speed = vehicles[slot.vehicle], slot.centre_ned, slot.speed

        async def to(place: Vector) -> None:
            late = SLOWEST + SLACK * math.dist(place, _local(vehicle)) / speed
            there = wire.GoTo(frame="ned", pos=place, radius=slot.radius, speed=speed, timeout=late)
            await vehicle.order("goto", there)

        north, east, down = _local(vehicle)
        if abs(down - centre[2]) > STEADY:
            await to((north, east, centre[2]))
            late = SLOWEST + abs(down - centre[2]) / CRAWL
            await vehicle.wait_until(lambda _: abs(_local(vehicle)[2] - centre[2]) <= STEADY, late)
        risen[slot.vehicle].set()
        await to(centre)

    await together(*map(one, step.circles))


def _local(vehicle: zmav.Vehicle) -> Vector:
    """NED about the fleet's origin."""
    local = vehicle.state.local
    if local is None:
        raise Refused(f"{vehicle.name} does not know where it is", vehicle=vehicle.name)
    return local


def _around(run: GoalUnderWay, circle: LoiterCircle) -> list[Tube]:
    """All that it may be off its way over the ground, from where it is to its circle."""
    wide = CIRCLING * circle.radius
    seen = run.context.fleet.seen(circle.vehicle)
    assert seen is not None
    x, y, z = enu(seen.view.pos_ned)
    centre = enu(circle.centre_ned)
    boxes = tube([(x, y, z), (x, y, centre[2]), centre], 0.0).boxes + np.array(
        [-wide, -wide, -STEADY, wide, wide, STEADY]
    )
    return [Tube(boxes, seen.view.body.radius)]


def _columns(run: GoalUnderWay, name: str, orders: tuple[VehicleOrder, ...], place: Vector) -> list[Tube]:
    """Where these orders lead it: straight up (takeoff) and down (land)."""
    seen = run.context.fleet.seen(name)
    assert seen is not None
    ground = -seen.view.floor
    way = [place]
    for order in (order for order in orders if order.vehicle == name):
        x, y, _ = way[-1]
        if order.verb == "takeoff":
            way.append((x, y, ground + float(order.args.get("alt_rel", 0.0))))
        else:
            way.append((x, y, min(ground, way[-1][2])))
    return [tube(way, seen.view.body.radius)]


def _in_the_air(run: GoalUnderWay, name: str) -> bool:
    seen = run.context.fleet.seen(name)
    return seen is not None and (seen.view.airborne or (not seen.view.flies and bool(seen.state.armed)))
