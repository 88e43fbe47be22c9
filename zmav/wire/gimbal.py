"""Orders to a vehicle's gimbal. Angles are radians: pitch up from the horizon, yaw to the right."""

from __future__ import annotations

from zmav.wire.base import Vector
from zmav.wire.orders import Order


class TakeGimbal(Order, kw_only=True):
    """``do/gimbal_neutral``: back to where it looks without orders, and the base of others that need its control."""

    take: bool = False
    """also from somebody else who has it: a ground station, or the pilot as far as the autopilot tells"""


class TurnGimbal(TakeGimbal, kw_only=True):
    """``do/gimbal_turn``: to angles. Without ``lock`` it turns with the vehicle."""

    pitch: float
    yaw: float = 0.0
    """from the nose; with ``lock`` from north"""
    lock: bool = False


class PointGimbal(TakeGimbal, kw_only=True):
    """``do/gimbal_point``: at a place, or at another vehicle of the fleet, until the next order to the gimbal. One of
    ``pos``, ``vehicle`` and ``lat_deg`` with ``lon_deg``.
    """

    pos: Vector | None = None
    """m, NED about the fleet's origin"""
    lat_deg: float | None = None
    lon_deg: float | None = None
    alt_amsl: float | None = None
    alt_rel: float | None = None
    """m above home; 0 where neither is given"""
    vehicle: str = ""
