"""Who answers in the vehicles' place."""

from __future__ import annotations

from ground.gcs.answerer import Answerer, Ground
from ground.gcs.desk import Desks
from ground.gcs.files import Files
from ground.gcs.missions import Missions
from ground.gcs.params import Params


def make_answerers(ground: Ground) -> list[Answerer]:
    """One of each kind, ready to be asked. On the event loop."""
    desks = Desks(ground)
    params = Params(ground, desks)
    return [params, Missions(ground, desks), Files(ground, desks, params)]
