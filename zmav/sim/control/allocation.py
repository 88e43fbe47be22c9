"""From torque and thrust to rotors, as PX4's allocator for multirotors does it: a pseudo-inverse, and sequential
desaturation of what does not fit (roll and pitch before height, height before yaw).

https://docs.px4.io/v1.16/en/concept/control_allocation.html. Torques are normalised as there: one of roll or pitch
turns the rotors up and down by about their whole range, one of yaw the rotor with the largest share by exactly that.
"""

from __future__ import annotations

import numpy as np

from zmav.sim.arrays import Array, clamp
from zmav.sim.dynamics.airframe import Airframe

YAW_ROOM = 0.15  # of the range above the upper end, which yaw may ask for before thrust gives way
EPSILON = 1e-6


class Allocator:
    """For N vehicles of one airframe with M rotors. ``torque_nm`` (3,): what a normalised torque of one is."""

    def __init__(self, airframe: Airframe) -> None:
        mix = np.linalg.pinv(airframe.wrench_matrix())
        lean, turn = mix[:, 1:3], mix[:, 3]
        used = np.maximum((np.abs(lean) > EPSILON).sum(0), 1)
        scale = np.sqrt((lean * lean).sum(0) / (used / 2.0)).max()
        self._lean: Array = lean / scale
        self._turn: Array = (turn / np.abs(turn).max())[:, None]
        self._roll, self._pitch = self._lean[:, :1], self._lean[:, 1:]
        self._back: Array = np.linalg.pinv(np.hstack([self._lean, self._turn]))
        wrench = airframe.wrench_matrix()[1:] @ np.hstack([self._lean, self._turn])
        self.torque_nm: Array = np.diag(wrench) * airframe.thrust_max_n

    def allocate(self, torque: Array, thrust: Array) -> tuple[Array, Array | None]:
        """Normalised torque (3, N), -1..1, and thrust (N,), 0..1 -> each rotor's share of its full thrust (M, N), and
        the torque that found no room (3, N); None: all of it did.
        """
        share = self._lean.dot(torque[:2]) + thrust
        fits = True
        if _beyond(share):
            fits = False
            share = _less(share)
            share = _along(share, self._roll)
            share = _along(share, self._pitch)
        share = share + self._turn * torque[2]
        if _beyond(share):
            fits = False
            share = _along(share, self._turn, 1.0 + YAW_ROOM)
            share = _less(share)
            share = clamp(share, 0.0, 1.0)
        return share, None if fits else torque - self._back @ (share - np.add.reduce(share) * (1.0 / len(share)))


def _beyond(share: Array) -> bool:
    """Any rotor is asked for more than it has, or for less than nothing."""
    flat = share.ravel()
    return bool(np.maximum.reduce(flat) > 1.0 or np.minimum.reduce(flat) < 0.0)


def _excess(share: Array, axis: Array, high: float) -> Array:
    """How far to go along ``axis`` (M, 1) to balance what is beyond both ends, (N,)."""
    usable = np.abs(axis) > EPSILON
    step = np.where(usable, np.where(share < 0.0, -share, np.where(share > high, high - share, 0.0)), 0.0)
    step = step / np.where(usable, axis, 1.0)
    result: Array = step.min(0) + step.max(0)
    return result


def _along(share: Array, axis: Array, high: float = 1.0) -> Array:
    share = share + axis * _excess(share, axis, high)
    # The first step may have pushed another rotor over an end.
    return share + axis * (0.5 * _excess(share, axis, high))


def _less(share: Array) -> Array:
    """Less thrust where the upper end is the trouble; never more: without air mode thrust is not raised for torque."""
    up = np.ones((len(share), 1))
    share = share + np.minimum(_excess(share, up, 1.0), 0.0)
    return share + 0.5 * np.minimum(_excess(share, up, 1.0), 0.0)
