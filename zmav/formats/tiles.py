"""Where heights of the ground come from: a folder of SRTM's ``.hgt`` tiles, a server that has them, or a GeoTIFF.

Each source gives :class:`~zmav.terrain.Piece`. A tile is 1201 by 1201 or 3601 by 3601 heights (3 or 1 arc second), as
it is or packed as ``.hgt.gz`` or ``.hgt.zip``. A GeoTIFF in any projection is read by rasterio, an extra, and sampled
at one arc second.
"""

from __future__ import annotations

import array
import functools
import gzip
import http.client
import itertools
import lzma
import math
import re
import urllib.error
import urllib.request
import zipfile
import zlib
from pathlib import Path
from typing import Any, Protocol

from zmav.errors import BadInput, TimedOut, needs
from zmav.terrain import HIGHEST, LOWEST, MINUTES, VOID, Piece, cell_name, corner_of, heights_of, names_within

SIDES = (1201, 3601)
"""heights along a tile's side"""
MOST = 64 << 20
"""bytes of a tile, packed or not"""
MOST_PIECES = 4096
"""at one go: some 100 km by 100 km"""
PATIENCE = 60.0
"""s for a server to answer"""
ENDINGS = ("", ".gz", ".zip")


class Source(Protocol):
    """Heights of an area."""

    def piece(self, name: str) -> Piece | None:
        """None where the source has nothing there. Raises :class:`~zmav.errors.BadInput` for what cannot be read."""


def open_source(what: str, cache: Path) -> Source:
    """A folder, a GeoTIFF or a URL with ``{cell}`` in it (``S36E149``; ``{band}`` is ``S36``), whose tiles are kept in
    ``cache``. Raises :class:`~zmav.errors.BadInput` for what is none of these.
    """
    if re.match(r"https?://", what):
        if "{cell}" not in what:
            raise BadInput.wrong("from", what, "a URL with {cell} in it, as https://HOST/{band}/{cell}.hgt.gz")
        return Server(what, cache)
    path = Path(what).expanduser()
    if path.is_dir():
        return Folder(path)
    if path.suffix.lower() in (".tif", ".tiff"):
        return Raster(path)
    raise BadInput.wrong("from", what, "a folder of .hgt tiles, a .tif, or a URL with {cell} in it")


def pieces_within(source: Source, south: float, west: float, north: float, east: float) -> dict[str, Piece]:
    """The pieces of an area that a source has; raises :class:`BadInput` where it has none, or they are too many."""
    area = (south, west, north, east)
    if not -90.0 <= south <= north < 90.0:
        raise BadInput.wrong("area", area, "south,west,north,east in degrees")
    wanted = list(itertools.islice(names_within(*area), MOST_PIECES + 1))
    if len(wanted) > MOST_PIECES:
        raise BadInput.wrong("area", area, f"at most {MOST_PIECES} minutes by minutes: a smaller area")
    found = {name: piece for name in wanted if (piece := source.piece(name)) is not None}
    if not found:
        text = f"the source has no ground for {wanted[0]} to {wanted[-1]}"
        raise BadInput(text, field="from", value=wanted[0], expected="heights of that area")
    return found


