"""How far vehicles may truly be from where they say that they are, and the room that plans make for it.

Without a base that they share, two receivers' errors drift apart by metres within minutes, and no autopilot says by how
much: what is reckoned with is the worse of its receiver's own estimate, its filter's, and what is usual for the fix.
Metres across, one standard deviation.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from zmav import wire
from zmav.wire import swarm

SIGMAS = 3.0
"""standard deviations of what two vehicles are off against each other that there is room for"""
FIXED, FIXED_ALONE = 0.05, 0.3
"""with ambiguities fixed: receivers of one base are off against each other by so much; and from which estimate of its
own on a receiver is believed more than its fix"""
FLOAT = 0.3
"""with ambiguities not fixed yet"""
DRIFT = 0.5
"""the least that receivers are off against each other that share no base, however well each thinks of itself"""
UNTOLD = 1.5
"""where neither the receiver nor the filter says anything"""
LOST = 5.0
"""of a receiver without a fix in three dimensions, where the filter says nothing either"""
STRAINED, STRETCHED = 0.5, 4.0
"""of the filter's test ratio, from which its position is believed less; and times at most that its error is taken"""
UNFIXED = ("not told", "NO_FIX", "2D_FIX")
FORGETS_S = 30.0
"""s in which what was worse is forgotten to a third: h_acc comes and goes with satellites, and plans should not"""
GRAIN = 0.05
"""m in which errors are counted, upwards"""
WORST = 1e5
"""m that any is off at most: whoever says more says nothing, and numbers without an end are none to plan with"""


def position_error(state: wire.VehicleState, declared: float | None = None) -> tuple[float, str]:
    """What it may be off now, and by what that is told, in a word. ``declared``: by its fleet file, which is believed
    in the place of receiver and filter, but not of a filter that is off its own sensors.
    """
    estimate = state.estimate or wire.Estimate()
    if declared is not None:
        error, word = declared, "declared"
    else:
        error, word = _reported(state.gps, estimate.accuracy)
    ratio = estimate.ratio or 0.0
    return min(error * min(max(ratio / STRAINED, 1.0), STRETCHED), WORST), word


def _reported(gps: wire.Gps | None, filtered: float | None) -> tuple[float, str]:
    if gps is None or gps.fix == "NO_GPS":  # it flies by something else, indoors perhaps
        return (UNTOLD, "not told") if filtered is None else (filtered, "filter")
    own, word = gps.h_acc, gps.fix
    if gps.fix in ("RTK_FIXED", "STATIC", "PPP"):
        error = own if own is not None and own > FIXED_ALONE else FIXED
    elif gps.fix == "RTK_FLOAT":
        error = max(FLOAT, own or 0.0)
    elif gps.fix in ("3D_FIX", "DGPS"):
        error = max(DRIFT, own if own is not None else UNTOLD * max(1.0, gps.hdop or 1.0))
    else:
        error = max(LOST, own or 0.0)
    return max(error, filtered or 0.0), word


def rooms(errors: Mapping[str, float]) -> dict[str, float]:
    """m by which each one's radius is to grow, so that any two of these are as far apart as their radii ask for but for
    what happens beyond :data:`SIGMAS`: errors of two add up by their squares, and radii do not.
    """
    least, most = min(errors.values(), default=0.0), max(errors.values(), default=0.0)
    share = math.hypot(least, most) / (least + most) if least + most > 0.0 else 1.0  # of no other pair it is more
    return {name: SIGMAS * share * error for name, error in errors.items()}


class Accuracies:
    """What each vehicle may be off, held for a while where it was worse. Lives on the event loop."""

    def __init__(self) -> None:
        self._held: dict[str, tuple[float, float, str]] = {}
        self._rooms: dict[str, float] = {}

    def heard(self, name: str, state: wire.VehicleState, declared: float | None, now: float) -> None:
        """Take in a state; ``now``: monotonic s. What a vehicle was off on the ground before its receiver found its
        satellites is not held.
        """
        error, word = position_error(state, declared)
        held, at, before = self._held.get(name, (0.0, now, ""))
        found = state.armed is False and before in UNFIXED and word not in UNFIXED
        held *= 0.0 if found else math.exp(-(now - at) / FORGETS_S)
        self._held[name] = (max(error, held), now, word)

    def settle(self, names: Iterable[str]) -> None:
        """Forget all but these; what is asked for from now on is by what was heard until now."""
        keep = set(names)
        self._held = {name: held for name, held in self._held.items() if name in keep}
        self._rooms = rooms({name: self.error(name) for name in self._held})

    def error(self, name: str) -> float:
        held = self._held.get(name)
        return 0.0 if held is None else math.ceil(held[0] / GRAIN - 1e-6) * GRAIN

    def word(self, name: str) -> str:
        """By what its error is told."""
        held = self._held.get(name)
        return "" if held is None else held[2]

    def room(self, name: str) -> float:
        """m of radius that plans give it on top of its own."""
        return self._rooms.get(name, 0.0)


def tight_of(goal: swarm.Goal) -> list[str]:
    """The vehicles for whose places' errors the goal wants no room made."""
    return goal.vehicles if isinstance(goal, swarm.GoTo | swarm.Formation) and goal.tight else []
