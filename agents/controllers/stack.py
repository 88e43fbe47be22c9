"""A controller with EV1's loops above it, so that it can be given a reference of any outer level.

Whatever the reference's level, only the loops from there inwards run; what each gives is merged into the reference of
the next. Parameters and signals of the loops above are called ``position.kp``, ``velocity.error.x`` and so on; the
controller's own have no prefix.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import replace

from agents.controllers.controller import Controller
from agents.controllers.loops import AltitudeLoop, AttitudeLoop, PositionLoop, VelocityLoop
from agents.controllers.types import (
    LEVELS,
    AttitudeThrust,
    Level,
    Output,
    RatesThrust,
    Reference,
    State,
    Trim,
    Velocity,
)
from zmav.errors import BadInput
from zmav.tunable import Tunable, check_tunable

LOOPS: Mapping[Level, type[Controller]] = {
    "position": PositionLoop,
    "velocity": VelocityLoop,
    "altitude": AltitudeLoop,
    "attitude": AttitudeLoop,
}


FOLLOWED: Mapping[type[Output], Level] = {Velocity: "velocity", AttitudeThrust: "attitude", RatesThrust: "rates"}
"""what loops follow that others give"""


class Stack:
    """``controller`` and the loops above it."""

    def __init__(self, controller: Controller) -> None:
        self.controller = controller
        self.loops: dict[str, Controller] = {
            level: loop() for level, loop in LOOPS.items() if LEVELS.index(level) < LEVELS.index(controller.level)
        }
        """those above it, by their levels"""
        self.followed = Reference()
        """what the controller was given last: what the loops above have made of the reference"""
        self._ran: tuple[str, ...] = ()

    # ---- parameters, signals, state

    @property
    def tunables(self) -> dict[str, Tunable]:
        """All parameters, by the names that :meth:`tune` takes."""
        above = {f"{level}.{name}": each for level, loop in self.loops.items() for name, each in loop.tunables.items()}
        return {**above, **self.controller.tunables}

    def tune(self, name: str, value: float) -> None:
        """Change a parameter. Raises :class:`~zmav.errors.BadInput` where there is none, or beyond its bounds."""
        check_tunable(type(self.controller).__name__, self.tunables, name, value)
        level, _, rest = name.partition(".")
        if level in self.loops:
            self.loops[level].tune(rest, value)
        else:
            self.controller.tune(name, value)

    @property
    def signals(self) -> dict[str, float]:
        """Of the controller and of the loops that ran in this cycle."""
        above = {f"{level}.{name}": value for level in self._ran for name, value in self.loops[level].signals.items()}
        return {**above, **self.controller.signals}

    # ---- flying

    def reset(self, state: State, reference: Reference, trim: Trim) -> None:
        """All loops begin where the autopilot is; each believes that those above ask for what the autopilot asks for.
        Raises as :meth:`update`.
        """
        handed = reference
        for level in self._path(reference):
            loop = self.loops[level]
            loop.reset(state, handed, trim)
            if level == "position":
                handed = merge(handed, loop.update(state, handed))
            elif level == "attitude":
                handed = merge(handed, RatesThrust(trim.rates, trim.thrust))
            else:
                handed = merge(handed, AttitudeThrust(trim.attitude, trim.thrust, reference.yaw_rate))
        self.controller.reset(state, self._fitting(state, reference, handed), trim)

    def update(self, state: State, reference: Reference) -> Output:
        """One cycle. Raises :class:`~zmav.errors.BadInput` for a reference of a level inside the controller's own."""
        handed = reference
        self._ran = self._path(reference)
        for level in self._ran:
            handed = merge(handed, self.loops[level].update(state, handed))
        self.followed = self._fitting(state, reference, handed)
        return self.controller.update(state, self.followed)

    def _path(self, reference: Reference) -> tuple[str, ...]:
        """The levels of the loops above that have to run."""
        level, own = reference.level, self.controller.level
        if LEVELS.index(level) > LEVELS.index(own):
            name = type(self.controller).__name__
            expected = " or ".join(LEVELS[: LEVELS.index(own) + 1])
            text = f"{name} takes over from the {own} on, a reference of {level} is inside that; expected {expected}"
            raise BadInput(text, field="level", value=level, expected=expected)
        outer = LEVELS.index(level)
        # Who holds velocities holds the height as well.
        return tuple(
            each for each in self.loops if LEVELS.index(each) >= outer and (each != "altitude" or level == "altitude")
        )

    def _fitting(self, state: State, reference: Reference, handed: Reference) -> Reference:
        """For the controller itself: of its own level."""
        if self.controller.level != "altitude" or reference.level == "altitude":
            return handed
        # The height is its own task: it gets the reference of it, and of those above only the lean.
        mine = copy.copy(handed)
        mine.level, mine.vel = "altitude", reference.vel
        if reference.level == "velocity":
            mine.pos = state.pos  # there is no height to hold, but a climb
        return mine


def merge(reference: Reference, output: Output) -> Reference:
    """What the loop below is to follow: the reference, with what the loop above gives in place of its own parts."""
    level = FOLLOWED.get(type(output))
    if level is None:
        raise TypeError(f"no loop of EV1 follows a {type(output).__name__}")
    given = {name: value for name, value in vars(output).items() if value is not None}
    return replace(reference, level=level, **given)
