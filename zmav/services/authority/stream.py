"""What the vehicle flies, and for whom; and how often of such a stream a setpoint is given that is a command.

The autopilot answers each command, and ArduPlane begins its climb again with every DO_REPOSITION: repeated at 20 Hz it
never leaves its height (measured); at 1 Hz it climbs as after one alone.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

from zmav import geo
from zmav.autopilots import Action, Autopilot, Level, Message, Target
from zmav.errors import Refused, ZmavError
from zmav.services.authority.homeward import StoredReturn
from zmav.services.authority.joining import Place, place_of, why_not_joined
from zmav.services.authority.trajectory import Segment
from zmav.services.link.port import Port
from zmav.services.link.reported import fields_of, in_the_air, shown

SEGMENT_HZ = 10.0
STILL = 0.5
"""m/s below which a vehicle holds"""
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
    lingers: float = 0.0
    """s for which it is given after that: a segment's last place"""

    @property
    def level(self) -> Level:
        return "trajectory" if isinstance(self.what, Segment) else self.what.level

    @property
    def holds_at(self) -> float:
        """Monotonic seconds at which the vehicle is told to hold unless it is renewed."""
        return self.until + self.lingers

    def utc(self, now: float) -> float:
        """The time of its segment at ``now`` (monotonic seconds), by the clock it was accepted by: UTC may be set."""
        assert isinstance(self.what, Segment)
        return self.what.end - (self.until - now)

    @property
    def place(self) -> Place | None:
        """Where its segment has the vehicle now; None: it is none."""
        if not isinstance(self.what, Segment):
            return None
        return geo.to_global(self.what.origin, self.what.local(self.utc(time.monotonic()))[0])

    def why_not_joined(self, port: Port, follows: ActiveStream | None = None) -> str:
        """Why the vehicle may not begin to follow it from where it is, or where the segment that it ``follows`` has it;
        empty: it may.
        """
        if not isinstance(self.what, Segment):
            return ""
        place = follows.place if follows is not None else None
        utc = self.utc(time.monotonic())
        return why_not_joined(self.what, utc, place or place_of(port, self.source), flat=self.autopilot.on_surface)

    def check_joined(self, port: Port, follows: ActiveStream | None) -> None:
        """Raise :class:`~zmav.errors.Refused` where :meth:`why_not_joined` says why."""
        if why := self.why_not_joined(port, follows):
            raise Refused(f"{why}: it would fly there straight, and not along it", count="away")

    def left(self) -> ActiveStream:
        """What is held away from the segment: its place may be taken, and its way home begins elsewhere."""
        return self._replace(what=Target(vel=(0.0, 0.0, 0.0)), home=None)

    def engages_after(self, port: Port) -> float:
        """s of it that the autopilot hears before its mode is asked for."""
        return self.autopilot.engages_after(self.level, in_the_air(port, self.source) is True)

    def releases(self, after: ActiveStream | None) -> Sequence[Message]:
        """What gives back what an override took, where what comes ``after`` does not override it as well."""
        if isinstance(self.what, Segment):
            return ()
        if after is not None and not isinstance(after.what, Segment) and after.what.level == self.what.level:
            return ()
        return self.autopilot.release(self.what)

    def period(self, *, dodges: bool) -> float:
        """s between two times that the autopilot is given it, or what moves the vehicle aside from it."""
        hz = self.autopilot.keepalive_hz
        return 1.0 / (max(hz, SEGMENT_HZ) if dodges or isinstance(self.what, Segment) else hz)

    def holds(self, port: Port) -> bool:
        """The vehicle stands still, in the mode in which its autopilot holds."""
        try:
            in_mode = shown(port, self.autopilot, self.source).mode == self.autopilot.hold()[0]
        except ZmavError:
            return True
        p = fields_of(port, "GLOBAL_POSITION_INT", self.source)
        return in_mode and (p is None or math.hypot(p["vx"], p["vy"], p["vz"]) / 100.0 < STILL)


def future(flown: ActiveStream) -> Callable[[float], Target]:
    """What is to be flown so many seconds from now."""
    what, now = flown.what, time.monotonic()
    if isinstance(what, Segment):
        return lambda ahead: what.at(flown.utc(now) + SEGMENT_AHEAD + ahead)
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
