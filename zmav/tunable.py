"""Numbers of an agent, or of a controller, that are changed while it runs. Little is imported here: a controller's
process begins with it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from zmav.errors import BadInput


@dataclass(frozen=True)
class Tunable:
    """A parameter that may be changed while the agent runs, within its bounds."""

    default: float
    low: float
    high: float
    unit: str = ""
    doc: str = ""


def check_tunable(who: str, tunables: Mapping[str, Tunable], name: str, value: float) -> None:
    """Raises :class:`~zmav.errors.BadInput` where there is no parameter of that name, or the value is out of bounds."""
    known = tunables.get(name)
    if known is None:
        names = ", ".join(tunables) or "none"
        raise BadInput(f"{who} has no parameter {name!r}; there are {names}", field="name", value=name, expected=names)
    if not (math.isfinite(value) and known.low <= value <= known.high):
        expected = f"{known.low:g} to {known.high:g} {known.unit}".strip()
        raise BadInput.wrong(name, value, expected, f"{name} = {value:g}")
