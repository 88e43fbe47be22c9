"""Questions that reach all who claim to answer: a program that swallows one keeps nobody else from answering."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import zenoh

from zmav import keys
from zmav.services.queries.proven import attached
from zmav.trust.proof import ANSWERS, Signer

OnState = Callable[[str, bytes, "bytes | None", bytes], object]
"""``on_state(key, payload, proof, challenge)``"""


def ask_everybody(
    session: zenoh.Session,
    qos: keys.Qos,
    key: str,
    handler: Any,
    *,
    timeout: float,
    payload: bytes = b"",
    attachment: bytes | None = None,
) -> Any:
    """Zenoh's ``get`` of all that match; each answer by itself, also where their keys are alike.

    ``handler`` as Zenoh takes it, or None: the replies come as a channel then.
    """
    return session.get(
        key,
        handler,
        payload=payload,
        attachment=attachment,
        timeout=timeout,
        encoding=keys.JSON,
        target=zenoh.QueryTarget.ALL,
        consolidation=zenoh.ConsolidationMode.NONE,
        **qos.options(),
    )


def challenge_vehicle(
    session: zenoh.Session, place: tuple[str, str], on_state: OnState, *, timeout: float, signer: Signer | None = None
) -> None:
    """Ask a vehicle for its state over a challenge, which only that vehicle can sign, and only now.

    ``on_state`` is called on Zenoh's thread with each answer, of anybody. ``signer``: who asks, for vehicles that
    want to know.
    """
    key, challenge = keys.STATE.key(*place), os.urandom(ANSWERS)

    def on_reply(reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            on_state(key, reply.ok.payload.to_bytes(), attached(reply.ok), challenge)

    proof = signer.sign(key, challenge, introduce=True) if signer else None
    ask_everybody(session, keys.STATE.qos, key, on_reply, timeout=timeout, payload=challenge, attachment=proof)
