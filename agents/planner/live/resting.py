"""Who has come to rest, and can be given something new to fly, by what it said of itself."""

from __future__ import annotations

import time

from agents.planner.execute.vehicle_command import RESTING
from agents.planner.live.context import Context
from agents.planner.live.fleet import FRESH
from zmav import wire

COMING = "its next state"
"""what is waited for of a vehicle that is heard, and has not said anything since a goal began: nothing worth a word"""


def heard(context: Context, name: str, since: float) -> bool:
    """It has said something ``since`` (monotonic s)."""
    seen = context.fleet.seen(name)
    return seen is not None and seen.age <= time.monotonic() - since


def unrest(context: Context, name: str, since: float) -> str:
    """Why a vehicle cannot begin yet by what it said ``since`` (monotonic s); empty: it can."""
    seen, settings = context.fleet.seen(name), context.settings
    if seen is None or not heard(context, name, since):
        return COMING if seen is not None and seen.age < FRESH else f"{name} is not heard"
    lease = seen.state.lease
    if lease is not None and lease.holder != settings.name:
        return f"{name} is commanded by {lease.holder}"
    if seen.state.pilot:
        return f"{name}: {seen.state.pilot}"
    if not seen.view.hovers:
        return ""
    if seen.state.mover == "failsafe":
        return f"{name} flies home by itself"
    speed = sum(v * v for v in seen.view.vel_ned) ** 0.5
    return f"{name} still moves" if speed > RESTING or _committed(seen.state) else ""


def _committed(state: wire.VehicleState) -> bool:
    """It flies a segment to its end, under a lease or since that was lost; it may rest on its way and go on."""
    segment, lease, end = state.segment, state.lease, state.lease_end
    if segment is None or segment.rests <= state.t:
        return False
    if lease is not None:
        return lease.number == segment.lease
    return end is not None and end.number == segment.lease and end.reason in ("expired", "gone")
