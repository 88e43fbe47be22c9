"""Pictures of cameras with what was detected drawn in."""

from __future__ import annotations

import json
from typing import Any

import rerun as rr

from ground.view import shapes, style
from ground.view.canvas import Canvas, Path

BEGIN, END = b"\xff\xd8\xff", b"\xff\xd9"
MOST = 200
"""boxes drawn into one picture"""


def paint_frame(canvas: Canvas, label: str, camera: str, jpeg: bytes) -> bool:
    """Show a picture; False for what is no whole JPEG."""
    if not jpeg.startswith(BEGIN) or END not in jpeg[-64:]:
        return False
    canvas.put(_path(label, camera), rr.EncodedImage(contents=jpeg, media_type="image/jpeg"))
    return True


def paint_detection(canvas: Canvas, label: str, camera: str, payload: bytes) -> bool:
    """Draw what was detected: symbols (:class:`zmav.wire.Detections`); or JSON with boxes ``[x, y, width, height]`` in
    pixels, or objects that say so, or ``corners`` (a list of ``[x, y]``: a marker). None of them clears the picture.
    False where it cannot be read.
    """
    try:
        document = json.loads(payload or b"null")
    except (ValueError, RecursionError):
        return False
    boxes, outlines = _found(document)
    path = (*_path(label, camera), "detection")
    drawn = None
    if boxes:
        mins, sizes, names = zip(*boxes, strict=True)
        drawn = rr.Boxes2D(mins=mins, sizes=sizes, labels=names, colors=style.GRADES["good"], radii=1.0)
    canvas.put(path, drawn)
    lines = rr.LineStrips2D(outlines, colors=style.GRADES["fair"], radii=1.0) if outlines else None
    canvas.put((*path, "corners"), lines)
    return document is None or isinstance(document, (dict, list))


def _path(label: str, camera: str) -> Path:
    return ("camera", label, camera)


Pair = tuple[float, float]


def _found(document: Any) -> tuple[list[tuple[Pair, Pair, str]], list[list[Pair]]]:
    listed = document
    if isinstance(document, dict):
        keys = ("found", "detections", "boxes", "markers")
        listed = next((document[key] for key in keys if isinstance(document.get(key), list)), [document])
    boxes, outlines = [], []
    for each in (listed if isinstance(listed, list) else [])[:MOST]:
        if (box := _box(each)) is not None:
            boxes.append(box)
        if isinstance(each, dict) and isinstance(each.get("corners"), list):
            corners = [pair for pair in map(shapes.pair, each["corners"][:32]) if pair is not None]
            if len(corners) > 2:
                outlines.append([*corners, corners[0]])
    return boxes, outlines


def _box(each: Any) -> tuple[Pair, Pair, str] | None:
    name, raw = "", each
    if isinstance(each, dict):
        words = (each.get(key) for key in ("label", "name", "class", "symbol", "id"))
        name = next((str(word)[:40] for word in words if isinstance(word, (str, int))), "")
        raw = each.get("box", each.get("bbox"))
        if raw is None and (symbol := shapes.numbers(each, "u", "v", "scale_px")):
            u, v, size = symbol
            raw = [u - size / 2.0, v - size / 2.0, size, size]
        if raw is None:
            raw = shapes.numbers(each, "x", "y", "w", "h") or shapes.numbers(each, "x", "y", "width", "height")
    if not isinstance(raw, list) or len(raw) != 4:
        return None
    x, y, width, height = map(shapes.number, raw)
    if x is None or y is None or width is None or height is None or width < 0.0 or height < 0.0:
        return None
    return (x, y), (width, height), name
