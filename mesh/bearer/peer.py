"""A neighbour as a bearer sees it: the paths to it, how good each is, the one that is taken, and the flows with its
router.

A path is measured by small probes that its far end echoes. Among paths, those that carry (few losses) go before those
that limp, and these before those that are silent; within each kind the cheaper one goes first. The path in use is left
at once when it falls silent; one that has become better must stay so for a while, and the longer, the more often it has
fallen silent lately.
"""

from __future__ import annotations

import collections
import enum
import math
import secrets
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from mesh.bearer.flows import Local, Opened, Taken
from mesh.bearer.header import DATA_HEAD, PROBE_HEAD, overhead
from mesh.bearer.port import Address, RadioPort
from mesh.bearer.shaper import Bucket

INTERVAL = 0.08
"""s between probes on the path in use"""
SEARCH_INTERVAL = 0.3
"""... while it is silent"""
IDLE_INTERVAL = 1.0
"""... and on the others"""
SHARE = 0.02
"""of a radio's budget that the probes of one path may take; a slow radio is probed more rarely"""
LATE = 5.0
"""intervals without a word after which a path is silent"""
LOST = 1.0
"""s, at least, after which an echo counts as lost: a loaded radio may answer late"""
WINDOW = 20
"""probes that the loss is reckoned over"""
LIMPS, CARRIES = 0.3, 0.1
"""loss from which a path limps, and below which it carries again"""
HOLD, LONGEST_HOLD = 3.0, 60.0
"""s that a better path must stay better before it is taken; doubled with every silence"""
FORGIVEN = 60.0
"""s in use without a silence after which a path's hold is the shortest again"""
MEMORY = 64
"""echoes waited for"""


class Health(enum.IntEnum):
    """How a path is; the lower, the better."""

    CARRIES = 0
    LIMPS = 1
    SILENT = 2


class Path:
    """Out of one of our radios to one address. ``name`` is the radio's; ``cost`` as the fleet file has it.

    ``learned``: somebody called from there, and anybody can; such a path is for when all others are silent.
    """

    def __init__(self, name: str, cost: int, budget: float | None = None, *, learned: bool = False) -> None:
        self.name, self.cost, self.learned = name, cost, learned
        size = overhead("") + PROBE_HEAD.size
        self._least = size / (SHARE * budget) if budget else 0.0
        self._used: float | None = None
        self.heard: float | None = None
        self.hold = HOLD
        self._number = 0
        self._waiting: collections.OrderedDict[int, tuple[int, float]] = collections.OrderedDict()
        self._outcomes: collections.deque[bool] = collections.deque(maxlen=WINDOW)
        self.health = Health.SILENT
        """as it was last judged"""
        self._since = -math.inf
        self._next = 0.0

    def use(self, now: float) -> None:
        """It is the path taken, from now on."""
        self._used = now
        self.hurry(now)

    def leave(self) -> None:
        """It is no longer the path taken."""
        self._used = None

    @property
    def interval(self) -> float:
        """s between probes: the path in use is watched closely."""
        if self._used is None:
            return max(IDLE_INTERVAL, self._least)
        return max(SEARCH_INTERVAL if self.health is Health.SILENT else INTERVAL, self._least)

    @property
    def _patience(self) -> float:
        """s of silence before it counts as silent, on the path in use the same whether it is or not."""
        return LATE * max(IDLE_INTERVAL if self._used is None else INTERVAL, self._least)

    # Probing.

    def due(self, now: float) -> float:
        """Seconds until the next probe."""
        return max(self._next - now, 0.0)

    def hurry(self, now: float) -> None:
        """Have it probed at once: somebody wants to know."""
        self._next = min(self._next, now)

    def ask(self, now: float) -> tuple[int, int]:
        """The next probe's nonce and number."""
        self._number += 1
        nonce = secrets.randbits(64)
        self._waiting[nonce] = (self._number, now)
        if len(self._waiting) > MEMORY:
            self._waiting.popitem(last=False)
        self._next = now + self.interval
        return nonce, self._number

    def echoed(self, nonce: int, number: int, now: float) -> bool:
        """An echo; False for one that nobody waits for."""
        asked = self._waiting.pop(nonce, None)
        if asked is None or asked[0] != number & 0xFFFFFFFF:
            return False
        self._outcomes.append(True)
        self.word(now)
        return True

    def word(self, now: float) -> None:
        """Anything was heard on it: what is carried is as good a sign of life as an echo."""
        self.heard = now

    # Judging.

    def judge(self, now: float) -> Health:
        """How it is now."""
        late = max(LOST, self._patience)
        while self._waiting:
            nonce, (_, asked) = next(iter(self._waiting.items()))
            if now - asked < late:
                break
            del self._waiting[nonce]
            self._outcomes.append(False)
        before, self.health = self.health, self._judged(now)
        if self.health is not before:
            self._since = now
            if before is Health.SILENT:
                self._outcomes.clear()  # what was lost in the silence says nothing of how it carries now
            elif self.health is Health.SILENT:
                self.hold = min(2.0 * self.hold, LONGEST_HOLD)
                self.hurry(now)
        elif self.health is Health.CARRIES and now - self._since > FORGIVEN:
            self.hold = HOLD
        return self.health

    def _judged(self, now: float) -> Health:
        # One that has just been taken was listened to more rarely until now.
        if self.heard is None or now - max(self.heard, self._used or 0.0) >= self._patience:
            return Health.SILENT
        if self.health is Health.SILENT and self.heard <= self._since:
            return Health.SILENT  # its patience grew because it was left, and nothing has come since
        if self.health is Health.LIMPS:
            return Health.CARRIES if self.loss < CARRIES else Health.LIMPS
        return Health.LIMPS if self.loss > LIMPS else Health.CARRIES

    @property
    def loss(self) -> float:
        return 1.0 - sum(self._outcomes) / len(self._outcomes) if self._outcomes else 0.0

    def better_for(self, now: float) -> float:
        """s that it has been as it is."""
        return now - self._since


