"""What mission file formats share: what a file holds, and numbers behind the names of commands and frames.

Formats stand below the dialects, so they are given the dialect's enums (``Dialect.enums``) as a plain table.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import msgspec

from zmav.errors import BadInput, did_you_mean
from zmav.wire import MissionItem

Enums = Mapping[str, Mapping[str, int]]
Place = tuple[float, float, float]
"""Degrees of latitude and longitude, and metres of altitude"""
UNKNOWN = "UNKNOWN_"
"""before the number of a command that the dialect lacks, as in the names of messages"""


class Plan(msgspec.Struct, kw_only=True):
    """What a file holds, or should; None: nothing is said of that kind, an empty list: it is to be empty."""

    mission: list[MissionItem] | None = None
    fence: list[MissionItem] | None = None
    rally: list[MissionItem] | None = None
    home: Place | None = None
    """where the planner expects home: degrees, and metres above mean sea level"""
    firmware: int = 3
    """MAV_AUTOPILOT of whom it is planned for: ArduPilot is 3, PX4 12"""
    vehicle: int = 2
    """MAV_TYPE of it"""


def command_name(number: int, enums: Enums) -> str:
    """``MAV_CMD_NAV_WAYPOINT`` of 16; ``UNKNOWN_31000`` where the dialect lacks it."""
    if not 0 <= number <= 0xFFFF:
        raise BadInput(f"no command has the number {number}", field="command", value=number, expected="0 to 65535")
    return _name("MAV_CMD", number, enums) or f"{UNKNOWN}{number}"


def command_number(name: str, enums: Enums) -> int:
    """16 of ``MAV_CMD_NAV_WAYPOINT``; raises :class:`BadInput` that suggests names like it."""
    digits = name.removeprefix(UNKNOWN)
    if digits != name and digits.isdecimal() and int(digits) <= 0xFFFF:
        return int(digits)
    return _number("MAV_CMD", name, "command", enums)


def frame_name(number: int, enums: Enums) -> str:
    """``MAV_FRAME_GLOBAL`` of 0; raises :class:`BadInput` for a number that is no frame."""
    found = _name("MAV_FRAME", number, enums)
    if found is None:
        raise BadInput(f"no frame has the number {number}", field="frame", value=number, expected="a MAV_FRAME")
    return found


def frame_number(name: str, enums: Enums) -> int:
    """0 of ``MAV_FRAME_GLOBAL``; raises :class:`BadInput` that suggests names like it."""
    return _number("MAV_FRAME", name, "frame", enums)


def numbers(item: MissionItem) -> tuple[float | None, ...]:
    """param1 to param4: None is NaN, what is missing is 0. Raises :class:`BadInput` for more than four."""
    if len(item.params) > 4:
        why = f"{len(item.params)} params; param5 to param7 are x, y and z"
        raise BadInput(why, field="params", value=len(item.params), expected="at most 4")
    given = [None if value is None or math.isnan(value) else value for value in item.params]
    return (*given, *(0.0,) * (4 - len(given)))


def _name(enum: str, number: int, enums: Enums) -> str | None:
    return next((name for name, value in enums.get(enum, {}).items() if value == number), None)


def _number(enum: str, name: str, field: str, enums: Enums) -> int:
    known = enums.get(enum, {})
    if name not in known:
        full = name.upper() if name.upper().startswith("MAV_") else f"{enum}_{name.upper()}"
        raise BadInput(
            f"no {field} {name!r}{did_you_mean(full, known)}", field=field, value=name, expected=f"an entry of {enum}"
        )
    return known[name]
