"""Pictures on the wire and what a pixel sees. ``zmav`` itself imports nothing of it, and OpenCV is imported late."""

from __future__ import annotations