class Folder:
    """Tiles in a folder, each called by its south-west corner: ``S36E149.hgt``."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._tile = functools.lru_cache(maxsize=4)(self._read)

    def piece(self, name: str) -> Piece | None:
        south, west = corner_of(name)
        (lat, row), (lon, column) = divmod(south, MINUTES), divmod(west, MINUTES)
        tile = self._tile(cell_name(lat, lon))
        if tile is None:
            return None
        side, heights = tile
        step = (side - 1) // MINUTES
        top, left = (MINUTES - 1 - row) * step, column * step
        rows = (heights[(top + i) * side + left : (top + i) * side + left + step + 1] for i in range(step + 1))
        found = array.array("h")
        for each in rows:
            found.extend(each)
        return Piece(step + 1, found)

    def _read(self, cell: str) -> tuple[int, array.array[int]] | None:
        for ending in ENDINGS:
            for name in (f"{cell}.hgt{ending}", f"{cell.lower()}.hgt{ending}"):
                path = self._folder / name
                if path.is_file():
                    return _heights(path)
        return None


class Server:
    """Tiles that are fetched once, and kept; a cell that the server does not have is sea to nobody: it is not known."""

    def __init__(self, url: str, cache: Path) -> None:
        self._url, self._cache = url, cache
        self._folder = Folder(cache)
        self._absent: set[str] = set()

    def piece(self, name: str) -> Piece | None:
        cell = name.split("-")[0]
        if cell not in self._absent and not any((self._cache / f"{cell}.hgt{ending}").is_file() for ending in ENDINGS):
            self._fetch(cell)
        return self._folder.piece(name)

    def _fetch(self, cell: str) -> None:
        url = self._url.replace("{cell}", cell).replace("{band}", cell[:3])
        ending = next((e for e in ENDINGS[1:] if url.partition("?")[0].endswith(e)), "")
        try:
            with urllib.request.urlopen(url, timeout=PATIENCE) as answer:
                data = answer.read(MOST + 1)
        except urllib.error.HTTPError as e:
            if e.code != 404:
                raise BadInput(
                    f"{url}: {e}", field="from", value=url, expected="a server that gives its tiles"
                ) from None
            self._absent.add(cell)
            return
        except (ValueError, http.client.InvalidURL) as e:
            raise BadInput.wrong("from", url, "an address as https://HOST/{cell}.hgt", f"{url}: {e}") from None
        except (OSError, http.client.HTTPException) as e:
            raise TimedOut(f"{url}: {e}; load the tiles where there is a network, and give their folder") from None
        if len(data) > MOST:
            raise BadInput.wrong("from", url, f"a tile of {MOST} bytes at most")
        self._cache.mkdir(parents=True, exist_ok=True)
        path = self._cache / f"{cell}.hgt{ending}"
        part = path.with_name(f"{path.name}.part")
        part.write_bytes(data)
        try:
            _unpacked(part, ending)
        except BadInput:
            part.unlink()
            raise
        part.replace(path)


class Raster:
    """A GeoTIFF of heights in metres above the sea. Raises :class:`~zmav.errors.BadConfig` without rasterio."""

    STEP = 60
    """heights along a piece's side, less one: an arc second each"""

    def __init__(self, path: Path) -> None:
        needs("a GeoTIFF", "terrain", "rasterio")
        import rasterio
        import rasterio.transform
        from rasterio.enums import Resampling
        from rasterio.vrt import WarpedVRT

        self._errors: Any = rasterio.errors.RasterioError
        self._warp = functools.partial(WarpedVRT, crs="EPSG:4326", resampling=Resampling.bilinear, nodata=VOID)
        self._placed: Any = rasterio.transform.from_origin
        try:
            self._file: Any = rasterio.open(path)
        except self._errors as e:
            raise BadInput(f"{path}: {e}", field="from", value=str(path), expected="a GeoTIFF of heights") from None
        if self._file.crs is None:
            raise BadInput.wrong("from", str(path), "a GeoTIFF that says where it lies", f"{path} has no projection")

    def piece(self, name: str) -> Piece | None:
        south, west = corner_of(name)
        side, step = self.STEP + 1, 1.0 / MINUTES / self.STEP
        left, top = west / MINUTES - step / 2.0, (south + 1) / MINUTES + step / 2.0  # a height is in its pixel's middle
        try:
            placed = self._placed(left, top, step, step)
            with self._warp(self._file, transform=placed, width=side, height=side, dtype="float32") as warped:
                rows = warped.read(1).tolist()
        except self._errors as e:
            raise BadInput(f"{name}: {e}", field="from", value=name, expected="a GeoTIFF that can be read") from None
        heights = array.array("h", (_whole(height) for row in rows for height in row))
        return None if all(height == VOID for height in heights) else Piece(side, heights)


def _whole(height: float) -> int:
    return round(height) if math.isfinite(height) and LOWEST <= height <= HIGHEST else VOID


def _unpacked(path: Path, ending: str) -> bytes:
    """The bytes of a tile; raises :class:`BadInput` for a file that is none."""
    try:
        if ending == ".zip":
            with zipfile.ZipFile(path) as packed:
                inner = [info for info in packed.infolist() if info.filename.lower().endswith(".hgt")]
                if len(inner) != 1 or inner[0].file_size > MOST:
                    raise BadInput.wrong(path.name, len(inner), "one .hgt in the archive")
                data = packed.read(inner[0])
        elif ending == ".gz":
            with gzip.open(path) as stream:
                data = stream.read(MOST + 1)
        else:
            data = path.read_bytes()
    except (OSError, EOFError, RuntimeError, lzma.LZMAError, zlib.error, zipfile.BadZipFile) as e:  # or a password
        raise BadInput(f"{path}: {e}", field="from", value=str(path), expected="a tile that can be read") from None
    if len(data) not in (2 * side * side for side in SIDES):
        what = f"{path} has {len(data)} bytes"
        raise BadInput.wrong(path.name, len(data), "1201 by 1201 or 3601 by 3601 heights of two bytes", what)
    return data


def _heights(path: Path) -> tuple[int, array.array[int]]:
    data = _unpacked(path, path.suffix if path.suffix in ENDINGS else "")
    heights = heights_of(data)
    return math.isqrt(len(heights)), heights
