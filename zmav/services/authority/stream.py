"""What the vehicle flies, and for whom; and how often of such a stream a setpoint is given that is a command.

The autopilot answers each command, and ArduPlane begins its climb again with every DO_REPOSITION: repeated at 20 Hz it
never leaves its height (measured); at 1 Hz it climbs as after one alone.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

from zmav.autopilots import Action, Autopilot, Level, Message, Target
from zmav.services.authority.homeward import StoredReturn
from zmav.services.authority.trajectory import Segment

SEGMENT_AHEAD = 0.07
"""s by which a point of a segment is given early: half the time between two, and what link and autopilot take"""


class ActiveStream(NamedTuple):
    """What the vehicle flies, and for whom."""

    autopilot: Autopilot
    source: tuple[int, int]
    lease: int
    """its lease's number"""
    what: Target | Segment
    mode: str
    """the mode that follows it"""
    until: float
    """monotonic seconds at which it is stale unless renewed"""
    goes_on: bool = True
    """an action follows its hold; not where its end was meant"""
    home: StoredReturn | None = None
    """what the vehicle flies then in the place of that action"""

    @property
    def level(self) -> Level:
        return "trajectory" if isinstance(self.what, Segment) else self.what.level


def future(flown: ActiveStream) -> Callable[[float], Target]:
    """What is to be flown so many seconds from now. Of a segment, by the clock it was accepted by: UTC may be set."""
    what, now = flown.what, time.monotonic()
    if isinstance(what, Segment):
        return lambda ahead: what.at(what.end - (flown.until - now) + SEGMENT_AHEAD + ahead)
    return lambda ahead: what


REPEAT_AFTER = 1.0
"""s until the same is said again: it may have been lost"""
RESTARTING = ("MAV_CMD_DO_REPOSITION",)
"""commands that begin something again: not even a changed one is given sooner"""


class CommandRepeats:
    """Tells which of a stream's actions are due. For one vehicle; its caller has the lock."""

    def __init__(self) -> None:
        self._given: dict[tuple[str, float], tuple[float, tuple[float, ...]]] = {}
        """when and with what each command was given, by its name and first parameter (a servo's number)"""

    def due(self, action: Action, now: float) -> bool:
        """Whether to give it at ``now`` (monotonic seconds); messages always are."""
        if isinstance(action, Message):
            return True
        what = (action.name, action.params[0])
        at, params = self._given.get(what, (-REPEAT_AFTER, ()))
        same = action.params == params or action.name in RESTARTING
        if same and now - at < REPEAT_AFTER:
            return False
        self._given[what] = (now, action.params)
        return True

    def reset(self) -> None:
        """Another stream begins, or the mode changed: all of it is due."""
        self._given.clear()
