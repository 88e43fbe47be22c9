"""What is wrong with the sensors of each vehicle of a fleet, on top of their noise."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np

from zmav.sim.arrays import Array, Flags
from zmav.sim.environment import Vector


class Trouble(msgspec.Struct, frozen=True, kw_only=True):
    """One cause's share in it; with its defaults nothing is wrong.

    ``gps_shift``: solutions are off by that, m NED; ``compass_turn``: the compass reads as if the nose pointed that
    much farther to the right, rad; ``baro_shift``: heights read that much too high, m; ``range_shift``: m;
    ``vibration``: of the accelerometers, m/s^2 root mean square; ``clipping``: how often a second they reach their
    limit.
    """

    gps_lost: bool = False
    gps_shift: Vector = (0.0, 0.0, 0.0)
    compass_lost: bool = False
    compass_turn: float = 0.0
    baro_lost: bool = False
    baro_shift: float = 0.0
    range_lost: bool = False
    range_shift: float = 0.0
    vibration: float = 0.0
    clipping: float = 0.0
    pitot_lost: bool = False


FINE = Trouble()


class Troubles:
    """Of N vehicles, whatever their causes: a column each (shifts add up), named as in :class:`Trouble`; ``any`` tells
    whether there is something at all. ``told`` are called with the index of a vehicle whose column has changed.
    """

    def __init__(self, vehicles: int) -> None:
        self.gps_lost: Flags = np.zeros(vehicles, dtype=bool)
        self.gps_shift: Array = np.zeros((3, vehicles))
        self.compass_lost: Flags = np.zeros(vehicles, dtype=bool)
        self.compass_turn: Array = np.zeros(vehicles)
        self.baro_lost: Flags = np.zeros(vehicles, dtype=bool)
        self.baro_shift: Array = np.zeros(vehicles)
        self.range_lost: Flags = np.zeros(vehicles, dtype=bool)
        self.range_shift: Array = np.zeros(vehicles)
        self.vibration: Array = np.zeros(vehicles)
        self.clipping: Array = np.zeros(vehicles)
        self.pitot_lost: Flags = np.zeros(vehicles, dtype=bool)
        self.any: list[bool] = [False] * vehicles
        self.told: list[Callable[[int], None]] = []
        self._causes: list[dict[str, Trouble]] = [{} for _ in range(vehicles)]

    def put(self, index: int, cause: str, trouble: Trouble) -> None:
        """That is what ``cause`` does to one vehicle's sensors from now on; :data:`FINE`: nothing any more."""
        causes = self._causes[index]
        if trouble == FINE:
            causes.pop(cause, None)
        else:
            causes[cause] = trouble
        together = list(causes.values())
        self.any[index] = bool(together)
        for column, lost in (
            (self.gps_lost, [t.gps_lost for t in together]),
            (self.compass_lost, [t.compass_lost for t in together]),
            (self.baro_lost, [t.baro_lost for t in together]),
            (self.range_lost, [t.range_lost for t in together]),
            (self.pitot_lost, [t.pitot_lost for t in together]),
        ):
            column[index] = any(lost)
        for axis in range(3):
            self.gps_shift[axis, index] = sum(t.gps_shift[axis] for t in together)
        self.compass_turn[index] = sum(t.compass_turn for t in together)
        self.baro_shift[index] = sum(t.baro_shift for t in together)
        self.range_shift[index] = sum(t.range_shift for t in together)
        self.vibration[index] = sum(t.vibration for t in together)
        self.clipping[index] = sum(t.clipping for t in together)
        for tell in self.told:
            tell(index)

    def hand_on(self, other: Troubles) -> None:
        """Let the same be wrong with other sensors of these vehicles."""
        for index, causes in enumerate(self._causes):
            for cause, trouble in causes.items():
                other.put(index, cause, trouble)
