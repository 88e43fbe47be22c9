"""How well a router hears its neighbours: probes, what they tell, and what it costs to send over a link."""

from __future__ import annotations

from mesh.quality.publisher import LinkQualities, cost, link_qualities

__all__ = ["LinkQualities", "cost", "link_qualities"]
