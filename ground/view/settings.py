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

    kind: Literal["native", "web", "save", "connect"]
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
        return {"native": "the viewer", "web": "the web viewer's server", "save": self.path, "connect": self.url}[
            self.kind
        ]

    @property
    def lost(self) -> str:
        """Why a painter ended with :data:`LOST`."""
        if self.kind == "save":
            return f"{self.path} does not grow any more: is its disk full, or has it been deleted?"
        return f"no viewer answers at {self.url}: 'rerun' starts one"


class PainterSettings(msgspec.Struct, frozen=True):
    sink: Sink
    several: bool = False
    """vehicles are called ``fleet/vehicle``"""
    size: float = 1.0
    """of the models"""
