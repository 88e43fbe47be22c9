"""How much wider than they are vehicles are planned, by how well they hold their ways and how well clocks are known."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from agents.planner.execute.executor import MAX_CLOCK, clock_error
from agents.planner.execute.flight import SLACK, margin_for
from agents.planner.execute.offset import Offset
from agents.planner.live.context import Context
from agents.planner.live.plan import Margins
from zmav.errors import Refused

WIDEST = 1.2
"""m that a vehicle may be off its way at most, however badly it is seen to hold it"""
CLOCKS = 0.02
"""s by which clocks may differ from what is measured, of the margin that is reckoned with"""
ROOM, MOST_MARGIN = 0.5, 1.5
"""m that plans keep beyond what must be kept, where there is room: then nobody waits until another has passed for
sure; and that a margin may be at most"""
SPARE, TIGHT = 0.02, 3.0
"""m more than the clocks need now; how much nearer to their ways, and slower, vehicles fly where it is tight"""
FASTER = 1.02
"""times a vehicle's own speed that its plan's may be"""


@dataclass(frozen=True)
class PlanMargins:
    """Of the plans for ``vehicles``, as things are known now. ``offsets``: the clocks that they are flown by."""

    context: Context
    vehicles: Collection[str]
    offsets: Mapping[str, Offset]

    @property
    def tracking(self) -> float:
        """How far a vehicle may be off its way for the margin that is planned with, m: as the settings say, or as the
        one does that holds its way worst, as far as the clocks leave room for it in the greatest margin.
        """
        settings, now = self.context.settings, self.context.clocks.clock.now()
        least = min(settings.tracking, max(0.05, settings.margin - SLACK - 5.0 * CLOCKS))
        clocks = (speed * min(self.offsets[name].error(now), MAX_CLOCK) for name, speed in self._speeds().items())
        widest = min(WIDEST, MOST_MARGIN - SPARE - SLACK - max(clocks, default=0.0))
        known = self.context.fleet.followings_of(self.vehicles).values()
        return max(least, min(widest, max((each.within for each in known), default=0.0)))

    @property
    def too_wide(self) -> bool:
        """Even if all clocks were known exactly."""
        return self.tracking + SLACK + SPARE > MOST_MARGIN

    def needed(self, tracking: float, share: float = 1.0) -> float:
        """m that the executor asks for, at a share of each vehicle's speed. Raises :class:`Refused` where a clock is
        not known well enough for any plan.
        """
        now = self.context.clocks.clock.now()
        return max(
            (
                margin_for(share * speed, clock_error(name, self.offsets[name], now), tracking)
                for name, speed in self._speeds().items()
            ),
            default=0.0,
        )

    def best_first(self) -> Margins:
        """m by which radii are to be widened, and the share of their speed that vehicles may have with that. Raises
        :class:`Refused` where no margin is enough.
        """
        tracking = self.tracking
        needed = self.needed(tracking) + SPARE
        if needed > MOST_MARGIN:
            raise Refused(f"a margin of {needed:.2f} m would be needed for these clocks; {MOST_MARGIN:g} is most")
        least = max(needed, self.context.settings.margin)
        tight = self.needed(tracking, 1.0 / TIGHT) + SPARE - tracking * (1.0 - 1.0 / TIGHT)
        return (max(least, min(least + ROOM, MOST_MARGIN)), 1.0), (least, 1.0), (tight, 1.0 / TIGHT)

    def _speeds(self) -> dict[str, float]:
        """m/s that plans have them fly at most, of those that were heard."""
        seen = {name: self.context.fleet.seen(name) for name in self.offsets}
        return {name: FASTER * each.view.body.speed for name, each in seen.items() if each is not None}
