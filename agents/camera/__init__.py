"""A vehicle's camera: pictures from a device, a stream or files into the key space; ``zmav camera``."""

from __future__ import annotations
