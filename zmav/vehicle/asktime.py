"""A vehicle whose clock is not ours is asked what is now: its states are judged by its own time from then on."""

from __future__ import annotations

import contextlib

import zenoh

from zmav.errors import Forbidden
from zmav.ratelimit import RateLimit
from zmav.services.queries.everybody import challenge_vehicle
from zmav.trust.member import Member, Place

EVERY, MOST = 1.0, 256
"""s between two questions to one vehicle, and vehicles that are asked within that time"""
PATIENCE = 2.0
"""s that an answer may take: by so much the time may be wrong that it tells"""


class AskTime:
    """Asks by a challenge, which only the vehicle itself answers, and only now. From any thread.

    Names that are no vehicle's are not asked: anybody can invent any number of them.
    """

    def __init__(self, session: zenoh.Session, member: Member) -> None:
        self._session, self._member = session, member
        self._asked: RateLimit[Place] = RateLimit(EVERY, MOST)

    def __call__(self, place: Place) -> None:
        if not self._member.verifier.is_vehicle(*place) or self._asked.take(place) is None:
            return

        def on_state(key: str, payload: bytes, proof: bytes | None, challenge: bytes) -> None:
            with contextlib.suppress(Forbidden):
                self._member.take_time(place, key, payload, proof, challenge)

        challenge_vehicle(self._session, place, on_state, timeout=PATIENCE)
