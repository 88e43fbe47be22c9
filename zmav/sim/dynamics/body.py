"""What every vectorised body offers, whatever moves it: the part of its state that sensors, estimators, cameras and
external flight stacks look at.
"""

from __future__ import annotations

from typing import Protocol

from zmav.sim.arrays import Array, Flags


class Body(Protocol):
    """N rigid bodies at a fixed step ``dt`` (s). Axes: world north-east-down, body forward-right-down.

    ``pos``, ``vel``, ``accel`` (3, N): m, m/s, m/s^2 in the world (``accel`` of the last step, gravity included);
    ``q`` (4, N): attitude, body to world; ``rate`` (3, N): rad/s, body; ``wind`` (3, N): m/s, where the air moves to,
    set by the fleet before each step; ``contact`` (N,): it touches the ground; ``impact`` (N,): down speed of the last
    touch, m/s, cleared by who reads it.
    """

    dt: float
    pos: Array
    vel: Array
    accel: Array
    q: Array
    rate: Array
    wind: Array
    contact: Flags
    impact: Array

    @property
    def n(self) -> int: ...

    def step(self) -> None:
        """Advance every vehicle by ``dt`` seconds."""

    def current(self) -> Array:
        """What it draws from its battery, A, (N,)."""
