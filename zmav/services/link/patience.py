"""How long frames may lie on the link until they are taken together: a wake-up of this program costs what ten do.

What is waited for, and what somebody flies by, is taken as it comes, and so is all of an armed vehicle whose frames or
state anybody reads. A disarmed one is read in small batches, and one that nobody reads or commands in larger ones.
"""

from __future__ import annotations

import time

from zmav.services.authority.control import Control, Mover
from zmav.services.authority.lease import Leases
from zmav.services.companion import Companion
from zmav.services.link.timesync import TimeSync
from zmav.services.rates.demand import Demands
from zmav.services.status.state import StateService

AT_REST, UNREAD = 0.1, 0.04
"""s that frames which nobody reads may lie, of a disarmed vehicle and of one that is armed, but not commanded"""
READ = 0.02
"""s that those of a disarmed vehicle may lie which somebody reads"""
LEAST = 0.001
"""s below which nothing is won by it"""
ANSWERED = 0.1
"""s after something was sent within which nothing lies: it may be the answer"""
OF_PERIOD = 0.1
"""of the time between two messages that a reader asked for: so long they may lie for him"""


class Patience:
    """One vehicle's. Called from the link's thread. ``aside``: it may move aside for others by itself."""

    def __init__(
        self,
        companion: Companion,
        control: Control,
        leases: Leases,
        timesync: TimeSync,
        demands: Demands,
        state: StateService,
        *,
        aside: bool,
    ) -> None:
        self._port, self._identity = companion.port, companion.identity
        self._control, self._leases, self._timesync, self._demands = control, leases, timesync, demands
        self._state, self._aside = state, aside

    def __call__(self) -> float:
        """Seconds; 0: take each frame as it comes."""
        port, armed = self._port, self._identity.armed is not False
        if armed and (port.read or self._state.read):
            return 0.0
        if not self._identity.connected or self._awaits() or self._is_commanded(armed):
            return 0.0
        may = min(UNREAD if armed else AT_REST, self._timesync.lag)
        if port.read:
            may = min(may, READ, OF_PERIOD / max(self._demands.fastest, 1.0))
        return may if may >= LEAST else 0.0

    def _awaits(self) -> bool:
        """An answer may come."""
        port = self._port
        return port.awaited > 0 or self._timesync.asking or time.monotonic() - port.spoke < ANSWERED

    def _is_commanded(self, armed: bool) -> bool:
        moved = self._control.mover is not Mover.NOBODY
        return moved or self._leases.holder is not None or (armed and self._aside)
