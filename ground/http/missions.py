"""Files of missions, fences and rally points (.plan, .waypoints): read, and uploaded to several vehicles at once.

What is on a vehicle is asked for by its key: ``GET /keys/quad1/mission/mission``.
"""

from __future__ import annotations

import asyncio
from typing import Any, get_args

import msgspec
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from ground.http.documents import answer
from ground.http.gateway import Gateway
from ground.http.orders import matching
from zmav.errors import BadInput, ZmavError
from zmav.formats import plan, waypoints
from zmav.mavlink import Dialect
from zmav.swarm import VehicleProgress
from zmav.vehicle import Vehicle
from zmav.vehicle.missions import KINDS
from zmav.wire import MissionItem, MissionKind

Plans = dict[MissionKind, list[MissionItem]]


def routes(gateway: Gateway) -> list[BaseRoute]:
    async def read(request: Request) -> Response:
        """What a file holds, by kind: the body is a .plan (QGroundControl) or a .waypoints (Mission Planner)."""
        return answer({kind: msgspec.to_builtins(items) for kind, items in (await _plans(request, gateway)).items()})

    async def upload(request: Request) -> Response:
        """Upload a file to vehicles: quad1,quad* or all; each has the whole of it, or keeps what it had and says why.

        Kinds that the file does not hold are left alone. Answers when all have ended, with how it stands with each.
        """
        plans = await _plans(request, gateway)
        patterns = [each for each in request.query_params.get("vehicles", "").split(",") if each]
        if not patterns:
            text = "to whom? vehicles=quad1,quad2, or patterns"
            raise BadInput(text, field="vehicles", value="", expected="names or patterns with commas between them")
        vehicles, absent = matching(gateway.client, patterns)
        told = await asyncio.gather(*(_upload(vehicle, plans) for vehicle in vehicles))
        notes = [f"{each}: not told, nobody of that name is present" for each in absent]
        return answer({"status": "done", "notes": notes, "vehicles": [msgspec.to_builtins(each) for each in told]})

    return [
        Route("/mission/read", read, methods=["POST"]),
        Route("/mission/upload", upload, methods=["POST"]),
    ]


async def _plans(request: Request, gateway: Gateway) -> Plans:
    """The body by kind, without kinds that are empty or not asked for; raises :class:`BadInput`."""
    kind = request.query_params.get("kind")
    if kind is not None and kind not in KINDS:
        raise BadInput.wrong("kind", kind, ", ".join(get_args(MissionKind)))
    plans = plans_in(await request.body(), gateway.dialect)
    found = {each: items for each, items in plans.items() if kind in (None, each)}
    if not found:
        raise BadInput(f"the file holds no {kind or 'items'}", field="kind", value=kind, expected="a plan with items")
    return found


def plans_in(body: bytes, dialect: Dialect) -> Plans:
    """A file's text, whichever of the two it is: a .plan is a JSON object."""
    form = plan if body.lstrip().startswith(b"{") else waypoints
    whole = form.read(body, dialect.enums, "the file")
    return {kind: items for kind in KINDS if (items := getattr(whole, kind))}


async def _upload(vehicle: Vehicle, plans: Plans) -> VehicleProgress:
    done: dict[str, Any] = {}
    told = VehicleProgress(vehicle=vehicle.name, fleet=vehicle.fleet, status="done", result=done)
    for kind, items in plans.items():
        try:
            done[kind] = (await vehicle.missions.upload(items, kind))[kind]
        except ZmavError as e:
            told.status, told.error = "failed", e.code
            told.text = f"{kind}: {e.message}" + (f"; done: {', '.join(done)}" if done else "")
            return told
    told.text = ", ".join(f"{len(items)} items of {kind}" for kind, items in plans.items())
    return told
