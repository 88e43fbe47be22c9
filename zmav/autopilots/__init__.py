"""What differs between flight stacks, one file each, and nowhere else."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from zmav.autopilots.ardupilot import ArduPilot
from zmav.autopilots.base import Action, Autopilot, Command, Latest, Level, Message, Mode, Need, Target
from zmav.autopilots.generic import Generic
from zmav.autopilots.px4 import Px4

__all__ = [
    "Action",
    "Autopilot",
    "Command",
    "Latest",
    "Level",
    "Message",
    "Mode",
    "Need",
    "Target",
    "autopilot_for",
    "autopilot_named",
    "kind_of",
]

OTHER = "other"
"""a kind that zmav has no rules for: what the common dialect promises is all that is asked of it"""
_KINDS = {
    "copter": (2, 3, 13, 14, 15, 29, 35, 43),
    "heli": (4,),
    "plane": (1, 16, 17, 28),
    "vtol": (19, 20, 21, 22, 23, 24, 25),
    "rover": (10,),
    "boat": (11,),
}
"""MAV_TYPE numbers by kind"""
_KIND_OF = {mav_type: kind for kind, types in _KINDS.items() for mav_type in types}
_STACKS: Mapping[int, Callable[[str], Autopilot]] = {3: ArduPilot, 12: Px4}


def kind_of(mav_type: int) -> str:
    """copter, plane, rover... of a MAV_TYPE; ``other`` for what zmav has no rules for."""
    return _KIND_OF.get(mav_type, OTHER)


def autopilot_for(mav_autopilot: int, mav_type: int) -> Autopilot:
    """The rules for a HEARTBEAT's ``autopilot`` (MAV_AUTOPILOT) and ``type`` (MAV_TYPE)."""
    kind = kind_of(mav_type)
    return Generic(kind) if kind == OTHER else _STACKS.get(mav_autopilot, Generic)(kind)


def autopilot_named(name: str | None, kind: str | None) -> Autopilot:
    """The rules by what a :class:`~zmav.wire.VehicleState` says: ``ardupilot`` and ``copter``, for instance."""
    stack = next((each for each in (ArduPilot, Px4) if each.name == name), Generic)
    return stack(kind or OTHER)
