"""Proofs of origin in Zenoh's queries and samples."""

from __future__ import annotations

import zenoh

from zmav import keys, wire
from zmav.errors import Forbidden
from zmav.trust.verify import BUSY


def attached(message: zenoh.Query | zenoh.Sample) -> bytes | None:
    """The attachment; None where there is none."""
    found = message.attachment
    return None if found is None else found.to_bytes()


def refuse(query: zenoh.Query, error: Forbidden) -> None:
    """Tell whoever asked; who was not looked at for want of time gets no answer, and asks again."""
    with query:
        if error.detail.get("reason") != BUSY:
            query.reply_err(wire.error_body(error), encoding=keys.JSON)
