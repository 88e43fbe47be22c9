"""A vehicle whose clock is not ours is asked what is now: its states are judged by its own time from then on."""

from __future__ import annotations

import contextlib
import os
import time

import zenoh

from zmav import keys
from zmav.errors import Forbidden
from zmav.services.proven import attached
from zmav.trust.member import Member, Place
from zmav.trust.proof import ANSWERS

EVERY = 1.0
"""s between two questions to one vehicle"""
MOST = 256
"""vehicles whose last question is remembered"""
PATIENCE = 2.0
"""s that an answer may take: by so much the time may be wrong that it tells"""


class AskTime:
    """Asks by a challenge, which only the vehicle itself answers, and only now. From any thread."""

    def __init__(self, session: zenoh.Session, member: Member) -> None:
        self._session, self._member = session, member
        self._asked: dict[Place, float] = {}

    def __call__(self, place: Place) -> None:
        now = time.monotonic()
        if now - self._asked.get(place, -EVERY) < EVERY:
            return
        if len(self._asked) > MOST:
            self._asked.clear()
        self._asked[place] = now
        key, challenge, member = keys.STATE.key(*place), os.urandom(ANSWERS), self._member

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                with contextlib.suppress(Forbidden):
                    member.take_time(place, key, reply.ok.payload.to_bytes(), attached(reply.ok), challenge)

        self._session.get(
            key, on_reply, payload=challenge, timeout=PATIENCE, target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE, **keys.STATE.qos.options(),
        )  # fmt: skip
