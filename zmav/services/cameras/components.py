"""A vehicle's camera as a MAVLink component: what it tells of itself. Protocol:
https://mavlink.io/en/services/camera.html
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import msgspec

from zmav import wire
from zmav.rotation import from_euler

CAPTURES, ZOOMS, STREAMS = 2, 64, 256
"""CAMERA_CAP_FLAGS"""
STREAM_TYPES = {"rtsp": 0, "rtp": 1, "tcp": 2, "udp": 3}
"""VIDEO_STREAM_TYPE by the scheme of a URI; any other is taken for RTSP, which stations read as a URL"""
H264, RUNNING = 1, 1
STORED, NOT_STORED = 2, 3
"""STORAGE_STATUS: ready, and not supported"""
MIB = 1 << 20
NAN = math.nan
Fields = dict[str, Any]


class Photo(wire.Told, kw_only=True):
    """One, as the order that took it is answered."""

    number: int
    t: float
    file: str
    position: wire.GlobalPosition | None = None
    attitude: wire.Attitude | None = None


class Capturing(wire.Told, kw_only=True):
    """What the program that takes a camera's photos says of itself, in the detail of its status."""

    width: int = 0
    height: int = 0
    taken: int = 0
    """photos, the last one's number"""
    every: float = 0.0
    """s between two of a series that is under way; 0: there is none"""
    zoom: float = 1.0
    most_zoom: float = 1.0
    total: float = 0.0
    free: float = 0.0
    """bytes of its disk"""
    photo: Photo | None = None
    """the last one"""

    def after(self, verb: str, done: Mapping[str, Any]) -> Capturing:
        """As it is once an order was answered with ``done``; msgspec's ValidationError for what is no answer to it."""
        news: dict[str, Any] = {"zoom": done.get("factor")} if verb == "zoom" else {"every": done.get("every", 0.0)}
        if verb == "photo" and "every" not in done:
            photo = msgspec.convert(done, Photo)
            news |= {"photo": photo, "taken": photo.number} if photo.number > self.taken else {}
        return msgspec.convert(msgspec.structs.asdict(self) | news, Capturing)


@dataclass
class Camera:
    """One camera. ``uri``: of its stream, for a ground station; ``capturing``: None where no photos are taken of it;
    ``heard``: monotonic seconds of its program's last word.
    """

    name: str
    component: int
    uri: str | None = None
    capturing: Capturing | None = None
    heard: float = 0.0

    def messages(self) -> dict[str, Fields]:
        """The fields of all that it can be asked for, by message."""
        now, clock = self.capturing, {"time_boot_ms": int(time.monotonic() * 1e3) & 0xFFFFFFFF}
        told: dict[str, Fields] = {
            "CAMERA_INFORMATION": {**clock, **self._information()},
            "CAMERA_SETTINGS": {**clock, "zoomLevel": NAN, "focusLevel": NAN},
            "STORAGE_INFORMATION": {**clock, "storage_id": 1, "status": NOT_STORED},
            "CAMERA_CAPTURE_STATUS": {**clock},
        }
        if now is not None:
            zoom = 100.0 * (now.zoom - 1.0) / (now.most_zoom - 1.0) if now.most_zoom > 1.0 else NAN
            told["CAMERA_SETTINGS"]["zoomLevel"] = zoom
            sizes = {"total": now.total, "used": now.total - now.free, "available": now.free}
            told["STORAGE_INFORMATION"] |= {"storage_count": 1, "status": STORED}
            told["STORAGE_INFORMATION"] |= {f"{name}_capacity": size / MIB for name, size in sizes.items()}
            series = {"image_status": 3 if now.every else 0, "image_interval": now.every}
            told["CAMERA_CAPTURE_STATUS"] |= {**series, "image_count": now.taken, "available_capacity": now.free / MIB}
            if now.photo is not None:
                told["CAMERA_IMAGE_CAPTURED"] = {**clock, **_photo(now.photo)}
        if self.uri:
            stream = {"stream_id": 1, "flags": RUNNING}
            kind = STREAM_TYPES.get(self.uri.partition(":")[0], 0)
            told["VIDEO_STREAM_STATUS"] = stream
            called = {"name": self.name[:31], "uri": self.uri[:159]}
            told["VIDEO_STREAM_INFORMATION"] = {**stream, **called, "count": 1, "type": kind, "encoding": H264}
        return told

    def _information(self) -> Fields:
        now, flags = self.capturing, STREAMS if self.uri else 0
        if now is not None:
            flags |= CAPTURES | (ZOOMS if now.most_zoom > 1.0 else 0)
        return {
            "vendor_name": list(b"zmav".ljust(32, b"\0")),
            "model_name": list(self.name.encode()[:31].ljust(32, b"\0")),
            **dict.fromkeys(("focal_length", "sensor_size_h", "sensor_size_v"), NAN),
            "resolution_h": now.width if now else 0,
            "resolution_v": now.height if now else 0,
            "flags": flags,
        }


def _photo(said: Photo) -> Fields:
    told: Fields = {"q": [1.0, 0.0, 0.0, 0.0]}
    if (place := said.position) is not None:
        told |= {"lat": round(place.lat_deg * 1e7), "lon": round(place.lon_deg * 1e7)}
        told |= {"alt": round(place.alt_amsl * 1e3), "relative_alt": round(place.alt_rel * 1e3)}
    if (look := said.attitude) is not None:
        told["q"] = list(from_euler(look.roll, look.pitch, look.yaw))
    taken = {"time_utc": round(said.t * 1e6), "image_index": said.number, "capture_result": 1}
    return {**told, **taken, "file_url": said.file[:204]}
