"""``POST /swarm/{verb}``: the verbs of ``zmav swarm``, asked of the planner in charge."""

from __future__ import annotations

import asyncio
import time
import uuid
from typing import Any

import msgspec
import zenoh
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from ground.http.arguments import arguments_of
from ground.http.documents import answer
from ground.http.gateway import Gateway
from zmav import keys, wire
from zmav.client import Client
from zmav.errors import BadKey, NoSuchVehicle, TimedOut, ZmavError
from zmav.verbs import SWARM_VERBS
from zmav.waiting import within
from zmav.wire import swarm

LOOK = 1.5
"""s for a planner to be heard of, which says several times a second that it is in charge"""
ANSWER = 3.0
"""s for one answer of it"""
PATIENCE = 30.0
"""s for the end of what it was asked: a preview is planned as it would be flown"""


def routes(gateway: Gateway) -> list[BaseRoute]:
    async def ask(request: Request) -> Response:
        """Ask the planner in charge; the body holds the verb's arguments, as {"goal": {"kind": "goto", ...}}."""
        verb = request.path_params["verb"]
        if verb not in SWARM_VERBS:
            known = ", ".join(SWARM_VERBS)
            raise BadKey(f"no order {verb!r} to a planner; there are {known}", field="verb", value=verb, expected=known)
        kind = SWARM_VERBS[verb].args
        values = await arguments_of(request, kind)
        values["id"] = values.get("id") or uuid.uuid4().hex
        args = wire.decode(msgspec.json.encode(values), kind, f"swarm/{verb}")
        return answer({"verb": verb, "result": await _asked(gateway.client, verb, args)})

    return [Route("/swarm/{verb}", ask, methods=["POST"])]


async def _asked(z: Client, verb: str, args: wire.Order) -> dict[str, Any]:
    """Ask until it says how it ended; raises its typed error, or :class:`TimedOut` where it falls silent."""
    fleet, planner = await _in_charge(z)
    key, payload, until = keys.SWARM.key(fleet, planner, verb=verb), wire.encode(args), time.monotonic() + PATIENCE
    silent = 0
    while time.monotonic() < until and silent < 2:
        answers = await z.ask(key, payload, ANSWER, keys.SWARM)
        silent = 0 if answers else silent + 1
        for each in answers[:1]:
            if isinstance(each, ZmavError):
                raise each
            outcome = wire.decode(each.payload, wire.Outcome, f"reply to {key}")
            if outcome.status == "done":
                return outcome.result
    raise TimedOut(f"planner {planner} does not say how {verb} ended", planner=planner)


async def _in_charge(z: Client) -> tuple[str, str]:
    """The fleet and the name of the planner in charge, by its own word; raises :class:`NoSuchVehicle`."""

    def convert(sample: zenoh.Sample) -> tuple[str, str]:
        key = str(sample.key_expr)
        charge = wire.decode(sample.payload.to_bytes(), swarm.Charge, key)
        return key.split("/")[1], keys.check_name(charge.planner, "planner")

    async with z.subscribe(keys.FLEET.key(z.fleet_name, topic="charge"), convert) as told:
        try:
            return await within(LOOK, told.get())
        except asyncio.TimeoutError:
            text = f"no planner is in charge of fleet {z.fleet_name}: start one with 'zmav swarm planner'"
            raise NoSuchVehicle(text, fleet=z.fleet_name) from None
