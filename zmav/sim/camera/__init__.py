"""The downward camera: pictures of a textured ground and of the other vehicles, from where the vehicle truly is.

What renders needs OpenCV (the extra "vision") and is imported with the first camera; the specifications here do not.
"""

from __future__ import annotations

from zmav.sim.camera.scene import PlacedPad, Road, Roof, Scene, load_scene
from zmav.sim.camera.spec import CameraSpec, PadSpec

__all__ = ["CameraSpec", "PadSpec", "PlacedPad", "Road", "Roof", "Scene", "load_scene"]
