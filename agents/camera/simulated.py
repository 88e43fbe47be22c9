"""What the simulator's camera says of its lens and mount: ``/NAME.json`` beside its pictures."""

from __future__ import annotations

import http.client
import math
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import msgspec

from agents.camera.settings import Calibration
from zmav.wire.base import Vector

PATIENCE = 3.0
MOST = 100_000


class Numbers(NamedTuple):
    calibration: Calibration
    mount: Vector
    """rad"""
    offset: Vector
    """m"""
    gimbal: bool


class _Told(msgspec.Struct):
    width: int
    height: int
    camera_matrix: tuple[Vector, Vector, Vector]
    mount_deg: Vector
    offset_m: Vector
    gimbal: bool


def numbers(url: str) -> Numbers | None:
    """Of the camera whose pictures are at ``http://host:port/NAME.mjpeg``; None where it is no simulator's."""
    parts = urlsplit(url)
    if not parts.path.endswith(".mjpeg"):
        return None
    try:
        connection = http.client.HTTPConnection(parts.hostname or "", parts.port or 80, timeout=PATIENCE)
        try:
            connection.request("GET", parts.path.removesuffix(".mjpeg") + ".json")
            answer = connection.getresponse()
            told: _Told = msgspec.json.decode(answer.read(MOST) if answer.status == 200 else b"", type=_Told)
        finally:
            connection.close()
        (fx, _, cx), (_, fy, cy), _ = told.camera_matrix
        plain: dict[str, Any] = {
            "width": told.width,
            "height": told.height,
            "focal": (fx, fy),
            "center": (cx, cy),
        }
        calibration = msgspec.convert(plain, Calibration)
    except (OSError, ValueError, http.client.HTTPException):  # msgspec's errors are ValueErrors
        return None
    roll, pitch, yaw = (math.radians(angle) for angle in told.mount_deg)
    return Numbers(calibration, (roll, pitch, yaw), told.offset_m, told.gimbal)
