"""What a group's gateway says of its vehicles: enough for a map and for alarms, once a second."""

from __future__ import annotations

from zmav import keys
from zmav.wire.base import Vector, Wire


class GroupMember(Wire, kw_only=True, omit_defaults=True):
    """One vehicle, shortened; a part never heard of is left out."""

    name: str
    age: float
    """s since its state was heard inside the group"""
    kind: str | None = None
    mode: str | None = None
    armed: bool | None = None
    lat_deg: float | None = None
    lon_deg: float | None = None
    alt_amsl: float | None = None
    velocity: Vector | None = None
    """m/s, NED"""
    battery: float | None = None
    """0 to 1"""
    fix: str | None = None
    faults: list[str] = []  # noqa: RUF012  # msgspec copies it
    """what is wrong with it, in words: no autopilot, a clash, the pilot's switch"""


class GroupStates(Wire, kw_only=True):
    """Every vehicle of one group heard within the last half minute, in parts that fit a datagram of a slow link."""

    t: float
    group: str
    part: int = 0
    """from 0 to ``parts`` - 1"""
    parts: int = 1
    vehicles: list[GroupMember] = []  # noqa: RUF012


GROUP = keys.Channel("group", "@group/{group}/states", GroupStates, rate_hz=1.0, stale_after=5.0)
"""a group's vehicles in short, by its gateway: what crosses between groups instead of every state"""
