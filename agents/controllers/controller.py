"""What a user writes: one class, and no build step.

    from agents.controllers import Controller, RatesThrust, parameter

    class Mine(Controller):
        level = "attitude"                       # what it takes over; from the rates on it stays with the autopilot
        kp = parameter(6.0, 0.0, 20.0, "1/s", "of the tilt")

        def update(self, state, reference):
            error = ...
            self.signal(error=error)             # a stream for viewer and recorder
            return RatesThrust(self.kp * error, reference.thrust)

``zmav agent run mine.py --vehicle hex1``. Saving the file has it loaded again between two cycles.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, cast

import numpy as np

from agents.controllers.types import LEVELS, OUTPUTS, USUAL, Level, Output, Reference, State, Trim
from zmav.errors import BadConfig
from zmav.tunable import Tunable, check_tunable


def parameter(default: float, low: float, high: float, unit: str = "", doc: str = "") -> float:
    """A parameter, as a class attribute: a number on each instance, changed in flight within its bounds. Raises
    :class:`~zmav.errors.BadConfig` for bounds without the default between them.
    """
    # numpy's numbers are no JSON
    default, low, high = float(default), float(low), float(high)
    if not (math.isfinite(low) and math.isfinite(high) and low <= default <= high):  # false for nan, too
        text = f"parameter({default:g}, {low:g}, {high:g}): expected parameter(default, low, high), the default between"
        raise BadConfig(text, field="default", value=default, expected=f"{low:g} to {high:g}")
    return cast("float", Tunable(default, low, high, unit, doc))


class Controller(ABC):
    """Base of controllers. A subclass gives :attr:`level`, where not usual :attr:`gives`, and :meth:`update`.

    Raises :class:`~zmav.errors.BadConfig`, when the class is made, for a level or an output that there is not.
    """

    level: ClassVar[Level]
    """the outermost loop that it takes over, and so the kind of reference that it follows"""
    gives: ClassVar[str] = ""
    """velocity, acceleration, attitude, rates or torque; empty: that of the level below its own"""
    tunables: ClassVar[Mapping[str, Tunable]] = {}

    def __init_subclass__(cls, **rest: Any) -> None:
        super().__init_subclass__(**rest)
        found = dict(cls.tunables)
        for name, value in list(vars(cls).items()):
            if isinstance(value, Tunable):
                if hasattr(Controller, name) or name == "signals":
                    raise _bad(cls, name, value, "another name: a parameter would hide what every controller has")
                found[name] = value
        cls.tunables = found
        level = getattr(cls, "level", None)
        if level is None:
            return  # a base of others
        if level not in LEVELS:
            raise _bad(cls, "level", level, "one of " + ", ".join(LEVELS))
        if not vars(cls).get("gives"):
            inherited = any(vars(base).get("gives") for base in cls.__mro__[1:] if "level" not in vars(cls))
            cls.gives = cls.gives if inherited else USUAL[cast("Level", level)]
        if cls.gives not in OUTPUTS:
            raise _bad(cls, "gives", cls.gives, "one of " + ", ".join(OUTPUTS))

    def __init__(self, tuned: Mapping[str, float] | None = None) -> None:
        for name, each in self.tunables.items():
            setattr(self, name, each.default)
        for name, value in (tuned or {}).items():
            self.tune(name, value)
        self.signals: dict[str, float] = {}

    def tune(self, name: str, value: float) -> None:
        """Change a parameter. Raises :class:`~zmav.errors.BadInput` where there is none, or beyond its bounds."""
        check_tunable(type(self).__name__, self.tunables, name, value)
        setattr(self, name, value)

    def reset(self, state: State, reference: Reference, trim: Trim) -> None:  # noqa: B027  (not every class begins from something)
        """Begin from what is, so that nothing jumps when this takes over: called with every cycle while the autopilot
        flies, and once where the class was loaded in flight. Integrators begin where :meth:`update` would give what
        ``trim`` says.
        """

    @abstractmethod
    def update(self, state: State, reference: Reference) -> Output:
        """One cycle. Raising, or giving what is not finite, hands back to the autopilot at once."""

    def signal(self, **values: Any) -> None:
        """Streams for viewer, recorder and report: numbers, or vectors of three (told as name.x, .y, .z) or more
        (name.0, ...).
        """
        for name, value in values.items():
            if isinstance(value, float | int):
                self.signals[name] = float(value)
                continue
            row = np.asarray(value, dtype=float)
            if row.ndim == 0:  # numpy's own numbers
                self.signals[name] = float(row)
                continue
            row = row.ravel()
            ends = "xyz" if len(row) == 3 else [str(i) for i in range(len(row))]
            for end, each in zip(ends, row, strict=True):
                self.signals[f"{name}.{end}"] = float(each)


def _bad(cls: type[Controller], field: str, value: object, expected: str) -> BadConfig:
    return BadConfig.wrong(field, value, expected, f"{cls.__name__}.{field} is {value!r}")
