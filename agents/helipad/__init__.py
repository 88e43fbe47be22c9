"""Finds a helipad in the frames of a downward camera; usable without Zenoh. Needs OpenCV (the extra "vision")."""

from __future__ import annotations

from agents.helipad.detector import Detection, Detector

__all__ = ["Detection", "Detector"]
