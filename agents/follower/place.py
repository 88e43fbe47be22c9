"""Where the vehicle is, by the last place that it said, as long as that tells it. No clock and no network in here."""

from __future__ import annotations

from agents.follower.guide import AHEAD
from zmav.errors import Stale
from zmav.flying import PATIENCE
from zmav.vehicle.vehicle import Place
from zmav.wire import Vector

HZ = 10.0
"""at which the vehicle is asked where it is: as often as its helipad agent asks"""
SILENT = 0.5
"""s without a new place after which nothing is flown by the last one: five were lost, and in a gust it may move half a
metre meanwhile
"""
LATE_GAIN = 0.1
"""weight of a new one in how late they come"""
IN_TIME = 0.05
"""s from the autopilot to us with which a place is not late: what is added against gusts was found with about that"""
TOO_OLD = 1.0
"""s of a place's age by the two clocks from which it is no place any more, however lately it came"""


class Here:
    """Times of places are UTC seconds; those of hearing them are of a clock that nobody sets (s). ``begun``: when
    listening began, by the latter.
    """

    def __init__(self, begun: float) -> None:
        self.last: Place | None = None
        self.late = 0.0
        """s by which its places come late, smoothed: by their age, which saws between two, commands would saw, too"""
        self._heard = self._known = begun

    def feed(self, place: Place, t: float, heard: float) -> bool:
        """Heard at ``t`` (UTC s). Whether it is the newest. One that is older than the last, and came behind it on the
        way, is none; where nothing newer has come for :data:`SILENT`, a clock was set back, and it is.
        """
        if self.last is not None and place.t <= self.last.t and heard - self._heard < SILENT:
            return False
        late = max(0.0, min(t - place.t, TOO_OLD) - IN_TIME)
        self.late += (1.0 if self.last is None else LATE_GAIN) * (late - self.late)
        self.last, self._heard = place, heard
        return True

    def check(self, t: float, now: float) -> Place:
        """The last place, where it may be flown by at ``t`` (UTC s), ``now`` by the clock of hearing; else raises
        :class:`~zmav.errors.Stale`.
        """
        silent = now - self._heard
        if self.last is None:
            raise Stale(f"no GLOBAL_POSITION_INT of its autopilot has come for {silent:.1f} s", age=silent)
        if silent > SILENT:
            raise Stale(f"its autopilot said {silent:.1f} s ago where it is", age=silent)
        if not -AHEAD <= (age := t - self.last.t) <= TOO_OLD:  # one from after now would not be carried on
            raise Stale(f"where it was {age:.1f} s ago is heard only now; or the hosts' clocks disagree", age=age)
        return self.last

    def unheard(self, now: float) -> None:
        """Nothing at all is heard of the vehicle: not even its states, so that is another matter."""
        self._known = now

    def known(self, t: float, now: float) -> str:
        """Empty where :meth:`check` is passed; else why not. Raises what that raises where it has not been passed for
        :data:`~zmav.flying.PATIENCE`.
        """
        try:
            self.check(t, now)
        except Stale as e:
            if now - self._known > PATIENCE:
                raise
            return e.message
        self._known = now
        return ""

    def at(self, t: float) -> Vector | None:
        """Where it is at ``t``, carried on with its velocity; None: it has not said."""
        if self.last is None:
            return None
        age = max(0.0, min(t - self.last.t, TOO_OLD))
        north, east, down = (x + age * v for x, v in zip(self.last.pos, self.last.vel, strict=True))
        return north, east, down
