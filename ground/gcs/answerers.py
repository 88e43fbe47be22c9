"""Who answers in the vehicles' place."""

from __future__ import annotations

from ground.gcs.answerer import Answerer, Ground
from ground.gcs.files import Files
from ground.gcs.missions import Missions
from ground.gcs.params import Params
from ground.gcs.request_handlers import HandlersByClient


def make_answerers(ground: Ground) -> list[Answerer]:
    """One of each kind, ready to be asked. On the event loop."""
    by_client = HandlersByClient(ground)
    params = Params(ground, by_client)
    return [params, Missions(ground, by_client), Files(ground, by_client, params)]
