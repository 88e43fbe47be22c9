"""Orders: ``POST /do/{vehicle}/{verb}``, the same by ``GET`` for who can do no more; to several vehicles by ``POST
/fleet/{verb}``, under the rule of :mod:`zmav.swarm`; to the agents that run for a vehicle by ``POST
/agent/{vehicle}/{agent}/{verb}``. ``POST /swarm/{verb}`` asks the planner in charge, as ``zmav swarm`` does.

The answer is the vehicle's outcome. Without an ``id`` it comes when the order has ended, which the vehicle sees to by
itself even where nobody waits any longer; with one it says after ``wait`` seconds that it is still ``running``, and the
same request asks again.
"""

from __future__ import annotations

import asyncio
import fnmatch
import time
import uuid
from collections.abc import Collection, Coroutine
from typing import Any, get_args

import msgspec
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from ground.http.arguments import arguments_of
from ground.http.documents import answer
from ground.http.gateway import Gateway
from zmav import keys, wire
from zmav.client import Client
from zmav.errors import BadInput, BadKey, NoSuchVehicle, TimedOut, ZmavError
from zmav.services.orders.orders import Operations, Report
from zmav.swarm import FleetOrder, order_chief
from zmav.vehicle import Vehicle
from zmav.verbs import SWARM_VERBS, VERBS

PATIENCE = 10.0
"""s for one answer to an order with an id"""
GOALS = {str(kind.__struct_config__.tag): kind for kind in get_args(wire.swarm.Goal)}
"""kinds of goals: each is a verb of the planner's, too"""


class FleetOrders:
    """``POST /fleet/{verb}``: the orders to several vehicles that were given. On the event loop."""

    def __init__(self, gateway: Gateway) -> None:
        self._gateway = gateway
        self._operations = Operations()
        gateway.at_end(self._end)

    def _end(self) -> None:
        """The vehicles see through what they were told."""
        for operation in self._operations.under_way:
            operation.task.cancel()

    async def give(self, request: Request) -> Response:
        """Give several vehicles an order; vehicles: names or patterns, quad* or demo/quad1, * all. Answers as orders
        do, with how it stands with each vehicle.

        Several that return are brought home by the planner, where there is one; who is disarmed is left out. With an
        id the order is given once, however often it comes.
        """
        verb = _known(request.path_params["verb"])
        values = await arguments_of(request, VERBS[verb].args)
        payload = msgspec.json.encode(values, order="sorted")
        patterns = values.pop("vehicles", [])
        args = wire.build(values, VERBS[verb].args, f"fleet/{verb}")

        def begin(report: Report) -> Coroutine[Any, Any, dict[str, Any]]:
            vehicles, absent = matching(self._gateway.client, patterns)
            order = FleetOrder(self._gateway.client, vehicles, verb, args)
            order.notes.extend(f"{each}: not told, nobody of that name is present" for each in absent)
            report({"order": order})
            return _seen_through(order)

        operation = self._operations.once(verb, args.id, payload, None, begin)
        await asyncio.wait({operation.task}, timeout=min(args.wait, PATIENCE) if args.id else None)
        if operation.task.done():
            operation.task.result()
        order: FleetOrder = operation.progress["order"]
        status, took = ("done" if operation.task.done() else "running"), operation.took
        told = [msgspec.to_builtins(told) for told in order.told.values()]
        return answer({"verb": verb, "status": status, "took": took, "notes": order.notes, "vehicles": told})


def matching(client: Client, patterns: Any) -> tuple[list[Vehicle], list[str]]:
    """The vehicles that names and patterns mean, and what fits nobody; raises :class:`BadInput`, and
    :class:`NoSuchVehicle` where all fit nobody.
    """
    patterns = [patterns] if isinstance(patterns, str) else patterns
    if not patterns or not isinstance(patterns, list) or not all(isinstance(each, str) for each in patterns):
        text = "vehicles are a list of names or patterns, and * means all of them"
        raise BadInput(text, field="vehicles", value=str(patterns)[:80], expected='["quad*"]')
    known, patterns = client.fleet(), patterns[:1000]
    found = [v for v in known for each in patterns if _fits(v, each)]
    if not found:
        present = ", ".join(v.name for v in known) or "nobody"
        raise NoSuchVehicle(f"no vehicle matches {', '.join(patterns)[:80]}; present: {present}")
    absent = [each[:80] for each in patterns if not any(_fits(v, each) for v in found)]
    return list({(v.fleet, v.name): v for v in found}.values()), absent


async def _seen_through(order: FleetOrder) -> dict[str, Any]:
    await order.run()
    return {}


def _fits(vehicle: Vehicle, pattern: str) -> bool:
    name = f"{vehicle.fleet}/{vehicle.name}" if "/" in pattern else vehicle.name
    return fnmatch.fnmatchcase(name, pattern)


