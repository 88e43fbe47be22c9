"""Who of the fleet is heard, and what may be done with half of it. No clock and no network in here.

The rule. A planner begins to move vehicles only while it hears more than half of the airborne vehicles of its fleet,
or every vehicle of the goal. So of two planners that cannot hear each other, one at most begins anything with vehicles
that the other may believe to be its own. Who is not heard is taken to be where its last commitment ends, or anywhere
on the way there, with a column below it, for its failsafe may land it. The smaller side begins nothing: its vehicles
fly what they are committed to, which ends at rest, and stay.
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
        return self.majority or set(vehicles) <= self.heard

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
