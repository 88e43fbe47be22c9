"""A GeoTIFF as a picture that lies straight on the page's map, which is in Web Mercator.

Georeferences in WGS84 degrees (EPSG:4326), Web Mercator (EPSG:3857) and WGS84's UTM zones (EPSG:326xx, 327xx):
OGC 19-008r4. Transverse Mercator after Karney 2011, https://arxiv.org/abs/1002.1417 (series to the third order in n:
a millimetre within a zone).
"""

from __future__ import annotations

import io
import itertools
import math
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np
import numpy.typing as npt

from zmav.errors import BadConfig, ZmavError, missing_extra

if TYPE_CHECKING:
    from PIL.Image import Image

Floats = npt.NDArray[np.float64]
Forward = Callable[[Floats, Floats], tuple[Floats, Floats]]
"""longitude and latitude in degrees to the file's x and y, or back"""
Corners = tuple[float, float, float, float]

MAGICS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
MOST_SIDE, MOST_PIXELS = 4096, 120_000_000
"""pixels of the picture's longer side, and of what is decoded for it, which takes 0.5 GB meanwhile"""
STRIP = 512
"""rows of it that are made colours at a time"""
CELLS, EDGE = 16, 17
"""in which it is bent each way, and points of each of its edges that are looked at for its bounds"""
SCALE, TIE_POINTS, TRANSFORM, GEO_KEYS, NO_DATA, SUBFILE = 33550, 33922, 34264, 34735, 42113, 254
MODEL_TYPE, RASTER_TYPE, GEOGRAPHIC, PROJECTED = 1024, 1025, 2048, 3072
PROJECTED_MODEL, POINT = 1, 2
HELP = "'gdalwarp -t_srs EPSG:4326 -ot Byte IN.tif OUT.tif' makes one that can be shown"
BYTES = {"1", "L", "LA", "P", "PA", "RGB", "RGBA", "RGBX", "CMYK", "YCbCr"}
"""Pillow's kinds of pictures whose channels are bytes"""


class Laid(NamedTuple):
    """What the page shows."""

    data: bytes
    kind: str
    corners: Corners
    """south, west, north, east; degrees"""


def lay(path: Path, side: int = MOST_SIDE, most: int = MOST_PIXELS) -> Laid:
    """Read and bend it, once, to so many pixels of the longer ``side``; at most so many are decoded for it. Raises
    :class:`BadConfig` for a file that cannot be shown, with what helps.
    """
    try:
        from PIL.TiffImagePlugin import TiffImageFile
    except ImportError as e:
        raise missing_extra("a GeoTIFF", e.name, "geotiff") from e
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what is wrong with it is said once, by what it leads to
            with TiffImageFile(path) as image:  # Image.open() refuses a large one for all its overviews
                return _laid(path, image, side, most)
    except ZmavError:
        raise
    except Exception as e:  # a decoder raises anything for a file that is broken
        _refuse(path, f"cannot be read as a picture: {type(e).__name__} {e}")


def _refuse(path: Path, why: str) -> NoReturn:
    text = f"picture {path}: {why}; {HELP}"
    raise BadConfig(text, field="picture", value=str(path), expected="a GeoTIFF in EPSG:4326, 3857 or WGS84's UTM")


def _laid(path: Path, image: Image, side: int, most: int) -> Laid:
    from PIL import Image as Pillow

    tags: Any = dict(getattr(image, "tag_v2", {}))
    forward, back = _projection(path, tags)
    affine = _affine(path, tags)
    width, height = image.size
    west, south, east, north = _bounds(path, affine, back, width, height)
    picture = _reduced(path, image, tags, side, most)
    shrunk = np.array([picture.width / width, picture.height / height])
    ratio = (east - west) / (north - south)
    longer = min(side, max(picture.size))
    size = (longer, max(1, round(longer / ratio))) if ratio >= 1.0 else (max(1, round(longer * ratio)), longer)

    def source(x: Floats, y: Floats) -> Floats:
        """(N, 2) pixels of ``picture`` at pixels of what is made."""
        lon, lat = from_mercator(west + x / size[0] * (east - west), north - y / size[1] * (north - south))
        places = np.stack(forward(lon, lat), axis=-1) - affine[:, 2]
        pixels: Floats = places @ np.linalg.inv(affine[:, :2]).T * shrunk
        return pixels

    xs, ys = (np.unique(np.linspace(0, end, CELLS + 1).round().astype(int)).tolist() for end in size)
    mesh = []
    for left, right in itertools.pairwise(xs):
        for top, bottom in itertools.pairwise(ys):
            around = np.array([[left, top], [left, bottom], [right, bottom], [right, top]], dtype=np.float64)
            mesh.append(((left, top, right, bottom), tuple(source(around[:, 0], around[:, 1]).ravel().tolist())))
    bent = picture.transform(size, Pillow.Transform.MESH, mesh, Pillow.Resampling.BILINEAR)
    data = io.BytesIO()
    bent.save(data, "WEBP", quality=85)
    lon, lat = from_mercator(np.array([west, east]), np.array([south, north]))
    return Laid(data.getvalue(), "image/webp", (float(lat[0]), float(lon[0]), float(lat[1]), float(lon[1])))


