"""Who answers in the vehicles' place."""

from __future__ import annotations

from ground.gcs.answerer import Answerer, Ground
from ground.gcs.desk import Desks
from ground.gcs.missions import Missions
from ground.gcs.params import Params


def make_answerers(ground: Ground) -> list[Answerer]:
    """One of each kind, ready to be asked. On the event loop."""
    desks = Desks(ground)
    return [Params(ground, desks), Missions(ground, desks)]
