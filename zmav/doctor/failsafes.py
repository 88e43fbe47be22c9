"""``zmav doctor``'s look at the parameters that decide what a vehicle does when its companion is dead."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterator

from zmav.autopilots.safety import SAFETY, Safety
from zmav.doctor import topics
from zmav.doctor.findings import Finding
from zmav.errors import BadInput, TimedOut, ZmavError
from zmav.vehicle.vehicle import Vehicle
from zmav.waiting import within

PATIENCE = 10.0
"""s for all parameters of one vehicle"""

Value = tuple[str, float]
"""A parameter's name on this vehicle, and its value"""


async def read_safety(vehicle: Vehicle) -> dict[Safety, Value | None] | ZmavError:
    """The values of the parameters that matter for this vehicle; None for one that it does not have."""
    state = vehicle.last_state
    wanted = SAFETY.get((state.autopilot or "", state.kind or ""), ()) if state and state.connected else ()
    try:
        values = await within(PATIENCE, _read(vehicle, wanted))
    except ZmavError as e:
        return e
    except asyncio.TimeoutError:
        return ZmavError("its parameters are not read within 10 s: 'zmav param list' shows how far it is")
    return dict(zip(wanted, values, strict=True))


async def _read(vehicle: Vehicle, wanted: tuple[Safety, ...]) -> list[Value | None]:
    """One by one from the vehicle's cache: the whole set is a hundred times as much for the radios between."""
    try:
        return [await _first(vehicle, safety.names) for safety in wanted]
    except TimedOut:  # not all are known there yet, and one of these may not exist
        await vehicle.params.list()
        return [await _first(vehicle, safety.names) for safety in wanted]


async def _first(vehicle: Vehicle, names: tuple[str, ...]) -> Value | None:
    for name in names:
        try:
            value = (await vehicle.params.get(name)).value
        except BadInput:
            continue  # another firmware calls it by the next name, or lacks it
        if value is not None:
            return name, float(value)
    return None


def judge(vehicle: Vehicle, values: dict[Safety, Value | None], who: str) -> Iterator[Finding]:
    """A line for each parameter that is not as it should be, or one that all are."""
    state = vehicle.last_state
    sysid = (state.sysid if state else None) or 0
    faults = 0
    for safety, value in values.items():
        if value is None or (not (unreadable := not math.isfinite(value[1])) and not safety.bad(value[1], sysid)):
            continue
        name, number = value
        say = topics.FAILSAFE.wrong if safety.essential or unreadable else topics.FAILSAFE.advise
        faults += safety.essential or unreadable
        what = "set " if safety.essential else "consider "
        advice = f"{what}{safety.advice}: zmav param set {vehicle.name} {name}=VALUE"
        yield say(f"{name} is {number:g}: {safety.why}", advice, who)
    if values and not faults:
        yield topics.FAILSAFE.well("what it does without its companion is set", who)
