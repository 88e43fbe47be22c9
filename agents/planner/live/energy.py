"""What a goal takes out of batteries, learnt from what they say themselves, and who may not fly it.

A battery says what share is left of it, to a hundredth. Each hundredth that goes in the air tells what that much time
and way took together; from many of them the shares a second and a metre follow by least squares, starting from what
the vehicle's ``endurance`` says. Shares are 0 to 1 of a full battery.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from agents.planner.goals.steps import FleetView
from agents.planner.live.tally import Tally
from agents.planner.model.problem import Floats
from zmav import wire
from zmav.errors import Refused
from zmav.wire import swarm

PRIOR, PACE = 4.0, 2.0
"""hundredths that what the endurance says counts for against those that have gone, flown at so many m/s"""
FADES = 0.98
"""of what was learnt that is left after each hundredth: another pack, a load or the cold makes it another vehicle"""
DROP, JUMP = 0.005, 0.04
"""what is left has changed, which is said to a hundredth; and by more at once than flight takes: a cell has died"""
GAP_S = 3.0
"""s between two states, above which the way between them is not known"""
WITHIN = (0.2, 5.0)
"""of what the endurance says, that what is learnt is taken to be between"""
CALLED_BACK = (swarm.TakeOff, swarm.GoTo, swarm.Formation, swarm.Follow, swarm.Search)
"""kinds of goals that are refused to empty batteries; the others bring home or stop"""


class Consumption:
    """Of one vehicle. Lives on the event loop."""

    def __init__(self) -> None:
        self._squares, self._drops = np.zeros((2, 2)), np.zeros(2)
        self._flown = np.zeros(2)
        """s and m since the last hundredth went"""
        self._left: float | None = None
        """the last one; None: it has not gone since we look"""
        self._aligned = False
        """a hundredth has gone while we looked: from there on whole ones are counted"""
        self._seen: tuple[float, Floats] | None = None

    def heard(self, t: float, left: float | None, place: Floats, flies: bool) -> None:
        """A state of ``t`` (s): the share that is ``left``, where it is, and whether it is in the air."""
        before, self._seen = self._seen, (t, place) if flies and left is not None else None
        if self._seen is None or left is None:
            self._left, self._aligned = None, False
            return
        jumped = self._left is not None and not -DROP <= self._left - left <= JUMP
        if self._left is None or before is None or not 0.0 <= t - before[0] < GAP_S or jumped:
            self._left, self._aligned, self._flown = left, False, np.zeros(2)
            return
        self._flown += (t - before[0], float(np.linalg.norm(place - before[1])))
        if left > self._left - DROP:
            return
        if self._aligned:
            self._squares = FADES * self._squares + np.outer(self._flown, self._flown)
            self._drops = FADES * self._drops + self._flown * (self._left - left)
        self._left, self._aligned, self._flown = left, True, np.zeros(2)

    def rates(self, endurance: float) -> tuple[float, float]:
        """Shares a second and a metre; ``endurance``: s that the vehicle is said to fly for, full."""
        usual, each = 1.0 / endurance, 0.01 * endurance
        squares = self._squares + PRIOR * np.diag([each**2, (PACE * each) ** 2])
        drops = self._drops + np.array([PRIOR * each**2 * usual, 0.0])
        second, metre = np.linalg.solve(squares, drops).tolist()
        low, high = (share * usual for share in WITHIN)
        if metre < 0.0:
            second, metre = float(drops[0] / squares[0, 0]), 0.0
        if not low <= second <= high:  # to hover costs something, whatever the way did
            second = min(max(second, low), high)
            metre = max(0.0, float(drops[1] - squares[0, 1] * second) / float(squares[1, 1]))
        return second, metre


@dataclass(frozen=True)
class Need:
    """Of one vehicle for one goal."""

    seconds: float
    metres: float
    takes: float
    """share of a full battery: the goal"""
    home: float
    """and the way home after it, and down"""
    now: float | None
    """what is left in it; None: not known"""
    reserve: float

    @property
    def left(self) -> float | None:
        """On landing."""
        return None if self.now is None else self.now - self.takes - self.home

    @property
    def short(self) -> bool:
        return self.left is not None and self.left < self.reserve

    def words(self) -> str:
        flown = f"{self.seconds:.0f} s and {self.metres:.0f} m, {_percent(self.takes)} of its battery"
        if self.now is None:
            return f"{flown}; what is left in it is not known"
        return f"{flown} of the {_percent(self.now)} that it has; lands with {_percent(self.left or 0.0)}"

    def figures(self) -> dict[str, float | None]:
        return {
            "seconds": round(self.seconds, 1),
            "metres": round(self.metres, 1),
            "battery": round(self.takes, 4),
            "home": round(self.home, 4),
            "battery_left": self.now,
            "landing": None if self.left is None else round(self.left, 4),
            "reserve": self.reserve,
        }


class Energy:
    """Of all that are heard. Lives on the event loop."""

    def __init__(self) -> None:
        self._of: dict[str, Consumption] = {}

    def heard(self, name: str, state: wire.VehicleState, place: Floats, flies: bool) -> None:
        self._of.setdefault(name, Consumption()).heard(state.t, left_of(state), place, flies)

    def settle(self, names: Iterable[str]) -> None:
        """Forget all but these."""
        self._of = {name: self._of[name] for name in names if name in self._of}

    def takes(self, name: str, body: swarm.Body, seconds: float, metres: float) -> float:
        """The share of a full battery for so much time in the air, and way."""
        second, metre = self._of.setdefault(name, Consumption()).rates(body.endurance)
        return float(second * seconds + metre * metres)

    def needs(self, tally: Tally, view: FleetView, left: Mapping[str, float | None]) -> dict[str, Need]:
        """What a goal that comes to ``tally`` takes from each, and what is left then; ``left``: what is now."""
        found = {}
        for name, part in tally.parts.items():
            body = view.vehicles[name].body
            takes = self.takes(name, body, part.seconds, part.metres)
            home = self.takes(name, body, *tally.home(name))
            found[name] = Need(float(part.seconds), float(part.metres), takes, home, left.get(name), body.reserve)
        return found


def left_of(state: wire.VehicleState) -> float | None:
    """The share that is left in its battery; None: it does not say."""
    return state.battery.remaining if state.battery is not None else None


def check(goal: swarm.Goal, needs: Mapping[str, Need], unknown_allowed: bool) -> None:
    """Raise :class:`Refused` for a goal that somebody could not come back from with its reserve, or that somebody would
    fly whose battery is not known, where that is not allowed. What brings home or stops is never refused.
    """
    if not isinstance(goal, CALLED_BACK):
        return
    short = {name: need for name, need in needs.items() if need.short}
    unknown = [name for name, need in needs.items() if need.now is None]
    words = [
        f"{name} could not come back with its reserve of {_percent(need.reserve)}: {need.words()}"
        for name, need in short.items()
    ]
    if unknown and not unknown_allowed:
        words.append(
            f"what is left in the battery of {', '.join(unknown)} is not known (zmav swarm planner "
            "--unknown-batteries has such fly)"
        )
    if words:
        raise Refused("; ".join(words), reason="battery", vehicles=[*short, *(unknown if not unknown_allowed else ())])


def warning_of(goal: swarm.Goal, needs: Mapping[str, Need], unknown_allowed: bool) -> str:
    """As :func:`check`, in words for who only looks; empty: nothing is against it."""
    try:
        check(goal, needs, unknown_allowed)
    except Refused as e:
        return e.message
    return ""


def told(needs: Mapping[str, Need]) -> str:
    """Everybody's, in a line."""
    return "; ".join(f"{name}: {need.words()}" for name, need in needs.items())


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"
