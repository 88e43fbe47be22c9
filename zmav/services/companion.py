"""What the services beside one autopilot have in common."""

from __future__ import annotations

from typing import NamedTuple

import zenoh

from zmav import wire
from zmav.services.link.identity import Identity
from zmav.services.link.port import Port
from zmav.services.queries.questions import Questions
from zmav.services.status.events import Events


class Companion(NamedTuple):
    """The program beside an autopilot: its session, its link, whom it hears there, and by what it speaks."""

    session: zenoh.Session
    questions: Questions
    port: Port
    identity: Identity
    events: Events
    origin: wire.Origin | None
    """the fleet's"""
