"""Who of the fleet is heard, and what may be done with half of it. No clock and no network in here.

The rule. A planner moves the vehicles of a goal only while it hears all of them, or some of them and more than half of
the fleet's airborne vehicles. So of two planners that cannot hear each other's vehicles, one at most goes on with any
goal. Who is not heard keeps the way that it was last committed to, and the column where it was last heard, for its
failsafe may land it. The smaller side moves nothing: its vehicles end what they are committed to, at rest, and stay.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Hearing:
    """``airborne``: all that fly, as far as known, heard now or not; ``heard``: those whose state is fresh."""

    airborne: frozenset[str]
    heard: frozenset[str]

    @property
    def majority(self) -> bool:
        """More than half of those in the air are heard; with nobody in the air there is nothing to be torn apart."""
        return not self.airborne or 2 * len(self.airborne & self.heard) > len(self.airborne)

    def may_move(self, vehicles: Iterable[str]) -> bool:
        """A goal of these vehicles may begin, or go on with another segment."""
        ours = set(vehicles)
        return ours <= self.heard or (self.majority and bool(ours & self.heard))

    @property
    def unheard(self) -> frozenset[str]:
        """Those in the air that are not heard: keep clear of where they may be."""
        return self.airborne - self.heard

    def words(self) -> str:
        """Why nothing is begun."""
        missing = ", ".join(sorted(self.unheard))
        part = f"{len(self.airborne & self.heard)} of {len(self.airborne)} vehicles in the air"
        return (
            f"only {part} are heard (not {missing}): this may be the smaller side of a torn network, so nothing moves"
        )
