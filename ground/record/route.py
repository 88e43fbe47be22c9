"""Where what comes on a key goes: which vehicle's recording, which topic, what else is made of it, who asks for it."""

from __future__ import annotations

import contextlib
from typing import NamedTuple

import msgspec

from ground.record import schemas
from ground.record.schemas import Schema
from zmav import keys, wire
from zmav.errors import BadInput, BadKey
from zmav.mavlink import Dialect

SHARED = "fleet"
"""who is said to own what the whole fleet shares, where history is asked"""


class Asked(NamedTuple):
    """By what history is asked for."""

    fleet: str
    of: str
    what: str


class _Stamped(msgspec.Struct):
    t: float | None = None


_stamped = msgspec.json.Decoder(_Stamped)


class Route:
    """Of one key. Raises :class:`BadKey` for one that is not in the registry or is not recorded."""

    def __init__(self, key: str, dialect: Dialect) -> None:
        channel, parts = keys.match(key)
        if not channel.recorded:
            raise BadKey(f"{key!r} is not recorded: its channel is {channel.name}", field="key", value=key)
        self.key, self.channel = key, channel
        self.fleet, self.vehicle = parts["fleet"], parts.get("vehicle", SHARED)
        self.frames = channel in (keys.RX, keys.TX)
        self.asked = asked_of(key)
        self.base = f"{keys.ROOT}/{self.fleet}/{self.vehicle}"
        self.all_frames = f"{self.base}/mav/{channel.name}"
        """topic of every frame of the vehicle, in one direction"""
        self.message = dialect.by_name.get(parts["msg"]) if self.frames else None

    def schema(self, first: bytes) -> Schema:
        """Of the documents that come on this key; ``first`` is the first one of a file: signals have names of
        their own, and readers offer what the schema lists.
        """
        with contextlib.suppress(BadInput):
            if self.channel is keys.AGENT_OUT:
                return schemas.of_signals(wire.decode(first, wire.Signals, "signals"))
        if self.channel is keys.FLEET:
            known = {"origin": wire.Origin}.get(self.asked.what)
            return schemas.of_payload(known) if known else schemas.of_any(f"zmav.{self.asked.what}")
        kind = self.channel.payload
        return schemas.of_payload(kind) if kind else schemas.of_any(f"zmav.{self.channel.name}")

    def location(self, document: bytes) -> bytes | None:
        """A state's place for a map; None of what is no such thing."""
        with contextlib.suppress(BadInput):
            if self.channel is keys.STATE:
                return schemas.location(wire.decode(document, wire.VehicleState, "state"))
        return None


def stamp(document: bytes) -> float | None:
    """Its source's time in UTC seconds, 0 where it gives none; None where it is no JSON object."""
    try:
        return _stamped.decode(document).t or 0.0
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        with contextlib.suppress(msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            return 0.0 if isinstance(msgspec.json.decode(document), dict) else None
        return None


def asked_of(key: str) -> Asked:
    """By what the history of a key is asked for. Raises :class:`BadKey` for one that is not in the registry."""
    channel, parts = keys.match(key)
    return Asked(parts["fleet"], parts.get("vehicle", SHARED), _what(channel, parts))


def _what(channel: keys.Channel, parts: dict[str, str]) -> str:
    if channel is keys.RX:
        return parts["msg"]
    return parts["topic"] if channel is keys.FLEET else channel.name
