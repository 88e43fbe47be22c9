"""What a painter is started with, and how it and its starter speak."""

from __future__ import annotations

import struct
from typing import Literal

import msgspec

LENGTH = struct.Struct("<I")
"""before every batch"""
READY = b"?"
"""a painter's request for the next one"""
LOST = 3
"""a painter's exit code: its sink takes nothing any more, and never will"""


class Sink(msgspec.Struct, frozen=True):
    """Where a painter logs to."""

    kind: Literal["native", "web", "save"]
    path: str = ""
    """of the file, for ``save``"""
    url: str = ""
    """of Rerun's gRPC proxy, for the others"""
    port: int = 0
    """of that proxy, for ``native`` and ``web``, on loopback"""
    web_port: int = 0
    """where the web viewer is served, on loopback"""

    @property
    def words(self) -> str:
        return {"native": "the viewer", "web": "the web viewer's server", "save": self.path}[self.kind]


class PainterSettings(msgspec.Struct, frozen=True):
    sink: Sink
    several: bool = False
    """vehicles are called ``fleet/vehicle``"""
    size: float = 1.0
    """of the models"""
