"""Says which host a router without a vehicle is: a liveliness token that holds its name and Zenoh id.

A vehicle's own token does that for its router.
"""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator

import zenoh

from mesh.plan import RouterPlan
from zmav import keys

NOTHING = "-"


@contextlib.asynccontextmanager
async def say_name(session: zenoh.Session, plan: RouterPlan) -> AsyncIterator[None]:
    """A part of the router."""
    if plan.vehicle:
        yield
        return
    key = keys.ALIVE.key(
        plan.fleet, plan.name, role=keys.ROUTER, sys=0, autopilot=NOTHING, uid=NOTHING, instance=session.info.zid()
    )
    token = session.liveliness().declare_token(key)
    try:
        yield
    finally:
        token.undeclare()
