"""How well a router hears its neighbours: probes, what they tell, and what it costs to send over a link."""

from __future__ import annotations

from mesh.quality.cost import cost
from mesh.quality.publisher import LinkQualities, link_qualities

__all__ = ["LinkQualities", "cost", "link_qualities"]
