"""What lies on the ground, and how it is lit. A scene file is TOML:

ground = "grass"                   # grass, asphalt, sand, tiles, concrete

[light]
sun_azimuth_deg = 160.0
sun_elevation_deg = 50.0
brightness = 1.0                   # 0.05: night

[[roads]]
points = [[0.0, -50.0], [0.0, 50.0]]   # metres north and east of the world's origin
width_m = 5.0

[[areas]]
ground = "concrete"
center = [20.0, 0.0]
size = [10.0, 15.0]                # metres along its heading and across
heading_deg = 30.0

[[pads]]
position = [20.0, 0.0]
heading_deg = 30.0
pad = { symbol_m = 1.0, shape = "ring", size_m = 2.0, color = "yellow", background = "black" }

[[roofs]]                          # hides what is below it: a bridge, a hall
center = [0.0, 20.0]
size = [6.0, 12.0]
height_m = 4.0
ground = "concrete"
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from zmav.errors import BadConfig
from zmav.sim.camera.spec import Angle, Fraction, Metres, NotNegative, PadSpec, Positive, check_pad

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

GroundKind = Literal["grass", "asphalt", "sand", "tiles", "concrete"]
Point = tuple[Metres, Metres]


class Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of the tables: strict, and never changed once read."""


class Light(Table, frozen=True):
    """Where the sun stands and how bright it is; shadows are cast where ``shadows`` is above 0."""

    sun_azimuth_deg: Angle = 150.0
    """from north, clockwise"""
    sun_elevation_deg: Annotated[float, msgspec.Meta(ge=5.0, le=90.0)] = 55.0
    shadows: Fraction = 0.5
    """how much darker a shadow is; 0: an overcast sky"""
    brightness: Annotated[float, msgspec.Meta(ge=0.0, le=4.0)] = 1.0
    """of everything; 0.05 is a moonlit night"""


class Road(Table, frozen=True):
    """A road along ``points``, metres north and east."""

    points: Annotated[tuple[Point, ...], msgspec.Meta(min_length=2, max_length=1000)]
    width_m: Positive = 5.0
    ground: GroundKind = "asphalt"
    center_line: Literal["dashed", "solid", "none"] = "dashed"
    edge_lines: bool = True


class Area(Table, frozen=True):
    """A rectangle of another ground: ``size`` is along its heading and across, metres."""

    center: Point
    size: tuple[Positive, Positive]
    heading_deg: Angle = 0.0
    ground: GroundKind = "concrete"


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
    ground: GroundKind = "concrete"


class Scene(Table, frozen=True):
    """The whole scene. Further roads, areas and pads lie above earlier ones."""

    ground: GroundKind = "grass"
    light: Light = Light()
    roads: tuple[Road, ...] = ()
    areas: tuple[Area, ...] = ()
    pads: tuple[PlacedPad, ...] = ()
    roofs: tuple[Roof, ...] = ()
    haze_m: Annotated[float, msgspec.Meta(ge=10.0, le=1e6)] = 15_000.0
    """distance at which haze has swallowed two thirds of what is seen"""


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
    try:
        msgspec.convert(msgspec.to_builtins(scene), Scene)
    except msgspec.ValidationError as error:
        raise BadConfig(f"{where}: {error}", field="scene", value=None, expected=str(error)) from None
    for i, placed in enumerate(scene.pads):
        check_pad(placed.pad, f"{where}: pads[{i}].pad")
