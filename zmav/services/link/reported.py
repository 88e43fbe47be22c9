"""What the autopilot says of its mode and arming, from the adapter's memory: any thread may ask."""

from __future__ import annotations

import math
from typing import NamedTuple

from zmav.autopilots import Autopilot
from zmav.autopilots.base import Fields
from zmav.mavlink import decode
from zmav.services.link.port import Port

INTENTION_LASTS = 1.0
"""s for which an intention once told is taken for the present one; it comes many times a second, or is not relied on"""
FRESH = 2.0
"""s: age up to which a message says how things are: a position, where somebody is"""
IN_THE_AIR = (2, 3, 4)
"""MAV_LANDED_STATE: in the air, taking off, landing"""


class ReportedMode(NamedTuple):
    """What the autopilot says of itself."""

    mode: str | None = None
    armed: bool = False
    intended: str | None = None
    """the mode last asked for, where it says that: ``mode`` is a failsafe's where it is another"""


def shown(port: Port, autopilot: Autopilot, source: tuple[int, int]) -> ReportedMode:
    """By the last HEARTBEAT, and by what tells the mode sooner."""
    heard = port.latest("HEARTBEAT", source)
    if heard is None:
        return ReportedMode()
    beat = decode(heard.frame, port.dialect)
    custom, intended, name = beat["custom_mode"], None, autopilot.mode_name
    sooner = port.latest(autopilot.mode_message, source) if autopilot.mode_message else None
    if sooner is not None:
        told = decode(sooner.frame, port.dialect)
        custom = told["custom_mode"] if sooner.age < heard.age else custom
        if told["custom_mode"] == custom and sooner.age <= INTENTION_LASTS:  # else it is what was intended before
            intended = name(beat["base_mode"], told["intended_custom_mode"])
    return ReportedMode(name(beat["base_mode"], custom), bool(beat["base_mode"] & 128), intended)


def fields_of(port: Port, name: str, source: tuple[int, int] | None, fresh: float = math.inf) -> Fields | None:
    """The fields of its last message of that name; None: it never came, or is older than ``fresh`` s."""
    heard = port.latest(name, source) if source else None
    return decode(heard.frame, port.dialect) if heard and heard.age < fresh else None


def in_the_air(port: Port, source: tuple[int, int]) -> bool | None:
    """As EXTENDED_SYS_STATE says; None: it does not."""
    said = fields_of(port, "EXTENDED_SYS_STATE", source)
    state = 0 if said is None else said["landed_state"]
    return None if state == 0 else state in IN_THE_AIR
