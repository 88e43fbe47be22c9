"""What a vehicle's agent says of its host, said by the router of a host without one: who it is, by a liveliness token
that holds its name and Zenoh id, and how its computer is.
"""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator

import zenoh

from mesh.plan import RouterPlan
from zmav import keys
from zmav.services.queries.proven import Answers
from zmav.services.queries.questions import Questions
from zmav.services.status.answers import HostService
from zmav.trust.gate import anybody

NOTHING = "-"


@contextlib.asynccontextmanager
async def present_host(session: zenoh.Session, plan: RouterPlan) -> AsyncIterator[None]:
    """A part of the router."""
    if plan.vehicle:
        yield
        return
    zid = str(session.info.zid())
    key = keys.ALIVE.key(plan.fleet, plan.name, role=keys.ROUTER, sys=0, autopilot=NOTHING, uid=NOTHING, instance=zid)
    token = session.liveliness().declare_token(key)
    questions = Questions(session, Answers(None, None), anybody)
    HostService(questions, zid, plan.fleet, plan.name)
    try:
        yield
    finally:
        questions.close()
        token.undeclare()
