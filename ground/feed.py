"""Frames of the whole fleet as they come: what the bridge, the gateway, the recorder and the viewer read.

feed = Feed(z.session, z.is_vehicle, lambda origin, frame: ..., fleet="demo", vehicles=["quad*"])

Nothing is decoded here.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import zenoh

from zmav import keys
from zmav.direct import direct
from zmav.errors import BadConfig, BadKey

MOST = 8192
"""origins: invented keys must not fill the memory"""


class Origin(NamedTuple):
    """Where a frame came from: the parts of its key."""

    fleet: str
    vehicle: str
    sysid: int
    compid: int
    message: str
    """by name; ``UNKNOWN_44000`` where the vehicle's dialect lacks it"""
    key: str


OnFrame = Callable[[Origin, bytes], None]


class Feed:
    """Calls ``on_frame(origin, frame)`` on a thread of Zenoh's for every frame, in the order in which they came, one at
    a time.

    ``on_frame`` must be quick and must not raise: what it does not take in time is held back in the session, and then
    dropped by the routers. What comes under a name that ``is_vehicle`` denies is left out. ``frame`` are the bytes as
    the vehicle sent them. Raises :class:`~zmav.errors.BadKey` for vehicles that cannot stand in a key
    expression.
    """

    def __init__(
        self,
        session: zenoh.Session,
        is_vehicle: keys.IsVehicle,
        on_frame: OnFrame,
        fleet: str = "*",
        vehicles: Sequence[str] = ("*",),
    ) -> None:
        self._is_vehicle, self._on_frame = is_vehicle, on_frame
        self._replay = keys.is_replay(fleet)
        self._origins: dict[str, Origin] = {}
        self._lock = threading.Lock()
        """samples come on more than one thread of Zenoh's"""
        self.frames = 0
        self.foreign = 0
        """samples left out because their key is none of a vehicle's frame, or a recording's where vehicles are heard"""
        self._wanted = apart(keys.expression(f"{vehicle}/mav/rx/*/*/*", fleet) for vehicle in vehicles)
        self._subscribers = [
            session.declare_subscriber(str(key), direct(functools.partial(self._on_sample, index)))
            for index, key in enumerate(self._wanted)
        ]

    def close(self) -> None:
        for subscriber in self._subscribers:
            subscriber.undeclare()
        self._subscribers.clear()

    def __enter__(self) -> Feed:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _on_sample(self, index: int, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        with self._lock:
            origin = self._origins.get(key) or self._new_origin(key)
            if origin is None or not self._is_vehicle(origin.fleet, origin.vehicle):
                self.foreign += 1
                return
            if index and any(wanted.intersects(sample.key_expr) for wanted in self._wanted[:index]):
                return  # an expression before this one brings it, too
            self.frames += 1
            self._on_frame(origin, sample.payload.to_bytes())

    def _new_origin(self, key: str) -> Origin | None:
        origin = origin_of(key)
        if origin is None or keys.is_replay(origin.fleet) != self._replay:
            return None
        if len(self._origins) < MOST and self._is_vehicle(*origin[:2]):
            self._origins[key] = origin
        return origin


def apart(expressions: Iterable[str]) -> list[zenoh.KeyExpr]:
    """Key expressions without those that another one includes: what both want would come twice."""
    kept: list[zenoh.KeyExpr] = []
    for each in map(zenoh.KeyExpr, sorted(set(expressions))):
        if not any(other.includes(each) for other in kept):
            kept = [other for other in kept if not each.includes(other)] + [each]
    return kept


def origin_of(key: str) -> Origin | None:
    """The parts of a frame's key (``mav/rx``); None for any other key, or one whose ids are no ids."""
    try:
        channel, parts = keys.match(key)
    except BadKey:
        return None
    ids = parts.get("sys", ""), parts.get("comp", "")
    if channel is not keys.RX or not all(each.isdecimal() and len(each) <= 3 for each in ids):
        return None
    sysid, compid = map(int, ids)
    if sysid > 255 or compid > 255:
        return None
    return Origin(parts["fleet"], parts["vehicle"], sysid, compid, parts["msg"], key)


def patterns(vehicles: Sequence[str]) -> list[str]:
    """Patterns of vehicles' names; BadConfig for what can be none."""
    for pattern in vehicles:
        if not keys.NAMES.match(pattern):
            text = f"no vehicle can be called {pattern!r}: use lower-case letters, digits, '_', '-' and '*'"
            raise BadConfig(text, field="vehicles", value=pattern, expected="[a-z0-9_*-]+")
    return list(vehicles)
