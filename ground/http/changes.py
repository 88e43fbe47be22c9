"""Of each key what changed since the last message to one socket, for readers that want all of it and little to carry.

    < {"key": "zmav/demo/quad1/state", "t": 1790000000.1, "n": 0, "value": {...}, "alarms": []}
    < {"key": "zmav/demo/quad1/state", "t": 1790000000.3, "n": 1, "changes": {"value": {"t": ..., "local": [...]}}}

``n`` counts a key's messages. Who misses one asks for the whole again; it comes by itself where the last message is old
or a field has gone. Figures are rounded to what an instrument shows: 1e-7 degrees, otherwise 1e-3.
"""

from __future__ import annotations

import time
from typing import Any

import msgspec

DEGREES, OTHERS = 7, 3
"""decimals"""
MOST = 4096
"""keys of one socket; one more, and each begins again"""


class Sent:
    """What a reader has of a key."""

    __slots__ = ("at", "document", "n")

    def __init__(self, document: dict[str, Any]) -> None:
        self.document, self.n, self.at = document, 0, time.monotonic()


class Changes:
    """What one subscription of one socket has been sent. Lives on the event loop."""

    late = 2.0
    """s after which what a reader has is old, and it gets all of it again"""

    def __init__(self) -> None:
        self._sent: dict[str, Sent] = {}

    def forget(self, key: str) -> None:
        """The next message of that key is a whole one."""
        self._sent.pop(key, None)

    def message(self, document: dict[str, Any]) -> dict[str, Any]:
        """What to send in place of a whole ``{"key", "t", "value", ...}``, whose figures are :func:`rounded`."""
        key, now = document["key"], time.monotonic()
        sent = self._sent.get(key)
        found = changed(sent.document, document) if sent is not None and now - sent.at < self.late else None
        if sent is None or found is None:
            if len(self._sent) >= MOST:
                self._sent.clear()
            self._sent[key] = Sent(document)
            return {**document, "n": 0}
        sent.document, sent.n, sent.at = document, sent.n + 1, now
        found.pop("t", None)
        return {"key": key, "t": document["t"], "n": sent.n, "changes": found}


def changed(before: dict[str, Any], after: dict[str, Any]) -> dict[str, Any] | None:
    """The fields of ``after`` that ``before`` has otherwise or not at all, within objects, too; None: one has gone."""
    if before.keys() - after.keys():
        return None
    found: dict[str, Any] = {}
    for name, value in after.items():
        old = before.get(name)
        if isinstance(value, dict) and isinstance(old, dict):
            inside = changed(old, value)
            if inside is None:
                return None
            if inside:
                found[name] = inside
        elif name not in before or old != value:
            found[name] = value
    return found


def rounded(value: Any, decimals: int = OTHERS) -> Any:
    """Raw JSON decoded, and every figure in it rounded."""
    if isinstance(value, msgspec.Raw):
        try:
            return rounded(msgspec.json.decode(value))
        except RecursionError:  # it is nested deeper than anything of ours
            return {"hex": bytes(value).hex()}
    if isinstance(value, dict):
        return {name: rounded(each, DEGREES if name.endswith("_deg") else OTHERS) for name, each in value.items()}
    if isinstance(value, list):
        return [rounded(each, decimals) for each in value]
    return round(value, decimals) if isinstance(value, float) else value
