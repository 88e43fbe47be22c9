"""Pictures of cameras with the symbols that were detected drawn in."""

from __future__ import annotations

import rerun as rr

from ground.view import style
from ground.view.canvas import Canvas, Path
from zmav import wire

BEGIN, END = b"\xff\xd8\xff", b"\xff\xd9"
MOST = 200
"""boxes drawn into one picture"""


def paint_frame(canvas: Canvas, label: str, camera: str, jpeg: bytes) -> bool:
    """Show a picture; False for what is no whole JPEG."""
    if not jpeg.startswith(BEGIN) or END not in jpeg[-64:]:
        return False
    canvas.put(_path(label, camera), rr.EncodedImage(contents=jpeg, media_type="image/jpeg"))
    return True


def paint_detection(canvas: Canvas, label: str, camera: str, seen: wire.Detections) -> None:
    """Box the symbols that were found; none of them clears the picture."""
    found = seen.found[:MOST]
    boxes = rr.Boxes2D(
        mins=[(each.u - each.scale_px / 2.0, each.v - each.scale_px / 2.0) for each in found],
        sizes=[(each.scale_px, each.scale_px) for each in found],
        labels=[each.symbol for each in found],
        colors=style.GRADES["good"],
        radii=1.0,
    )
    canvas.put((*_path(label, camera), "detection"), boxes if found else None)


def _path(label: str, camera: str) -> Path:
    return ("camera", label, camera)
