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
        self.compass_lost, self.baro_lost, self.range_lost, self.pitot_lost = (self.gps_lost.copy() for _ in range(4))
        self.gps_shift: Array = np.zeros((3, vehicles))
        self.compass_turn: Array = np.zeros(vehicles)
        self.baro_shift, self.range_shift, self.vibration, self.clipping = (np.zeros(vehicles) for _ in range(4))
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
        self.any[index] = bool(causes)
        for name in Trouble.__struct_fields__:
            # Flags are set by any of the causes; numbers add up.
            getattr(self, name)[..., index] = np.sum([getattr(each, name) for each in (FINE, *causes.values())], axis=0)
        for tell in self.told:
            tell(index)

    def hand_on(self, other: Troubles) -> None:
        """Let the same be wrong with other sensors of these vehicles."""
        for index, causes in enumerate(self._causes):
            for cause, trouble in causes.items():
                other.put(index, cause, trouble)
