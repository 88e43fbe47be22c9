"""What the bridge tells its clients in words: STATUSTEXTs in a vehicle's name, from its companion's component."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Iterator

from zmav import wire

COMPANION = 191
"""MAV_COMP_ID_ONBOARD_COMPUTER: so that the autopilot's own words and numbers stay its own"""
SEVERITIES: tuple[wire.Severity, ...] = (
    "emergency",
    "alert",
    "critical",
    "error",
    "warning",
    "notice",
    "info",
    "debug",
)
TOLD = frozenset({"refused", "lease", "pilot", "failsafe", "clash", "certificate", "fault", "mission"})
"""kinds of events that somebody at a station must see, and the autopilot does not say"""
PIECE = 50
LONGEST = 200
AGAIN = 5.0
"""s for which the same words about a vehicle are not repeated"""
BURST, REFILL = 5.0, 2.0
"""words about one vehicle at once, and a second"""
MOST = 1000


class Words:
    """Makes STATUSTEXT frames of texts by ``pack`` (:meth:`ground.gcs.answerer.Ground.pack`). Thread-safe."""

    def __init__(self, pack: Callable[..., bytes]) -> None:
        self._pack = pack
        self._numbers = itertools.count(1)

    def frames(self, sysid: int, severity: wire.Severity, text: str) -> Iterator[bytes]:
        """The frames of one text, in pieces of 50 bytes (https://mavlink.io/en/messages/common.html#STATUSTEXT)."""
        plain = text.replace("µ", "u").replace("—", "-").encode("ascii", "replace").decode()[:LONGEST]
        level = SEVERITIES.index(severity)
        if len(plain) <= PIECE:
            yield self._pack(sysid, COMPANION, "STATUSTEXT", severity=level, text=plain)
            return
        number = next(self._numbers) % 0xFFFF + 1
        # A text ends with a piece that is not full: one of 100 characters has a third, empty piece.
        for seq, start in enumerate(range(0, len(plain) + 1, PIECE)):
            piece = plain[start : start + PIECE]
            yield self._pack(sysid, COMPANION, "STATUSTEXT", severity=level, text=piece, id=number, chunk_seq=seq)


class Limiter:
    """Lets a few words through a second about each vehicle, and the same ones only after a while. Thread-safe."""

    def __init__(self) -> None:
        self._said: dict[tuple[object, str], float] = {}
        self._room: dict[object, tuple[float, float]] = {}
        self._lock = threading.Lock()

    def admits(self, about: object, text: str) -> bool:
        now = time.monotonic()
        with self._lock:
            if len(self._said) > MOST:
                self._said = {said: t for said, t in self._said.items() if now - t < AGAIN}
            if len(self._said) > MOST or len(self._room) > MOST:
                self._said.clear()
                self._room.clear()
            room, since = self._room.get(about, (BURST, now))
            room = min(BURST, room + REFILL * (now - since))
            if now - self._said.get((about, text), -AGAIN) < AGAIN or room < 1.0:
                self._room[about] = room, now
                return False
            self._said[about, text] = now
            self._room[about] = room - 1.0, now
            return True
