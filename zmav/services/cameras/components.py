"""A vehicle's cameras as MAVLink components: what each tells of itself.

Protocol: https://mavlink.io/en/services/camera.html
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec

from zmav import wire
from zmav.rotation import from_euler

CAPTURES, ZOOMS, STREAMS = 2, 64, 256
"""CAMERA_CAP_FLAGS"""
STREAM_TYPES = {"rtsp": 0, "rtp": 1, "tcp": 2, "udp": 3}
"""VIDEO_STREAM_TYPE by the scheme of a URI; any other is taken for RTSP, which stations read as a URL"""
H264 = 1
STORED, NOT_STORED = 2, 3
"""STORAGE_STATUS: ready, and not supported"""
MIB = 1 << 20
KEPT = 100
"""photos of which CAMERA_IMAGE_CAPTURED is told again"""
NAN = math.nan
Fields = dict[str, Any]


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
    photo: dict[str, Any] | None = None
    """the last one, as the order that took it was answered"""


@dataclass
class CameraComponent:
    """One camera. ``uri``: of its stream, for a ground station; ``heard``: monotonic seconds of its program's word."""

    name: str
    component: int
    uri: str | None = None
    capturing: Capturing | None = None
    heard: float = 0.0
    photos: dict[int, Mapping[str, Any]] = field(default_factory=dict)
    started: float = field(default_factory=time.monotonic)

    def hear(self, status: wire.AgentStatus) -> bool:
        """Take its program's word; whether it tells of a photo that was not known."""
        try:
            self.capturing = msgspec.convert(status.detail, Capturing)
        except msgspec.ValidationError:
            return False  # of another version
        self.heard = time.monotonic()
        photo, number = self.capturing.photo, self.capturing.taken
        if photo is None or number in self.photos:
            return False
        self.photos[number] = photo
        while len(self.photos) > KEPT:
            del self.photos[next(iter(self.photos))]
        return True

    def fields(self, message: str, which: int = 0) -> Fields | None:
        """Of one of its messages; ``which``: the photo; None: it has no such message."""
        build = BUILDERS.get(message)
        found = None if build is None else build(self, which)
        return found if found is None or message.startswith("VIDEO") else {"time_boot_ms": self._clock(), **found}

    def _clock(self) -> int:
        return int((time.monotonic() - self.started) * 1e3)

    def information(self, which: int) -> Fields:
        now, flags = self.capturing, STREAMS if self.uri else 0
        if now is not None:
            flags |= CAPTURES | (ZOOMS if now.most_zoom > 1.0 else 0)
        return {
            "vendor_name": list(b"zmav".ljust(32, b"\0")),
            "model_name": list(self.name.encode("ascii", "replace")[:31].ljust(32, b"\0")),
            "focal_length": NAN,
            "sensor_size_h": NAN,
            "sensor_size_v": NAN,
            "resolution_h": now.width if now else 0,
            "resolution_v": now.height if now else 0,
            "flags": flags,
        }

    def settings(self, which: int) -> Fields:
        now = self.capturing
        share = 100.0 * (now.zoom - 1.0) / (now.most_zoom - 1.0) if now and now.most_zoom > 1.0 else NAN
        return {"mode_id": 0, "zoomLevel": share, "focusLevel": NAN}

    def storage(self, which: int) -> Fields:
        now = self.capturing
        if now is None:
            return {"storage_id": 1, "status": NOT_STORED}
        sizes = {"total": now.total, "used": now.total - now.free, "available": now.free}
        capacities = {f"{name}_capacity": size / MIB for name, size in sizes.items()}
        return {"storage_id": 1, "storage_count": 1, "status": STORED, "name": self.name[:31], **capacities}

    def capture(self, which: int) -> Fields:
        now = self.capturing
        if now is None:
            return {}
        series = {"image_status": 3 if now.every else 0, "image_interval": now.every}
        return {**series, "image_count": now.taken, "available_capacity": now.free / MIB}

    def stream(self, which: int) -> Fields | None:
        if not self.uri:
            return None
        kind = STREAM_TYPES.get(self.uri.partition(":")[0], 0)
        told = {"stream_id": 1, "count": 1, "type": kind, "flags": 1, "encoding": H264}
        return {**told, "name": self.name[:31], "uri": self.uri[:159]}

    def stream_status(self, which: int) -> Fields | None:
        return {"stream_id": 1, "flags": 1} if self.uri else None

    def photo(self, which: int) -> Fields | None:
        """Of the photo with that number; CAMERA_IMAGE_CAPTURED."""
        said = self.photos.get(which)
        if said is None:
            return None
        place, look = said.get("position") or {}, said.get("attitude") or {}
        return {
            "time_utc": round(float(said["t"]) * 1e6),
            "lat": round(place.get("lat_deg", 0.0) * 1e7),
            "lon": round(place.get("lon_deg", 0.0) * 1e7),
            "alt": round(place.get("alt_amsl", 0.0) * 1e3),
            "relative_alt": round(place.get("alt_rel", 0.0) * 1e3),
            "q": list(from_euler(*(look.get(axis, 0.0) for axis in ("roll", "pitch", "yaw")))),
            "image_index": which,
            "capture_result": 1,
            "file_url": str(said.get("file", ""))[:204],
        }


BUILDERS = {
    "CAMERA_INFORMATION": CameraComponent.information,
    "CAMERA_SETTINGS": CameraComponent.settings,
    "STORAGE_INFORMATION": CameraComponent.storage,
    "CAMERA_CAPTURE_STATUS": CameraComponent.capture,
    "VIDEO_STREAM_INFORMATION": CameraComponent.stream,
    "VIDEO_STREAM_STATUS": CameraComponent.stream_status,
    "CAMERA_IMAGE_CAPTURED": CameraComponent.photo,
}
