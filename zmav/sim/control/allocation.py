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

    def allocate(self, torque: Array, thrust: Array) -> tuple[Array, Array]:
        """Normalised torque (3, N), -1..1, and thrust (N,), 0..1 -> each rotor's share of its full thrust (M, N), and
        the torque that found no room (3, N).
        """
        share = self._lean @ torque[:2] + thrust
        if share.max() > 1.0 or share.min() < 0.0:
            share = _less(share)
            share = _along(share, self._roll)
            share = _along(share, self._pitch)
        share = share + self._turn * torque[2]
        if share.max() > 1.0 or share.min() < 0.0:
            share = _along(share, self._turn, 1.0 + YAW_ROOM)
            share = _less(share)
            share = clamp(share, 0.0, 1.0)
        return share, torque - self._back @ (share - share.mean(0))


class Lame:
    """One vehicle with five rotors or more that has lost some of them: the others are used as PX4 does with
    CA_FAILURE_MODE 1 and ArduPilot's mixers with a lost motor. Thrust and leaning come first; turning gets what room
    there is, because a hexarotor with one rotor less can hold its heading only in one direction (G.-X. Du, Q. Quan,
    B. Yang, K.-Y. Cai, "Controllability analysis for multirotor helicopter rotor degradation and failure", Journal of
    Guidance, Control and Dynamics 38(5), 2015).
    """

    def __init__(self, airframe: Airframe, lost: tuple[int, ...]) -> None:
        self.lost = lost
        wrench = airframe.wrench_matrix()
        wrench[:, list(lost)] = 0.0
        self._wrench = wrench
        carry: Array = np.linalg.pinv(wrench[:3]).astype(np.float64)
        self._carry = carry
        # Turns and does nothing else: what is left of the yaw row once the others are kept as they are.
        free = np.eye(wrench.shape[1]) - carry @ wrench[:3]
        turn = free @ wrench[3]
        gain = float(wrench[3] @ turn)
        self._turn: Array = turn / gain if abs(gain) > EPSILON else np.zeros_like(turn)
        self._most = airframe.thrust_max_n

    def allocate(self, thrust: float, torque: Array) -> Array:
        """Newtons and newton metres (3,) -> each rotor's share of its full thrust, (M,)."""
        up = self._carry[:, 0] * (thrust / self._most)
        lean = self._carry[:, 1:] @ torque[:2] / self._most
        # Where it does not fit, the height gives way to the upper end, then the lean to both.
        up *= _room(up, 1.0 - np.minimum(lean, 1.0))
        lean *= min(_room(lean, 1.0 - up), _room(-lean, up))
        share = up + lean
        turn = self._turn * (torque[2] / self._most - float(self._wrench[3] @ share))
        room = min(_room(turn, 1.0 - share), _room(-turn, share))
        result: Array = clamp(share + turn * room, 0.0, 1.0)
        return result


def _room(step: Array, room: Array) -> float:
    """The share of ``step`` (M,) that fits where there is so much ``room``, 0..1."""
    more = step > EPSILON
    fits: float = np.clip(room[more] / step[more], 0.0, 1.0).min(initial=1.0)
    return fits


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
