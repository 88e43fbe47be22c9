"""Steps that vehicles carry out by themselves: takeoff, landing, circles for planes, a hold."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

import zmav
from agents.planner.goals.steps import Loiter, Orders, VehicleOrder
from agents.planner.live.frames import enu, ned
from agents.planner.live.tubes import Tube, tube
from agents.planner.problem import Floats
from zmav.errors import BadInput, ZmavError
from zmav.verbs import VERBS
from zmav.waiting import together
from zmav.wire import Vector

if TYPE_CHECKING:
    from agents.planner.live.crew import Crew
    from agents.planner.live.run import Run

SOON = 0.5
CIRCLING = 1.5
"""radii from its circle's centre at which a plane has come to it"""


async def carry_out(run: Run, crew: Crew, step: Orders) -> None:
    """Each order once those before it are done; raises what the first that fails does, and the others hold."""
    places = {name: run.place(name) for name in step.vehicles}
    await speak_for(run, {name: _columns(run, name, step.orders, place) for name, place in places.items()})
    done = [asyncio.Event() for _ in step.orders]

    async def one(number: int, order: VehicleOrder) -> None:
        for before in order.after:
            await done[before].wait()
        run.text(f"{order.verb} of {order.vehicle}")
        await give(crew.vehicle(order.vehicle), order.verb, order.args)
        done[number].set()

    try:
        await together(*(one(number, order) for number, order in enumerate(step.orders)))
    except (asyncio.CancelledError, ZmavError):
        moving = {order.vehicle for number, order in enumerate(step.orders) if not done[number].is_set()}
        await hold_all(run, [name for name in moving if _in_the_air(run, name)])
        raise


async def give(vehicle: zmav.Vehicle, verb: str, args: Mapping[str, Any]) -> None:
    """One order as it stands in a step; who is to take off is armed first."""
    try:
        order = msgspec.convert(dict(args), VERBS[verb].args)
    except (msgspec.ValidationError, KeyError) as e:
        raise BadInput(f"{verb}: {e}", field=verb, value=dict(args), expected="the order's arguments") from e
    if verb == "takeoff" and not vehicle.state.armed:
        await vehicle.arm()
    await vehicle.order(verb, order)


async def halt(run: Run, names: Iterable[str]) -> None:
    """Have those that move stop where they are; open to everybody, and no lease is needed for it."""
    await hold_all(run, [name for name in names if _in_the_air(run, name)])


async def hold_all(run: Run, names: list[str]) -> None:
    """Whoever does not answer is told of."""
    results = await asyncio.gather(*(run.agent.z.vehicle(name).hold() for name in names), return_exceptions=True)
    for name, result in zip(names, results, strict=True):
        if isinstance(result, ZmavError):
            run.say("hold", "warning", f"{name} was told to hold, and did not: {result}", goal=run.entry.id)


async def speak_for(run: Run, tubes: Mapping[str, list[Tube]]) -> None:
    """Wait until nobody else has spoken for that room, and do."""
    agent = run.agent
    while blocker := agent.tubes.blocker(agent.kin(run.entry.id), tubes, agent.settings.downwash):
        run.text(f"waits for room beside {blocker}")
        await asyncio.sleep(SOON)
    agent.tubes.hold(run.entry.id, tubes)


async def loiter(run: Run, crew: Crew, step: Loiter) -> None:
    """Planes over their points, one after another, and then to their circles; done when all circle."""
    await speak_for(run, {name: _circle(run, step, i) for i, name in enumerate(step.vehicles)})
    await together(*(_to_circle(crew.vehicle(name), step, i) for i, name in enumerate(step.vehicles)))


async def _to_circle(vehicle: zmav.Vehicle, step: Loiter, number: int) -> None:
    for x, y, z in step.via.get(vehicle.name, ()):
        await vehicle.goto(pos=ned((float(x), float(y), float(z))), tolerance=abs(float(step.radii[number])))
    centre = ned((float(step.centres[number][0]), float(step.centres[number][1]), float(step.centres[number][2])))
    await vehicle.goto(pos=centre, tolerance=CIRCLING * abs(float(step.radii[number])))


def _circle(run: Run, step: Loiter, number: int) -> list[Tube]:
    """The way over its points, and a square around its circle."""
    name, r = step.vehicles[number], abs(float(step.radii[number]))
    seen = run.agent.fleet.seen(name)
    assert seen is not None
    radius = seen.view.body.radius
    x, y, z = (float(v) for v in step.centres[number])
    way = [enu(seen.view.pos_ned), *(tuple(map(float, p)) for p in step.via.get(name, ())), (x, y, z)]
    around = [(x - CIRCLING * r, y - CIRCLING * r, z), (x + CIRCLING * r, y + CIRCLING * r, z)]
    return [tube(_array(way), radius + r), Tube(_array([[*around[0], *around[1]]]), radius)]


def _columns(run: Run, name: str, orders: tuple[VehicleOrder, ...], place: Vector) -> list[Tube]:
    """Where these orders lead it: straight up and down, and straight to places."""
    seen = run.agent.fleet.seen(name)
    assert seen is not None
    home = enu(seen.view.home_ned or seen.view.pos_ned)
    way = [place]
    for order in (order for order in orders if order.vehicle == name):
        x, y, _ = way[-1]
        if order.verb == "takeoff":
            way.append((x, y, home[2] + float(order.args.get("alt_rel", 0.0))))
        elif order.verb in ("land", "rtl"):
            way.append((x, y, min(home[2], way[-1][2])))
        elif order.verb == "goto" and order.args.get("pos") is not None:
            n, e, d = order.args["pos"]
            way.append(enu((float(n), float(e), float(d))))
    return [tube(_array(way), seen.view.body.radius)]


def _in_the_air(run: Run, name: str) -> bool:
    seen = run.agent.fleet.seen(name)
    return seen is not None and (seen.view.airborne or (not seen.view.flies and bool(seen.state.armed)))


def _array(rows: Any) -> Floats:
    return np.array(rows, dtype=np.float64)
