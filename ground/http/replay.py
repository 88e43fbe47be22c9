"""``/replay``: the timeline of a recording that ``zmav http --replay`` plays. No vehicle hears any of it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from ground.http.arguments import arguments_of
from ground.http.documents import answer
from ground.http.gateway import Gateway
from ground.http.reply import Failure
from zmav import wire
from zmav.errors import BadInput

if TYPE_CHECKING:
    from ground.record.steering import SteeredPlayer

SPEEDS = (0.1, 100.0)


class Steer(wire.Wire, kw_only=True):
    """What is to change; what is left out stays as it is."""

    paused: bool | None = None
    speed: float | None = None
    """times real time"""
    to: float | None = None
    """s after the recording's beginning"""


def routes(gateway: Gateway) -> list[BaseRoute]:
    def player() -> SteeredPlayer:
        if gateway.player is None:
            raise Failure(404, "not_found", "nothing is played here: zmav http --replay FILE")
        return gateway.player

    async def look(request: Request) -> Response:
        """Where the recording is that is played: begin, end and at (UTC seconds), speed, paused."""
        return answer(_told(player()))

    async def steer(request: Request) -> Response:
        """Pause it or go on, play it faster, or from elsewhere."""
        played = player()
        values = await arguments_of(request, Steer)
        wanted = wire.build(values, Steer, "replay")
        if wanted.speed is not None and not SPEEDS[0] <= wanted.speed <= SPEEDS[1]:
            raise BadInput.wrong("speed", wanted.speed, f"{SPEEDS[0]:g} to {SPEEDS[1]:g} times real time")
        if wanted.to is not None and not math.isfinite(wanted.to):
            raise BadInput.wrong("to", wanted.to, "seconds after the beginning")
        played.steer(wanted.paused, wanted.speed, wanted.to)
        return answer(_told(played))

    return [Route("/replay", look, methods=["GET"]), Route("/replay", steer, methods=["POST"])]


def _told(player: SteeredPlayer) -> dict[str, float | bool | str]:
    return {**player.playing._asdict(), "error": str(player.error or "")}
