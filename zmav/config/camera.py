"""A vehicle's cameras in the fleet file: where their encoded video comes from.

[vehicles.quad1.cameras.down]
streams = ["rtsp://192.168.144.25:8554/main", "rtsp://192.168.144.25:8554/sub"]   # the richest first
"""

from __future__ import annotations

from typing import Annotated
from urllib.parse import urlsplit

import msgspec

from zmav.config.table import Table

STATIONS = ("rtsp", "rtp", "udp", "tcp", "http", "https")
"""schemes that a ground station opens by itself"""


class CameraConfig(Table, frozen=True):
    """One camera, by its name in the key space."""

    streams: Annotated[list[str], msgspec.Meta(min_length=1, max_length=6)]
    """what 'zmav video run' takes, of one view: from the one with most bytes to the one with least"""

    @property
    def uri(self) -> str | None:
        """The first stream that a ground station could open by itself, without a password in it."""
        for each in self.streams:
            parts = urlsplit(each)
            if parts.scheme in STATIONS and not parts.password:
                return each
        return None
