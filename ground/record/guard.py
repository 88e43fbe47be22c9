"""What keeps a recording from those who would take it for orders: real vehicles.

Frames for vehicles, orders and rosters are never played. Setpoints, and what the whole fleet shares (goals, plans, the
origin), only while no vehicle is there that could follow them; a vehicle's own words only while it is not there itself.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection

import zenoh

from zmav import keys
from zmav.client import Client
from zmav.errors import BadKey, Clash


class Guard:
    """Watches who is in a fleet. ``names`` are those of the recorded vehicles there.

    ``come(name)`` is called, on a thread of Zenoh's, when a vehicle turns up that is being played.
    """

    def __init__(self, z: Client, names: Collection[str], force: bool, come: Callable[[str], None]) -> None:
        self._z, self._names, self._force, self._come = z, set(names), force, come
        self._ours: set[str] = set()
        self._tokens: dict[str, set[str]] = {}
        self._lock = threading.Lock()
        self._live: frozenset[str] = frozenset(v.name for v in z.fleet() if z.present(v.name, z.fleet_name))
        """vehicles that are there, and are none of ours; those of the beginning for good"""
        self._first = self._live
        self._subscriber: zenoh.Subscriber[None] | None = None

    def check(self) -> None:
        """Raise :class:`Clash` where a vehicle is there that would be played."""
        there = sorted(self._live & self._names)
        if there and not self._force:
            words = f"{', '.join(there)} {'is' if len(there) == 1 else 'are'} there"
            raise Clash(
                f"{words}: --as 'old-*' plays the recording under other names; --force plays it nevertheless, without"
                " setpoints, and whoever reads then hears both",
                vehicles=there,
            )

    def watch(self, ours: Collection[str]) -> None:
        """From now on see who comes. ``ours``: instances that are this program's own."""
        self._ours = set(ours)
        key = keys.ALIVE.key(
            self._z.fleet_name, "*", role=keys.VEHICLE, sys="*", autopilot="*", uid="*", instance="*"
        )  # fmt: skip
        self._subscriber = self._z.session.liveliness().declare_subscriber(key, self._on_token, history=True)

    def close(self) -> None:
        if self._subscriber is not None:
            self._subscriber.undeclare()
            self._subscriber = None

    def _on_token(self, sample: zenoh.Sample) -> None:
        try:
            _, parts = keys.match(str(sample.key_expr))
        except BadKey:  # nobody's that could be played
            return
        if parts["instance"] in self._ours:
            return
        name = parts["vehicle"]
        with self._lock:
            tokens = self._tokens.setdefault(name, set())
            if sample.kind == zenoh.SampleKind.PUT:
                tokens.add(str(sample.key_expr))
            else:
                tokens.discard(str(sample.key_expr))
            live = self._first | {n for n, held in self._tokens.items() if held}
            come, self._live = live - self._live, frozenset(live)
        if name in come and name in self._names and not self._force:
            self._come(name)

    def may(self, channel: keys.Channel, key: str, vehicle: str | None) -> bool:
        """Whether a sample may be put on ``key``; ``vehicle`` None: it is nobody's own."""
        live = self._live
        if channel.kind not in ("pub", "put") or channel is keys.TX:
            return False
        if vehicle is None:
            return not live and not key.endswith(f"/{keys.ROSTER}")
        if channel.kind == "put":
            return vehicle not in live
        return vehicle not in live or self._force