def _bounds(path: Path, affine: Floats, back: Forward, width: int, height: int) -> tuple[float, float, float, float]:
    """West, south, east, north of its outline; m of Web Mercator."""
    along, zero = np.linspace(0.0, 1.0, EDGE), np.zeros(EDGE)
    columns = np.concatenate((along, along, zero, zero + 1.0)) * width
    rows = np.concatenate((zero, zero + 1.0, along, along)) * height
    x, y = affine @ np.stack((columns, rows, np.ones_like(rows)))
    lon, lat = back(x, y)
    if not (np.isfinite([lon, lat]).all() and np.abs(lat).max() < 85.0 and np.abs(lon).max() <= 180.0):
        _refuse(path, "its georeference does not lie on the map")
    easts, norths = to_mercator(lon, lat)
    if np.ptp(easts) <= 0.0 or np.ptp(norths) <= 0.0:
        _refuse(path, "its georeference gives it no extent")
    return float(easts.min()), float(norths.min()), float(easts.max()), float(norths.max())


def _reduced(path: Path, image: Image, tags: Any, side: int, most: int) -> Image:
    """RGBA, its longer side less than twice ``side``: from an overview where the file has one."""
    from PIL import Image as Pillow

    best, pages = (max(image.size), 0), getattr(image, "n_frames", 1)
    full = image.width / image.height
    for page in range(1, pages):
        image.seek(page)
        longer = max(image.size)
        overview = bool(image.tag_v2.get(SUBFILE, 0) & 1)  # type: ignore[attr-defined]
        like = abs(image.width / image.height / full - 1.0) < 0.02
        if overview and like and image.mode in BYTES and side <= longer < best[0]:
            best = (longer, page)
    image.seek(best[1])
    if image.width * image.height > most:
        pixels = f"{image.width} x {image.height}"
        _refuse(path, f"{pixels} pixels are too many without overviews ('gdaladdo -r average {path.name}' adds them)")
    if image.mode not in BYTES:
        _refuse(path, f"its pixels are numbers ({image.mode}), and no colours of 8 bits")
    factor, empty = max(1, max(image.size) // side), _number(tags.get(NO_DATA))
    reduced = Pillow.new("RGBA", (math.ceil(image.width / factor), math.ceil(image.height / factor)))
    rows = factor * math.ceil(STRIP / factor)
    for top in range(0, image.height, rows):
        piece = image.crop((0, top, image.width, min(top + rows, image.height)))
        reduced.paste(_colours(piece, empty).reduce(factor), (0, top // factor))
    return reduced


def _colours(image: Image, empty: float | None) -> Image:
    """RGBA, clear where all channels are ``empty``."""
    from PIL import Image as Pillow

    colours = image.convert("RGBA")
    if empty is not None and image.mode in ("L", "RGB"):
        values = np.asarray(image).reshape(image.height, image.width, -1)
        shown = np.where((values == empty).all(axis=-1), 0, 255).astype(np.uint8)
        colours.putalpha(Pillow.fromarray(shown))
    return colours


def _number(text: Any) -> float | None:
    try:
        return float(str(text).strip("\0 "))
    except ValueError:
        return None


# The georeference.


def _affine(path: Path, tags: Any) -> Floats:
    """(2, 3): from columns and rows, counted from the corner of the first pixel, to the file's x and y."""
    ties, scale, whole = (tuple(map(float, tags.get(tag, ()))) for tag in (TIE_POINTS, SCALE, TRANSFORM))
    if len(whole) == 16:
        found = np.array([[whole[0], whole[1], whole[3]], [whole[4], whole[5], whole[7]]])
    elif len(scale) >= 2 and len(ties) == 6:
        column, row, _, x, y, _ = ties
        found = np.array([[scale[0], 0.0, x - column * scale[0]], [0.0, -scale[1], y + row * scale[1]]])
    else:
        _refuse(path, "it has no georeference of one scale or one transformation")
    if _keys(tags).get(RASTER_TYPE) == POINT:
        found[:, 2] -= 0.5 * found[:, 0] + 0.5 * found[:, 1]
    if not (np.isfinite(found).all() and abs(float(np.linalg.det(found[:, :2]))) > 1e-30):
        _refuse(path, "its georeference gives it no extent")
    return found


def _keys(tags: Any) -> dict[int, int]:
    """GeoKeys that are short numbers."""
    words = [int(word) for word in tags.get(GEO_KEYS, ())]
    rows = [words[i : i + 4] for i in range(4, len(words) - 3, 4)]
    return {key: value for key, where, _, value in rows if where == 0}


def _projection(path: Path, tags: Any) -> tuple[Forward, Forward]:
    """From longitude and latitude, and back."""
    keys = _keys(tags)
    code = keys.get(PROJECTED) or (keys.get(GEOGRAPHIC) if keys.get(MODEL_TYPE) != PROJECTED_MODEL else None)
    if code is None:
        _refuse(path, "it does not say in which coordinates it is")
    if code == 4326:
        return _same, _same
    if code == 3857:
        return to_mercator, from_mercator
    zone, south = code % 100, code // 100 == 327
    if code // 100 in (326, 327) and 1 <= zone <= 60:
        return utm(zone, south)
    _refuse(path, f"its coordinates are EPSG:{code}, and not 4326, 3857 or a UTM zone of WGS84")


def _same(first: Floats, second: Floats) -> tuple[Floats, Floats]:
    return first, second


RADIUS, FLATTENING = 6378137.0, 1.0 / 298.257223563
"""of WGS84, m"""


def to_mercator(lon: Floats, lat: Floats) -> tuple[Floats, Floats]:
    return RADIUS * np.radians(lon), RADIUS * np.arcsinh(np.tan(np.radians(lat)))


def from_mercator(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    return np.degrees(x / RADIUS), np.degrees(np.arctan(np.sinh(y / RADIUS)))


N = FLATTENING / (2.0 - FLATTENING)
A = RADIUS / (1.0 + N) * (1.0 + N**2 / 4.0 + N**4 / 64.0)
ALPHA = (N / 2 - 2 * N**2 / 3 + 5 * N**3 / 16, 13 * N**2 / 48 - 3 * N**3 / 5, 61 * N**3 / 240)
BETA = (N / 2 - 2 * N**2 / 3 + 37 * N**3 / 96, N**2 / 48 + N**3 / 15, 17 * N**3 / 480)
DELTA = (2 * N - 2 * N**2 / 3 - 2 * N**3, 7 * N**2 / 3 - 8 * N**3 / 5, 56 * N**3 / 15)
SHRINK, FALSE_EAST, FALSE_NORTH = 0.9996, 500_000.0, 10_000_000.0


def utm(zone: int, south: bool) -> tuple[Forward, Forward]:
    middle, shift = math.radians(6.0 * zone - 183.0), FALSE_NORTH if south else 0.0

    def forward(lon: Floats, lat: Floats) -> tuple[Floats, Floats]:
        sine, away = np.sin(np.radians(lat)), np.radians(lon) - middle
        root = 2.0 * math.sqrt(N) / (1.0 + N)
        t = np.sinh(np.arctanh(sine) - root * np.arctanh(root * sine))
        xi, eta = np.arctan2(t, np.cos(away)), np.arctanh(np.sin(away) / np.sqrt(1.0 + t**2))
        x = eta + sum(a * np.cos(2 * j * xi) * np.sinh(2 * j * eta) for j, a in enumerate(ALPHA, 1))
        y = xi + sum(a * np.sin(2 * j * xi) * np.cosh(2 * j * eta) for j, a in enumerate(ALPHA, 1))
        return FALSE_EAST + SHRINK * A * x, shift + SHRINK * A * y

    def back(x: Floats, y: Floats) -> tuple[Floats, Floats]:
        xi, eta = (y - shift) / (SHRINK * A), (x - FALSE_EAST) / (SHRINK * A)
        flat = xi - sum(b * np.sin(2 * j * xi) * np.cosh(2 * j * eta) for j, b in enumerate(BETA, 1))
        away = eta - sum(b * np.cos(2 * j * xi) * np.sinh(2 * j * eta) for j, b in enumerate(BETA, 1))
        chi = np.arcsin(np.sin(flat) / np.cosh(away))
        lat = chi + sum(d * np.sin(2 * j * chi) for j, d in enumerate(DELTA, 1))
        return np.degrees(middle + np.arctan2(np.sinh(away), np.cos(flat))), np.degrees(lat)

    return forward, back
