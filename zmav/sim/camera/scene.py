"""What lies on the ground. A scene file is TOML:

ground = "grass"                   # or asphalt

[[roads]]
points = [[0.0, -50.0], [0.0, 50.0]]   # metres north and east of the world's origin
width_m = 5.0

[[pads]]
position = [20.0, 0.0]
heading_deg = 30.0
pad = { symbol_m = 1.0, shape = "disc", size_m = 2.0, color = "yellow", background = "black" }

[[roofs]]                          # hides what is below it: a bridge, a hall
center = [0.0, 20.0]
size = [6.0, 12.0]                 # metres along its heading and across
heading_deg = 0.0
height_m = 4.0
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from zmav.errors import BadConfig
from zmav.sim.camera.spec import Angle, Metres, NotNegative, PadSpec, Positive, check_bounds, check_pad

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

Point = tuple[Metres, Metres]


class Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of the tables: strict, and never changed once read."""


class Road(Table, frozen=True):
    """An asphalt road along ``points``, metres north and east, with lines at its edges and dashes in the middle."""

    points: Annotated[tuple[Point, ...], msgspec.Meta(min_length=2, max_length=1000)]
    width_m: Positive = 5.0


class PlacedPad(Table, frozen=True):
    """A pad painted on the ground."""

    position: Point
    heading_deg: Angle = 0.0
    pad: PadSpec = PadSpec()


class Roof(Table, frozen=True):
    """A rectangle ``height_m`` above the ground at its centre, level: what is below it is hidden from above."""

    center: Point
    size: tuple[Positive, Positive]
    heading_deg: Angle = 0.0
    height_m: NotNegative = 4.0


class Scene(Table, frozen=True):
    """The whole scene. Further roads and pads lie above earlier ones."""

    ground: Literal["grass", "asphalt"] = "grass"
    roads: tuple[Road, ...] = ()
    pads: tuple[PlacedPad, ...] = ()
    roofs: tuple[Roof, ...] = ()


def load_scene(path: str | Path) -> Scene:
    """Read a scene file. Raises :class:`BadConfig` naming the file, the field and what was expected."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise BadConfig(f"{path}: {error}", field="scene", value=str(path), expected="a scene file") from error
    try:
        scene = msgspec.convert(tomllib.loads(text), Scene)
    except (ValueError, msgspec.ValidationError, RecursionError) as error:
        raise BadConfig(f"{path}: {error}", field="scene", value=str(path), expected=str(error)) from None
    check_scene(scene, str(path))
    return scene


def check_scene(scene: Scene, where: str = "scene") -> None:
    """:class:`BadConfig` names what in ``scene`` cannot be."""
    check_bounds(scene, where)
    for i, placed in enumerate(scene.pads):
        check_pad(placed.pad, f"{where}: pads[{i}].pad")
