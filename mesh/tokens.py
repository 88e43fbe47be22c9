"""Which liveliness tokens there are, asked from any thread but Zenoh's own."""

from __future__ import annotations

import threading
from typing import Any

import zenoh
from zenoh import handlers


def find_tokens(session: zenoh.Session, key: str, timeout: float) -> list[str]:
    """The keys of those tokens that ``session`` finds within ``timeout`` seconds.

    With the default channel, which holds 256 replies, a router that knows more would wait in ``get`` for ever: it
    answers itself before anybody can read.
    """
    found: list[str] = []
    over = threading.Event()

    def on_reply(reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            found.append(str(reply.ok.key_expr))

    handler: Any = handlers.Callback(on_reply, over.set, indirect=False)
    session.liveliness().get(key, handler, timeout=timeout)
    over.wait(timeout + 1.0)
    return found