def routes(gateway: Gateway) -> list[BaseRoute]:
    fleet_orders = FleetOrders(gateway)

    async def do(request: Request) -> Response:
        """Give a vehicle an order; arguments by name, as JSON, as a form or in the address."""
        vehicle = gateway.client.vehicle(request.path_params["vehicle"])
        return answer(await give(gateway, vehicle, request.path_params["verb"], request))

    async def agent(request: Request) -> Response:
        """Give an order to an agent that runs for a vehicle: set (name, value), params, and each agent's own."""
        parts = request.path_params
        vehicle = gateway.client.vehicle(parts["vehicle"])
        return answer(await tell(gateway, vehicle, parts["agent"], parts["verb"], request))

    async def planner(request: Request) -> Response:
        """Ask the planner in charge; the body holds the verb's arguments, as {"goal": {"kind": "goto", ...}}.

        A kind of goal is a verb, too: its fields are given to the planner, or with preview=true shown.
        """
        said = verb = request.path_params["verb"]
        if verb in GOALS:
            values = await arguments_of(request, GOALS[verb])
            verb = "preview" if values.pop("preview", False) is True else "submit"
            values = {**{name: values.pop(name) for name in ("id", "when") if name in values}, "goal": values}
            values["goal"]["kind"] = said
        else:
            values = await arguments_of(request, SWARM_VERBS[_known(verb, (*SWARM_VERBS, *GOALS))].args)
        kind = SWARM_VERBS[verb].args
        values["id"] = values.get("id") or uuid.uuid4().hex
        args = wire.build(values, kind, f"swarm/{verb}")
        return answer({"verb": verb, "result": await order_chief(gateway.client, verb, args)})

    async def told(request: Request) -> Response:
        """The last orders given through this gateway, the newest last: who, from where, what, to whom, outcome."""
        return answer([msgspec.to_builtins(line) for line in gateway.audit.lines])

    return [
        Route("/orders", told, methods=["GET"]),
        Route("/do/{vehicle}/{verb}", do, methods=["GET", "POST"]),
        Route("/fleet/{verb}", fleet_orders.give, methods=["POST"]),
        Route("/swarm/{verb}", planner, methods=["POST"]),
        Route("/agent/{vehicle}/{agent}/{verb}", agent, methods=["POST"]),
    ]


async def give(gateway: Gateway, vehicle: Vehicle, verb: str, request: Request) -> wire.Outcome:
    """See an order through, or ask once how one with an ``id`` goes; raises what the vehicle says, and
    :class:`~zmav.errors.BadInput` for arguments that do not fit, before anything is sent.
    """
    kind = VERBS[_known(verb)].args
    args = wire.build(await arguments_of(request, kind), kind, f"do/{verb}")
    if args.id:
        return await _once(gateway, vehicle, keys.DO.key(vehicle.fleet, vehicle.name, verb=verb), wire.encode(args))
    start = time.monotonic()
    result = await vehicle.order(verb, args)
    return wire.Outcome(verb=verb, status="done", took=time.monotonic() - start, result=result)


def _known(verb: str, verbs: Collection[str] = VERBS) -> str:
    if verb not in verbs:
        known = ", ".join(verbs)
        raise BadKey(f"no order {verb!r}; there are {known}", field="verb", value=verb, expected=known)
    return verb


async def tell(gateway: Gateway, vehicle: Vehicle, name: str, verb: str, request: Request) -> wire.Outcome:
    """See an order to the agent ``name`` through, or ask once how one with an ``id`` goes. Which orders there are, and
    what they take, only that agent knows: raises what it says, :class:`~zmav.errors.BadKey` for names that cannot be
    and :class:`~zmav.errors.TimedOut` where none of that name answers.
    """
    keys.check_name(name, "agent")
    keys.check_name(verb, "verb")
    values = await arguments_of(request, wire.Order)
    if values.get("id"):
        key = keys.AGENT_DO.key(vehicle.fleet, vehicle.name, agent=name, verb=verb)
        return await _once(gateway, vehicle, key, msgspec.json.encode(values))
    start = time.monotonic()
    result = await vehicle.tell(name, verb, **values)
    return wire.Outcome(verb=verb, status="done", took=time.monotonic() - start, result=result)


async def _once(gateway: Gateway, vehicle: Vehicle, key: str, payload: bytes) -> wire.Outcome:
    answers = await gateway.client.ask(key, payload, PATIENCE)
    for each in answers:
        if isinstance(each, ZmavError):
            raise each
        return wire.decode(each.payload, wire.Outcome, f"reply to {key}")
    if vehicle.present:
        raise TimedOut(f"{vehicle.name} does not answer on {key}", vehicle=vehicle.name)
    raise NoSuchVehicle(f"no vehicle {vehicle.name} is present in fleet {vehicle.fleet}", vehicle=vehicle.name)