class Choice:
    """Which of a neighbour's paths is taken."""

    def __init__(self) -> None:
        self.current: Path | None = None

    def judge(self, paths: Sequence[Path], now: float) -> Path | None:
        """The path to take now; None while there are none."""
        for path in paths:
            path.judge(now)
        best = min(paths, key=_rank, default=None)
        current = self.current
        if best is None or best is current or (current in paths and not self._must(current, best, now)):
            return self.current if current in paths else None
        if current is not None:
            current.leave()
        self.current = best
        best.use(now)
        return best

    def _must(self, current: Path | None, best: Path, now: float) -> bool:
        """Leave the one for the other: at once where nothing comes any more, else when it has been good for a while."""
        if current is None:
            return True
        mine, other = current.health, best.health
        if mine is Health.SILENT:
            return other is not Health.SILENT
        if current.learned and not best.learned:
            return True
        return best.better_for(now) >= best.hold


def _rank(path: Path) -> tuple[bool, bool, Health, int]:
    """The lower, the better."""
    return path.health is Health.SILENT, path.learned, path.health, path.cost


ECHOES = 4000.0
"""bytes/s of echoes to one address: about a hundred, and no probe that is answered takes more from the budget"""
LEARNED = 4
"""addresses of a neighbour beside those in the fleet file: behind a NAT they change"""
QUIC_LEAST = 1200
"""bytes of a datagram that QUIC needs (RFC 9000, section 14)"""
FORGET = 30.0
"""s of silence after which a learned address is forgotten"""


@dataclass(eq=False)
class Route:
    """One path and where it leads."""

    port: RadioPort
    to: Address
    path: Path
    echoes: Bucket
    proven: bool = True
    """somebody there has echoed what only he was asked; those of the fleet file need no proof"""
    since: float = 0.0


class RouteStatus(NamedTuple):
    """A path for people to look at."""

    address: str
    in_use: bool
    health: Health


class Peer:
    """One neighbour. Lives on the bearer's thread."""

    def __init__(self, name: str, tag: int, router: Local, *, opens: bool) -> None:
        self.name, self.tag = name, tag
        self.routes: list[Route] = []
        self.opened = Opened() if opens else None
        self.taken = Taken(router)
        self.choice = Choice()
        self.route: Route | None = None
        """where data goes now"""
        self.largest = 65535
        """bytes of the router's datagrams that every path carries: with larger ones, QUIC would take a change of paths
        for a black hole, and need a second to find out"""

    def add(self, port: RadioPort, to: Address, cost: int, now: float, *, learned: bool = False) -> Route | None:
        """A path to it; None where too many have been learned. One that was, and is not proven, makes room."""
        known = [route for route in self.routes if route.path.learned]
        if learned and len(known) >= LEARNED:
            unproven = next((route for route in known if not route.proven), None)
            if unproven is None:
                return None
            self.routes.remove(unproven)
        path = Path(port.name, cost, port.budget, learned=learned)
        route = Route(port, to, path, Bucket(ECHOES, now), not learned, now)
        self.routes.append(route)
        return route

    def find(self, port: RadioPort, source: Address) -> Route | None:
        """The path on which something came."""
        for route in self.routes:
            if route.port is port and route.to == source:
                return route
        return None

    def judge(self, now: float) -> None:
        """Choose the path again, and forget learned ones that have long been silent."""
        self.routes = [route for route in self.routes if not self._forgotten(route, now)]
        proven = {route.path: route for route in self.routes if route.proven}
        chosen = self.choice.judge(list(proven), now)
        self.route = proven[chosen] if chosen is not None else None
        least = min((route.port.largest for route in proven.values()), default=65535)
        self.largest = max(least - DATA_HEAD.size, QUIC_LEAST)

    def _forgotten(self, route: Route, now: float) -> bool:
        heard = route.path.heard or route.since
        return route.path.learned and now - heard > FORGET

    def status(self) -> list[RouteStatus]:
        return [RouteStatus(f"{r.to[0]}:{r.to[1]}", r is self.route, r.path.health) for r in self.routes if r.proven]

    def close(self) -> None:
        if self.opened is not None:
            self.opened.close()
        self.taken.close()
