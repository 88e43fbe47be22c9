"""Links between routers and the ways over them, by what their ends say: what the doctor, the graph and the monitor
judge alike.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Literal

from zmav import wire

Grade = Literal["good", "fair", "poor", "down", "unknown"]
LINK_LOSS, LINK_POOR = 0.05, 0.20
"""shares of what is sent that a link loses, between an autopilot and its companion or between two routers: see
:func:`loss_level`
"""
FAIR_COST, POOR_COST = 3_000, 15_000
"""of :func:`mesh.quality.publisher.cost`: 30 ms and 150 ms a kilobyte one way"""
LOSS_STEP, RTT_STEP = 0.02, 1e-3
"""losses and round trips that differ by less are taken for alike when the weakest hop is looked for"""
_STATES = ("up", "silent", "down")


def loss_level(share: float) -> Literal["ok", "warn", "bad"]:
    """How bad it is that a link loses this share."""
    return "bad" if share >= LINK_POOR else "warn" if share >= LINK_LOSS else "ok"


@dataclass(frozen=True)
class Link:
    """Two routers that are linked, or were within the last minute; ``a`` comes before ``b`` in the alphabet."""

    a: str
    b: str
    by_a: wire.NeighbourQuality | None = None
    """what ``a`` says of it; None: ``a`` says nothing"""
    by_b: wire.NeighbourQuality | None = None

    def _said(self) -> list[wire.NeighbourQuality]:
        return [said for said in (self.by_a, self.by_b) if said is not None]

    def _of(self, end: str) -> tuple[wire.NeighbourQuality | None, wire.NeighbourQuality | None]:
        """What that end says, and what the other one does."""
        return (self.by_a, self.by_b) if end == self.a else (self.by_b, self.by_a)

    @property
    def state(self) -> str:
        """The worse of what both ends say: up, silent or down; unknown where none says anything."""
        return max((said.state for said in self._said()), key=_STATES.index, default="unknown")

    @property
    def rtt(self) -> float | None:
        """s, the mean of what both ends measured."""
        found = [said.rtt for said in self._said() if said.rtt is not None]
        return sum(found) / len(found) if found else None

    @property
    def cost(self) -> int | None:
        return max((said.cost for said in self._said() if said.cost is not None), default=None)

    @property
    def age(self) -> float | None:
        """s since either end was last heard by the other: the greater."""
        return max((said.age for said in self._said() if said.age is not None), default=None)

    def loss(self, source: str) -> float | None:
        """Share of best-effort messages lost from ``source`` to the other end; the receiver's own count goes first."""
        near, far = self._of(source)
        found = (far.loss_in if far else None), (near.loss_out if near else None)
        return next((loss for loss in found if loss is not None), None)

    def signal(self, end: str) -> float | None:
        """dBm of the other one as ``end`` hears it."""
        near, _ = self._of(end)
        return near.signal if near else None

    @property
    def worst_loss(self) -> float | None:
        return max((loss for end in (self.a, self.b) if (loss := self.loss(end)) is not None), default=None)

    @property
    def grade(self) -> Grade:
        """In a word, for a colour."""
        loss, cost = loss_level(self.worst_loss or 0.0), self.cost or 0
        if self.state in ("down", "silent"):
            return "down"
        if loss == "bad" or cost >= POOR_COST:
            return "poor"
        if loss == "warn" or cost >= FAIR_COST:
            return "fair"
        return "unknown" if self.cost is None else "good"

    def badness(self) -> tuple[float, ...]:
        """By which the weakest hop is found: first a link that is down, then loss, then round trip."""
        return (
            float(_STATES.index(self.state)) if self.state in _STATES else 0.0,
            round((self.worst_loss or 0.0) / LOSS_STEP),
            round((self.rtt or 0.0) / RTT_STEP),
        )


@dataclass(frozen=True)
class Way:
    """How messages from the start of the graph reach a host."""

    hops: tuple[str, ...]
    """names, both ends included; where it is not complete, as far as it is known"""
    links: tuple[Link, ...]
    """one for each hop"""
    complete: bool = True
    traced: bool = True
    """by the routers' own map; False: that was not to be had, and it is the way of fewest hops"""

    @property
    def weakest(self) -> Link | None:
        return max(self.links, key=Link.badness, default=None)

    @property
    def rtt(self) -> float | None:
        """s, of all hops together; None where one is not known."""
        found = [link.rtt for link in self.links if link.rtt is not None]
        return sum(found) if self.complete and len(found) == len(self.links) else None

    def delivery(self, *, back: bool = False) -> float | None:
        """Share of best-effort messages that arrive at the host, or from there; None where a hop is not known."""
        if not self.complete:
            return None
        product = 1.0
        for (here, there), link in zip(itertools.pairwise(self.hops), self.links, strict=True):
            loss = link.loss(there if back else here)
            if loss is None:
                return None
            product *= 1.0 - loss
        return product
