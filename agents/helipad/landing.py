"""LANDING_TARGET frames, by which ArduPilot and PX4 land on a target by themselves.

Source: https://mavlink.io/en/services/landing_target.html. With ``position_valid`` ArduPilot takes BODY_FRD and divides
by ``distance``, which is the norm here; PX4 takes LOCAL_NED only, about the autopilot's own estimator origin.
"""

from __future__ import annotations

import math
from typing import Any

from zmav.mavlink import Dialect, encode
from zmav.vision.optics import euler_matrix
from zmav.wire import Vector

BODY_FRD, LOCAL_NED = "MAV_FRAME_BODY_FRD", "MAV_FRAME_LOCAL_NED"
COMPONENT = 191
"""MAV_COMP_ID_ONBOARD_COMPUTER: the companion speaks with the vehicle's own system id"""
NO_TURN = [1.0, 0.0, 0.0, 0.0]


def frame(
    dialect: Dialect,
    autopilot: str,
    sysid: int,
    t_usec: int,
    offset: Vector,
    attitude: Vector,
    size_m: float,
    local: Vector | None = None,
) -> bytes | None:
    """The frame (MAVLink 2) for a pad ``offset`` m north, east, down of a vehicle with this roll, pitch and yaw (rad).

    ``local``: the vehicle's place in its autopilot's own local frame (LOCAL_POSITION_NED), which PX4 needs; None for
    PX4 without it, and for a target above the vehicle.
    """
    north, east, down = offset
    if down <= 0.0:
        return None
    distance = math.sqrt(north * north + east * east + down * down)
    forward, right, below = map(float, euler_matrix(*attitude).T @ offset)
    kind, place = BODY_FRD, (forward, right, below)
    if autopilot == "px4":
        if local is None:
            return None
        kind, place = LOCAL_NED, (local[0] + north, local[1] + east, local[2] + down)
    fields: dict[str, Any] = {
        "time_usec": t_usec,
        "target_num": 0,
        "frame": kind,
        "angle_x": math.atan2(right, below),
        "angle_y": math.atan2(-forward, below),
        "distance": distance,
        "size_x": size_m / distance,
        "size_y": size_m / distance,
        "x": place[0],
        "y": place[1],
        "z": place[2],
        "q": NO_TURN,
        "type": "LANDING_TARGET_TYPE_VISION_OTHER",
        "position_valid": 1,
    }
    return encode(dialect, "LANDING_TARGET", fields, sysid=sysid, compid=COMPONENT)
