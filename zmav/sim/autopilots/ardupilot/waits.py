"""What a mission waits for: its conditions, and delays until a time of day.

https://ardupilot.org/copter/docs/mission-command-list.html
"""

from __future__ import annotations

from zmav.sim.autopilots.items import Item

CONDITION_DELAY, CONDITION_DISTANCE = 112, 114  # MAV_CMD
# Commands that the mission library carries out by itself: they are done at once, and no item is reported reached.
UNREPORTED = frozenset((181, 182, 183, 184, 202, 203, 206, 218, 600, 1000, 2000, 2001))


class Conditions:
    """CONDITION_DELAY and CONDITION_DISTANCE: seconds to pass, metres to be near."""

    def __init__(self) -> None:
        self._until = self._near = 0.0

    def begin(self, item: Item, now: float) -> bool:
        """False: it is none of these."""
        if item.command == CONDITION_DELAY:
            self._until = now + max(item.p1, 0.0)
        elif item.command == CONDITION_DISTANCE:
            self._near = max(item.p1, 0.0)
        else:
            return False
        return True

    def met(self, item: Item, now: float, distance: float) -> bool:
        """``distance``: to the place that it goes to, m. Any other command waits for nothing."""
        if item.command == CONDITION_DELAY:
            return now > self._until
        return item.command != CONDITION_DISTANCE or distance < self._near


def delay(item: Item, unix_s: float) -> float:
    """Seconds that a NAV_DELAY lasts: ``p1``, or until it is so late (UTC: hours, minutes and seconds in ``p2`` to
    ``p4``). Of a time of day a negative part means any; without one nothing is waited for.
    """
    if item.p1 > 0:
        return item.p1
    hours, minutes, seconds = item.p2, item.p3, item.p4
    if hours >= 0:
        due, every = hours * 3600.0 + max(minutes, 0.0) * 60.0 + max(seconds, 0.0), 86400.0
    elif minutes >= 0:
        due, every = minutes * 60.0 + max(seconds, 0.0), 3600.0
    elif seconds >= 0:
        due, every = seconds, 60.0
    else:
        return 0.0
    return (due - unix_s % 86400.0) % every
