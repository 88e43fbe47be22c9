"""A GeoTIFF as a picture that lies straight on the page's map, which is in Web Mercator: read and bent by rasterio."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np

from zmav.errors import BadConfig, ZmavError, needs

Corners = tuple[float, float, float, float]

MAGICS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
MOST_SIDE, MOST_PIXELS = 4096, 120_000_000
"""pixels of the picture's longer side, and of what is read for it, once, while nobody is served"""
EDGE = 17
"""points of each edge that are looked at for its bounds"""
MERCATOR, DEGREES = "EPSG:3857", "EPSG:4326"
FARTHEST = 6378137.0 * math.pi, 6378137.0 * math.asinh(math.tan(math.radians(85.0)))
"""m of Web Mercator, east and north: as far as a map goes"""
HELP = "'gdalwarp -t_srs EPSG:4326 -ot Byte IN.tif OUT.tif' makes one that can be shown"


class Laid(NamedTuple):
    """What the page shows."""

    data: bytes
    kind: str
    corners: Corners
    """south, west, north, east; degrees"""


def lay(path: Path, side: int = MOST_SIDE, most: int = MOST_PIXELS) -> Laid:
    """Read and bend it, once, to so many pixels of the longer ``side``; at most so many are read for it. Raises
    :class:`BadConfig` for a file that cannot be shown, with what helps.
    """
    needs("a GeoTIFF", "geotiff", "rasterio")
    import rasterio

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what is wrong with it is said once, by what it leads to
            with rasterio.open(path, driver="GTiff") as file:
                return _laid(path, file, side, most)
    except ZmavError:
        raise
    except Exception as e:  # of GDAL, for a file that is broken
        _refuse(path, f"cannot be read as a picture: {type(e).__name__} {e}")


def _refuse(path: Path, why: str) -> NoReturn:
    text = f"picture {path}: {why}; {HELP}"
    raise BadConfig(text, field="picture", value=str(path), expected="a GeoTIFF of colours that says where it lies")


def _laid(path: Path, file: Any, side: int, most: int) -> Laid:
    from rasterio.io import MemoryFile
    from rasterio.transform import from_bounds
    from rasterio.warp import Resampling, reproject, transform

    west, south, east, north = _bounds(path, file)
    source = _colours(path, file, side, most)
    _, height, width = source.shape
    placed = file.transform * file.transform.scale(file.width / width, file.height / height)
    ratio, longer = (east - west) / (north - south), min(side, max(width, height))
    size = (longer, max(1, round(longer / ratio))) if ratio >= 1.0 else (max(1, round(longer * ratio)), longer)
    shown = np.zeros((4, size[1], size[0]), dtype=np.uint8)
    there = {"dst_transform": from_bounds(west, south, east, north, *size), "dst_crs": MERCATOR}
    reproject(source, shown, src_transform=placed, src_crs=file.crs, resampling=Resampling.bilinear, **there)
    with MemoryFile() as made:
        form = {"driver": "WEBP", "width": size[0], "height": size[1], "count": 4, "dtype": "uint8", "quality": 85}
        with made.open(**form) as picture:
            picture.write(shown)
        data = bytes(made.read())
    (left, right), (bottom, top) = transform(MERCATOR, DEGREES, [west, east], [south, north])
    return Laid(data, "image/webp", (bottom, left, top, right))


def _bounds(path: Path, file: Any) -> tuple[float, float, float, float]:
    """West, south, east, north of its outline; m of Web Mercator."""
    from rasterio.transform import xy
    from rasterio.warp import transform

    if file.crs is None or not file.crs.is_valid:
        _refuse(path, "it does not say in which coordinates it is")
    if file.transform.is_identity:
        _refuse(path, "it has no georeference of one scale or one transformation")
    if not (np.isfinite(file.transform).all() and abs(file.transform.determinant) > 1e-30):
        _refuse(path, "its georeference gives it no extent")
    along, zero = np.linspace(0.0, 1.0, EDGE), np.zeros(EDGE)
    columns = np.concatenate((along, along, zero, zero + 1.0)) * file.width
    rows = np.concatenate((zero, zero + 1.0, along, along)) * file.height
    try:
        easts, norths = map(np.array, transform(file.crs, MERCATOR, *xy(file.transform, rows, columns, offset="ul")))
    except Exception as e:  # PROJ's own, for a place that the projection has not
        _refuse(path, f"its georeference does not lie on the map ({e})")
    if not (np.isfinite([easts, norths]).all() and (np.abs([easts, norths]).max(axis=1) <= FARTHEST).all()):
        _refuse(path, "its georeference does not lie on the map")
    if np.abs(np.diff(easts.reshape(4, EDGE), axis=1)).max() > FARTHEST[0]:
        _refuse(path, "it lies across the 180th meridian, where the map ends")
    if np.ptp(easts) <= 0.0 or np.ptp(norths) <= 0.0:
        _refuse(path, "its georeference gives it no extent")
    return float(easts.min()), float(norths.min()), float(easts.max()), float(norths.max())


def _colours(path: Path, file: Any, side: int, most: int) -> Any:
    """(4, height, width): red, green, blue and how opaque; the longer side at most ``side``."""
    from rasterio.enums import ColorInterp, Resampling

    if set(file.dtypes) != {"uint8"}:
        _refuse(path, f"its pixels are numbers ({file.dtypes[0]}), and no colours of 8 bits")
    factor = max(1.0, max(file.width, file.height) / side)
    over = max((each for each in file.overviews(1) if each <= factor), default=1)
    if file.width * file.height / over**2 > most:
        pixels = f"{file.width} x {file.height}"
        _refuse(path, f"{pixels} pixels are too many without overviews ('gdaladdo -r average {path.name}' adds them)")
    shape = max(1, round(file.height / factor)), max(1, round(file.width / factor))
    named = file.colorinterp[0] is ColorInterp.palette
    bands = [1, 2, 3] if file.count >= 3 else [1]
    how = Resampling.nearest if named else Resampling.average
    colours = file.read(bands, out_shape=(len(bands), *shape), resampling=how)
    opaque = file.dataset_mask(out_shape=shape)[np.newaxis]
    if named:
        table = np.zeros((256, 3), dtype=np.uint8)
        for index, colour in file.colormap(1).items():
            table[index] = colour[:3]
        colours = np.moveaxis(table[colours[0]], -1, 0)
    return np.concatenate((np.broadcast_to(colours, (3, *shape)), opaque))
