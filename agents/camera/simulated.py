"""What the simulator's camera says of its lens and mount: ``/NAME.json`` beside its pictures."""

from __future__ import annotations

import http.client
import math
import urllib.request
from typing import NamedTuple
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
    distortion: tuple[float, float, float, float, float]
    mount_deg: Vector
    offset_m: Vector
    gimbal: bool


def numbers(url: str) -> Numbers | None:
    """Of the camera whose pictures are at ``http://host:port/NAME.mjpeg``; None where it is no simulator's."""
    parts = urlsplit(url)
    if not parts.path.endswith(".mjpeg"):
        return None
    where = parts._replace(path=parts.path.removesuffix(".mjpeg") + ".json", query="").geturl()
    try:
        with urllib.request.build_opener(urllib.request.ProxyHandler({})).open(where, timeout=PATIENCE) as answer:
            told: _Told = msgspec.json.decode(answer.read(MOST), type=_Told)
        (fx, _, cx), (_, fy, cy), _ = told.camera_matrix
        lens = {"focal": (fx, fy), "center": (cx, cy), "distortion": told.distortion}
        calibration = msgspec.convert({"width": told.width, "height": told.height, **lens}, Calibration)
    except (OSError, ValueError, http.client.HTTPException):  # msgspec's errors are ValueErrors, urllib's OSErrors
        return None
    roll, pitch, yaw = (math.radians(angle) for angle in told.mount_deg)
    return Numbers(calibration, (roll, pitch, yaw), told.offset_m, told.gimbal)
