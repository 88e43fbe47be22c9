"""Frames of the whole fleet as they come: what the bridge, the gateway, the recorder and the viewer read.

feed = Feed(z.session, z.is_vehicle, lambda origin, frame: ..., fleet="demo", vehicles=["quad*"], messages=["ATTITUDE"])

Nothing is decoded here. Where one autopilot is heard over two links, say by its companion and by a radio on the ground,
each of its frames comes once: the first one that came.
"""

from __future__ import annotations

import functools
import threading
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import zenoh

from zmav import keys
from zmav.errors import BadKey

WINDOW = 1.0
"""s within which the same bytes of the same system, heard of another vehicle's agent, are the same frame"""
MOST = 8192
"""frames remembered for that, and origins: invented keys must not fill the memory"""


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
    the vehicle sent them. Without ``once`` a frame that is heard over two links comes twice, for who chooses a link
    himself. Raises :class:`~zmav.errors.BadKey` for vehicles or messages that cannot stand in a key expression.
    """

    def __init__(
        self,
        session: zenoh.Session,
        is_vehicle: keys.IsVehicle,
        on_frame: OnFrame,
        fleet: str = "*",
        vehicles: Sequence[str] = ("*",),
        messages: Sequence[str] = ("*",),
        once: bool = True,
    ) -> None:
        self._is_vehicle, self._on_frame, self._once = is_vehicle, on_frame, once
        self._replay = keys.is_replay(fleet)
        self._origins: dict[str, Origin] = {}
        self._lock = threading.Lock()
        """each subscriber has a thread of its own"""
        self._owners: dict[tuple[int, int], str] = {}
        self._shared: set[tuple[int, int]] = set()
        """systems that more than one vehicle's agent speaks for"""
        self._seen: dict[bytes, tuple[str, float]] = {}
        self.frames = 0
        self.twice = 0
        """frames left out because they had come over another link already"""
        self.foreign = 0
        """samples left out because their key is none of a vehicle's frame, or a recording's where vehicles are heard"""
        wanted = {
            keys.expression(f"{vehicle}/mav/rx/*/*/{message}", fleet) for vehicle in vehicles for message in messages
        }
        self._wanted = _apart(sorted(wanted))
        self._subscribers = [
            session.declare_subscriber(str(key), functools.partial(self._on_sample, index))
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
            if origin is None or keys.is_replay(origin.fleet) != self._replay or not self._is_vehicle(*origin[:2]):
                self.foreign += 1
                return
            if index and any(wanted.intersects(sample.key_expr) for wanted in self._wanted[:index]):
                return  # an expression before this one brings it, too
            frame = sample.payload.to_bytes()
            if self._shared and origin[2:4] in self._shared and self._came_already(origin, frame):
                self.twice += 1
                return
            self.frames += 1
            self._on_frame(origin, frame)

    def _new_origin(self, key: str) -> Origin | None:
        origin = origin_of(key)
        if origin is None or len(self._origins) >= MOST or not self._is_vehicle(*origin[:2]):
            return origin
        self._origins[key] = origin
        place = (origin.sysid, origin.compid)
        if (
            self._once
            and self._owners.setdefault(place, f"{origin.fleet}/{origin.vehicle}") != f"{origin.fleet}/{origin.vehicle}"
        ):
            self._shared.add(place)
        return origin

    def _came_already(self, origin: Origin, frame: bytes) -> bool:
        now, owner = time.monotonic(), f"{origin.fleet}/{origin.vehicle}"
        before = self._seen.get(frame)
        if before is not None and before[0] != owner and now - before[1] < WINDOW:
            return True
        self._seen.pop(frame, None)  # the oldest are to stand first
        self._seen[frame] = (owner, now)
        if len(self._seen) > MOST:
            del self._seen[next(iter(self._seen))]
        return False


def _apart(expressions: Sequence[str]) -> list[zenoh.KeyExpr]:
    """Key expressions without those that another one includes: what both want would come twice."""
    kept: list[zenoh.KeyExpr] = []
    for each in map(zenoh.KeyExpr, expressions):
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
