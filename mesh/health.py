"""A ground host's router tells how its computer is; a vehicle's agent does that beside the autopilot."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator

import zenoh

from mesh.plan import RouterPlan
from zmav.services.queries.proven import Answers
from zmav.services.queries.questions import Questions
from zmav.services.status.host import HostService
from zmav.trust.gate import anybody


@contextlib.asynccontextmanager
async def tell_health(session: zenoh.Session, plan: RouterPlan) -> AsyncIterator[None]:
    """A part of the router."""
    if plan.vehicle:
        yield
        return
    questions = Questions(session, Answers(None, None), anybody)
    HostService(questions, str(session.info.zid()), plan.fleet, plan.name)
    try:
        yield
    finally:
        questions.close()
