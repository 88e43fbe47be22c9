"""Who plans: liveliness tokens under each planner's name, ours and the others', and what others publish."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any

import zenoh

from agents.planner.live.context import Context
from agents.planner.live.leadership.election import Token
from zmav import keys
from zmav.errors import BadKey, Forbidden
from zmav.services.queries.proven import attached
from zmav.trust.member import Member, Place
from zmav.trust.rights import SPEAKERS
from zmav.trust.verify import BUSY
from zmav.waiting import on_loop

ROLE, CHIEF, STANDBY = "planner", "planner", "standby"
"""the token's role, and its word on who is in charge"""


def token_key(fleet: str, name: str, word: str, instance: str) -> str:
    return keys.ALIVE.key(fleet, name, role=ROLE, sys=0, autopilot=word, uid="-", instance=instance)


def plans(member: Member | None, name: str) -> bool:
    """Whether who has that name may be present as a planner: by the roster where we have credentials, else anybody."""
    return member is None or member.verifier.role_of(name) in {role.value for role in SPEAKERS[keys.PLANNER]}


class Tokens:
    """Subscriptions and our own token. Lives on the event loop."""

    def __init__(
        self, context: Context, hears: Mapping[str, Callable[[bytes], None]], on_obstacle: Callable[[bytes], None]
    ) -> None:
        self._context = context
        self._hears = {keys.FLEET.key(context.settings.fleet, topic=topic): take for topic, take in hears.items()}
        self._hears[keys.OBSTACLE.key(context.settings.fleet, name="*")] = on_obstacle
        self._subscribers: list[Any] = []
        self._token: zenoh.LivelinessToken | None = None
        self._closed = False

    def start(self) -> None:
        context, loop = self._context, asyncio.get_running_loop()
        fleet, session, member = context.settings.fleet, context.z.session, context.z.member
        newest: dict[Place, float] = {}

        def put(take: Callable[[bytes], None]) -> Callable[..., None]:
            def on_sample(sample: zenoh.Sample) -> None:
                if sample.kind != zenoh.SampleKind.PUT or self._closed:
                    return
                data = sample.payload.to_bytes()
                if member is not None:
                    try:
                        member.judge(str(sample.key_expr), data, attached(sample), newest)
                    except Forbidden as e:
                        if e.detail["reason"] not in ("unknown", BUSY):  # it introduces itself within a second
                            context.say_seldom("disbelieved", "warning", f"{sample.key_expr}: {e}")
                        return
                take(data)

            return on_loop(loop, on_sample)

        self.in_charge(False)
        self._subscribers = [
            session.liveliness().declare_subscriber(
                token_key(fleet, "*", "*", "*"), on_loop(loop, self._on_token), history=True
            ),
            *(session.declare_subscriber(key, put(take)) for key, take in self._hears.items()),
        ]

    def close(self) -> None:
        self._closed = True
        for subscriber in self._subscribers:
            subscriber.undeclare()
        if self._token is not None:
            self._token.undeclare()

    def in_charge(self, yes: bool) -> None:
        """Say by the token whether we are."""
        context = self._context
        before = self._token
        key = token_key(context.settings.fleet, context.settings.name, CHIEF if yes else STANDBY, context.instance)
        self._token = context.z.session.liveliness().declare_token(key)
        if before is not None:
            before.undeclare()

    def _on_token(self, sample: zenoh.Sample) -> None:
        try:
            _, parts = keys.match(str(sample.key_expr))
        except BadKey:
            return
        present = sample.kind == zenoh.SampleKind.PUT
        self._context.charge.token(parts["vehicle"], Token(parts["instance"], parts["autopilot"] == CHIEF), present)
