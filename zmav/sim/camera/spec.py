"""What a camera and a landing pad are made of. Data and its checks only: nothing here needs OpenCV."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from zmav.errors import BadConfig

Positive = Annotated[float, msgspec.Meta(gt=0.0, le=1e6)]
NotNegative = Annotated[float, msgspec.Meta(ge=0.0, le=1e6)]
Angle = Annotated[float, msgspec.Meta(ge=-360.0, le=360.0)]
Metres = Annotated[float, msgspec.Meta(ge=-1e6, le=1e6)]
Pixels = Annotated[int, msgspec.Meta(ge=16, le=4096)]

COLOURS = {"white": "#f2f2f0", "yellow": "#f5c518", "black": "#1c1c1e", "blue": "#1d4e9e"}


class CameraSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A camera that looks down from a vehicle.

    The picture's pixel (u, v) = (0, 0) is the *centre* of its upper left pixel. With no ``mount_deg`` the upper edge of
    the picture is toward the vehicle's nose. The lens is a pinhole, with its axis in the middle of the picture.
    """

    width: Pixels = 640
    height: Pixels = 480
    focal_px: Annotated[float, msgspec.Meta(ge=10.0, le=1e5)] = 520.0
    mount_deg: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    """roll, pitch and yaw of the mount in the vehicle's axes, from straight down; pitch 90 looks ahead"""
    offset_m: tuple[Metres, Metres, Metres] = (0.0, 0.0, -0.1)
    """optical centre in the vehicle's axes, forward, right, down of its reference point (a copter's: its feet)"""
    gimbal: bool = False
    """levelled: of the vehicle's attitude only the heading counts"""
    rate_hz: Annotated[float, msgspec.Meta(gt=0.0, le=100.0)] = 20.0
    """of the served pictures, in simulated time"""


class PadSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A landing pad: the letter H (or a chessboard, for calibration) on its ground. On a vehicle the letter stands
    upright seen with the nose ahead.

    The H fills ``symbol_m`` by ``width_ratio`` times that; both uprights and the bar between them, which lies in the
    middle, are ``stroke_ratio`` of its height wide. A heliport's H has 0.6 and 0.133 (ICAO Annex 14 volume II, 5.2.2);
    a small pad's is bolder.
    """

    symbol: Literal["H", "chessboard"] = "H"
    symbol_m: Positive = 0.25
    """height of the letter; of a chessboard, the length of its longer side"""
    width_ratio: Annotated[float, msgspec.Meta(ge=0.2, le=2.0)] = 0.75
    stroke_ratio: Annotated[float, msgspec.Meta(ge=0.02, le=0.45)] = 0.2
    squares: tuple[Annotated[int, msgspec.Meta(ge=2, le=50)], Annotated[int, msgspec.Meta(ge=2, le=50)]] = (7, 10)
    """of a chessboard, across and along"""
    color: str = "white"
    shape: Literal["disc", "square"] = "disc"
    """what the symbol lies on"""
    size_m: Positive = 0.5
    """diameter or side"""
    background: str = "blue"
    deck_m: Annotated[float, msgspec.Meta(ge=0.0, le=20.0)] | None = None
    """on a vehicle: height above its reference point (a rover's: the ground); None: on its top"""


def bgr(color: str, where: str = "color") -> tuple[float, float, float]:
    """Blue, green and red, 0 to 255, of a colour by name or as ``#rrggbb``; :class:`BadConfig` says which there are."""
    text = COLOURS.get(color, color)
    try:
        if len(text) != 7 or text[0] != "#":
            raise ValueError
        red, green, blue = (int(text[i : i + 2], 16) for i in (1, 3, 5))
    except ValueError:
        raise _bad(where, color, f"#rrggbb or one of {', '.join(COLOURS)}") from None
    return float(blue), float(green), float(red)


def check_pad(spec: PadSpec, where: str) -> None:
    """:class:`BadConfig` names what in ``spec`` cannot be."""
    check_bounds(spec, where)
    bgr(spec.color, f"{where}.color")
    bgr(spec.background, f"{where}.background")
    if 2.0 * spec.stroke_ratio >= spec.width_ratio:
        raise _bad(f"{where}.stroke_ratio", spec.stroke_ratio, f"less than half the width_ratio, {spec.width_ratio:g}")


def check_bounds(spec: msgspec.Struct, where: str) -> None:
    """:class:`BadConfig` names the field of ``spec`` that is out of its bounds, which msgspec looks at only where it
    decodes.
    """
    try:
        msgspec.convert(msgspec.to_builtins(spec), type(spec))
    except msgspec.ValidationError as error:
        raise BadConfig(f"{where}: {error}", field=where, value=None, expected=str(error)) from None


def _bad(field: str, value: object, expected: str) -> BadConfig:
    return BadConfig.wrong(field, value, expected, f"{field} is {value!r}")
