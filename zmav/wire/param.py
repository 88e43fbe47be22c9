"""Parameters: what the vehicle's cache holds, and the orders that change them."""

from __future__ import annotations

from zmav.wire.base import Told, Wire
from zmav.wire.orders import Order

PARAM_TYPES = ("UINT8", "INT8", "UINT16", "INT16", "UINT32", "INT32", "UINT64", "INT64", "REAL32", "REAL64")
"""MAV_PARAM_TYPE without its prefix; the first of them is number 1"""


class Param(Told, kw_only=True):
    """One parameter; ``type`` is one of :data:`PARAM_TYPES`; integers are integers, None is no number (NaN)."""

    name: str
    value: float | int | None
    type: str


class ParamTable(Told, kw_only=True):
    """Reply to ``param``: the whole set as the vehicle's cache holds it, in the autopilot's own order: where it is
    complete, a parameter's place in ``params`` is its ``param_index``.

    ``hash`` tells two sets apart: ask with it as ``{"hash": "..."}`` and an unchanged set comes without ``params``.
    """

    t: float
    """UTC seconds of the last change or confirmation"""
    complete: bool
    """every parameter the autopilot announced is here"""
    count: int
    """how many the autopilot has"""
    hash: str
    autopilot: str
    firmware: str | None = None
    encoding: str = ""
    """how PARAM_VALUE and PARAM_SET carry integers on this autopilot's link: ``c_cast`` or ``bytewise``"""
    unchanged: bool = False
    params: list[Param] = []


class ParamQuery(Wire, kw_only=True):
    """Payload of a query on ``param``; all of it may be absent."""

    hash: str = ""
    """the set the asker has"""


class ParamSet(Order, kw_only=True):
    """``do/param_set``: one parameter, read back from the autopilot before it is said to be done."""

    name: str
    value: float | int


class ParamChanged(Told, kw_only=True):
    """Result of ``do/param_set``."""

    name: str
    value: float | int | None
    """as read back"""
    before: float | int | None


class ParamLoad(Order, kw_only=True):
    """``do/param_load``: many at once; those not set are named with the reason, the others are in force."""

    values: dict[str, float | int]


class ParamLoaded(Told, kw_only=True):
    """Result of ``do/param_load``: every name that was given is in one of the three."""

    set: list[str] = []
    unchanged: list[str] = []
    """had that value already, by the cache: nothing was sent"""
    failed: dict[str, str] = {}
    """the reason by name"""


class ParamRefresh(Order, kw_only=True):
    """``do/param_refresh``: read the whole set again from the autopilot."""
