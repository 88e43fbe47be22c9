"""All that is known of one vehicle at one moment: what rules judge and reports are made from."""

from __future__ import annotations

import collections
from dataclasses import dataclass, field

from ground.top.report import AgentReport, Happening, Presence
from mesh.topology import Way
from zmav import keys, wire

LINK_STALE = keys.LINK.stale_after or 5.0
"""s after which what a vehicle said of its link is no longer shown"""


@dataclass(frozen=True)
class Facts:
    """Ages are seconds; those of what the vehicle said itself are by its own clock."""

    name: str
    presence: Presence = "ok"
    age: float | None = 0.0
    state: wire.VehicleState | None = None
    link: wire.LinkQuality | None = None
    """None: never heard, or not for a while"""
    rtt: float | None = None
    rtt_age: float | None = None
    """s since a query was answered; None: none ever was"""
    way: Way | None = None
    agents: tuple[AgentReport, ...] = ()
    events: tuple[Happening, ...] = ()
    """the newest first"""
    recent: collections.Counter[str] = field(default_factory=collections.Counter)
    """setpoints and orders dropped within the last seconds, by reason"""
    twins: tuple[str, ...] = ()
    """other vehicles present with its system id"""
    disbelieved: tuple[str, ...] = ()

    @property
    def now(self) -> float:
        """UTC by the vehicle's clock, so that a wrong one spoils no age."""
        return (self.state.t if self.state else 0.0) + (self.age or 0.0)
