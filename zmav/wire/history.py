"""What was: asked of recorders, and answered when a vehicle itself no longer can."""

from __future__ import annotations

from typing import Annotated, Any

import msgspec

from zmav.wire.base import Told, Wire

MOST = 1000
"""entries in one answer"""


class HistoryQuery(Wire, kw_only=True):
    """Which entries of ``history/{of}/{what}``: the newest, or the newest so many between two times (UTC seconds)."""

    since: float | None = None
    until: float | None = None
    last: Annotated[int, msgspec.Meta(ge=1, le=MOST)] | None = None
    """so many at most; None: one, or where ``since`` or ``until`` is given as many as one answer holds"""


class HistoryEntry(Told, kw_only=True):
    key: str
    """on which it came"""
    t: float
    """UTC seconds at which the recorder had it"""
    value: Any
    """the JSON as it came; of a frame the fields, enumerations as numbers"""


class History(Told, kw_only=True):
    """What one recorder knows of one thing, the oldest entry first."""

    recorder: str
    of: str
    """whose: a vehicle's or a station's name, or ``fleet`` for what the whole fleet shares"""
    what: str
    """``state``, ``event``, another channel's name, a MAVLink message's, or a topic of the fleet's"""
    entries: list[HistoryEntry] = []
    more: bool = False
    """there are older ones that were asked for and did not fit"""
