"""Who answers in the vehicles' place."""

from __future__ import annotations

from ground.gcs.answerer import Answerer, Ground


def make_answerers(ground: Ground) -> list[Answerer]:
    """One of each kind, ready to be asked. On the event loop."""
    return []
