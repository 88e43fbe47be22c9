"""Orders: ``POST /do/{vehicle}/{verb}``, the same by ``GET`` for who can do no more, and the ``do`` keys by ``POST``.

The answer is the vehicle's outcome. Without an ``id`` it comes when the order has ended, which the vehicle sees to by
itself even where nobody waits any longer; with one it says after ``wait`` seconds that it is still ``running``, and the
same request asks again.
"""

from __future__ import annotations

import time

import msgspec
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from ground.http.arguments import arguments_of
from ground.http.documents import answer
from ground.http.gateway import Gateway
from zmav import keys, wire
from zmav.errors import BadKey, NoSuchVehicle, TimedOut, ZmavError
from zmav.vehicle import Vehicle
from zmav.verbs import VERBS

PATIENCE = 10.0
"""s for one answer to an order with an id"""


def routes(gateway: Gateway) -> list[BaseRoute]:
    async def do(request: Request) -> Response:
        """Give a vehicle an order; arguments by name, as JSON, as a form or in the address."""
        vehicle = gateway.client.vehicle(request.path_params["vehicle"])
        return answer(await give(gateway, vehicle, request.path_params["verb"], request))

    async def do_key(request: Request) -> Response:
        """Give an order by its key: /keys/quad1/do/hold, /keys/zmav/demo/quad1/do/hold."""
        vehicle, verb = _order_of(gateway, request.path_params["key"])
        return answer(await give(gateway, vehicle, verb, request))

    return [
        Route("/do/{vehicle}/{verb}", do, methods=["GET", "POST"]),
        Route("/keys/{key:path}", do_key, methods=["POST"]),
    ]


async def give(gateway: Gateway, vehicle: Vehicle, verb: str, request: Request) -> wire.Outcome:
    """See an order through, or ask once how one with an ``id`` goes; raises what the vehicle says, and
    :class:`~zmav.errors.BadInput` for arguments that do not fit, before anything is sent.
    """
    if verb not in VERBS:
        known = ", ".join(VERBS)
        raise BadKey(f"no order {verb!r}; there are {known}", field="verb", value=verb, expected=known)
    kind = VERBS[verb].args
    args = wire.decode(msgspec.json.encode(await arguments_of(request, kind)), kind, f"do/{verb}")
    if args.id:
        return await _once(gateway, vehicle, verb, args)
    start = time.monotonic()
    result = await vehicle.order(verb, args)
    return wire.Outcome(verb=verb, status="done", took=time.monotonic() - start, result=result)


async def _once(gateway: Gateway, vehicle: Vehicle, verb: str, args: wire.Order) -> wire.Outcome:
    key = keys.DO.key(vehicle.fleet, vehicle.name, verb=verb)
    answers = await gateway.client.ask(key, wire.encode(args), PATIENCE)
    for each in answers:
        if isinstance(each, ZmavError):
            raise each
        return wire.decode(each.payload, wire.Outcome, f"reply to do/{verb}")
    if vehicle.present:
        raise TimedOut(f"{vehicle.name} does not answer on {key}", vehicle=vehicle.name)
    raise NoSuchVehicle(f"no vehicle {vehicle.name} is present in fleet {vehicle.fleet}", vehicle=vehicle.name)


def _order_of(gateway: Gateway, text: str) -> tuple[Vehicle, str]:
    """Vehicle and verb of a ``do`` key, its root and its fleet given or not; raises :class:`BadKey` for any other."""
    chunks = text.split("/")
    if chunks[0] == keys.ROOT and len(chunks) == 5:
        del chunks[0]
    if chunks[-2:-1] != ["do"] or len(chunks) not in (3, 4):
        text = f"{text!r} is no order: POST is for VEHICLE/do/VERB, PUT for keys that are written"
        raise BadKey(text, field="key", value=text, expected="VEHICLE/do/VERB")
    client, verb = gateway.client, chunks[-1]
    if len(chunks) == 3:
        return client.vehicle(chunks[0]), verb
    fleet, name = keys.check_name(chunks[0], "fleet"), keys.check_name(chunks[1], "vehicle")
    if client.fleet_name not in ("*", fleet):
        text = f"this gateway is in the fleet {client.fleet_name}, and not in {fleet}"
        raise NoSuchVehicle(text, vehicle=name, fleet=fleet)
    return Vehicle(client, name, fleet), verb
