"""The steps of the watchdog, from a fresh setpoint down to landing, and what it tells of them."""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping
from typing import NamedTuple

from zmav.autopilots import Autopilot, Target
from zmav.services.authority.control import Mover

SAFER: Mapping[str, tuple[str, ...]] = {"loiter": ("loiter", "land"), "rtl": ("rtl", "land"), "land": ("land",)}

Allowed = Callable[[str | None], bool]
Near = Callable[[Autopilot, Target, tuple[int, int], bool], Target | None]
Aside = Callable[[Callable[[float], Target]], tuple[Target, str] | None]


class Step(enum.Enum):
    IDLE = "idle"
    ENGAGING = "engaging"
    FRESH = "fresh"
    HOLDING = "holding"
    RETURNING = "returning"
    ACTING = "acting"


MOVERS = {
    Step.ENGAGING: Mover.STREAM,
    Step.FRESH: Mover.STREAM,
    Step.HOLDING: Mover.HOLD,
    Step.RETURNING: Mover.FAILSAFE,
    Step.ACTING: Mover.FAILSAFE,
}


class ModeRequested(NamedTuple):
    """A mode that the watchdog asks the autopilot for. Told from its thread, or from who gives a setpoint."""

    mode: str


class StreamGivenUp(NamedTuple):
    """It acts on a stream that is over for good: nothing more is flown under its lease. Told from its thread."""

    lease: int
    """its lease's number"""
