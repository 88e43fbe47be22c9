"""Who moves the vehicle now: one value, which all that may move it set, and all that must know it read.

It is about what this program does. A vehicle that lands, returns or flies a mission by itself is moved by nobody here.
"""

from __future__ import annotations

import enum
import threading

from zmav.errors import Refused


class Mover(enum.Enum):
    """What moves a vehicle. Of several that claim it the first named here has it."""

    PILOT = "pilot"
    """his switch keeps every agent off; who only changes the mode leaves it to nobody"""
    ORDER = "order"
    """one of the orders, until it has ended"""
    TARGET = "target"
    """a position target that is led there, after the order that gave it"""
    SEGMENT = "segment"
    """a committed segment, which ends at rest by itself"""
    STREAM = "stream"
    """setpoints, fresh or waiting for their mode"""
    HOLD = "hold"
    """the watchdog, after the end of a stream or a segment"""
    FAILSAFE = "failsafe"
    """the watchdog, until the autopilot shows the mode that follows a hold of ``land_after``"""
    NOBODY = "nobody"


RANKS = {mover: rank for rank, mover in enumerate(Mover)}
OURS = (Mover.ORDER, Mover.TARGET, Mover.SEGMENT, Mover.STREAM, Mover.HOLD)
"""what a pilot takes the vehicle from"""


class Control:
    """Of one vehicle. Any thread.

    :attr:`mover` is for what refuses and what is shown. What has to let go asks :meth:`claimed`: a stronger claim hides
    a weaker one, and does not end it.
    """

    def __init__(self, vehicle: str) -> None:
        self._vehicle = vehicle
        self._claims: dict[object, tuple[Mover, str]] = {}
        self._claiming = threading.Lock()
        self._now = (Mover.NOBODY, "")

    @property
    def mover(self) -> Mover:
        return self._now[0]

    @property
    def pilot(self) -> str | None:
        """Why no agent may have the vehicle; None: one may."""
        mover, why = self._now
        return why if mover is Mover.PILOT else None

    @property
    def ours(self) -> bool:
        """Something of ours moves it, or would, had the pilot not taken it."""
        return self.claimed(*OURS)

    def claimed(self, *movers: Mover) -> bool:
        """One of them moves it, or would, had no stronger one claimed it."""
        with self._claiming:
            return any(mover in movers for mover, _ in self._claims.values())

    def take(self, by: object, mover: Mover, why: str = "") -> None:
        """``by`` moves the vehicle from now on as ``mover``; its earlier claim ends."""
        with self._claiming:
            self._claims[by] = mover, why
            self._judge()

    def leave(self, by: object) -> None:
        """``by`` moves it no more."""
        with self._claiming:
            self._claims.pop(by, None)
            self._judge()

    def _judge(self) -> None:
        self._now = min(self._claims.values(), key=lambda claim: RANKS[claim[0]], default=(Mover.NOBODY, ""))

    def check_pilot(self) -> None:
        """Raise :class:`Refused` while the pilot's switch says that he has it."""
        if self.pilot is not None:
            raise Refused(f"the pilot has it: {self.pilot}", vehicle=self._vehicle, count="pilot")

    def check_order(self) -> None:
        """Raise :class:`Refused` while an order moves it: a setpoint would undo a landing just ordered."""
        if self.mover is Mover.ORDER:
            raise Refused("an order moves the vehicle: setpoints are followed when it has ended", count="busy")
