"""The user's own pictures of the ground, out of one file: PMTiles by ranges, MBTiles tile by tile.

https://github.com/protomaps/PMTiles/blob/main/spec/v3/spec.md, https://github.com/mapbox/mbtiles-spec
"""

from __future__ import annotations

import asyncio
import contextlib
import sqlite3
from pathlib import Path

from ground.http.geotiff import MAGICS, Corners, lay
from zmav.errors import BadConfig

MAGIC = {b"PMTiles\x03": "pmtiles", b"SQLite f": "mbtiles"}
PICTURES = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg", b"RIFF": "image/webp"}


class Picture:
    """A picture of the user's own, laid over the map: ``corners`` are south, west, north, east in degrees; a GeoTIFF
    says its own. Raises :class:`BadConfig` where it is none that a browser shows, or lies nowhere.
    """

    def __init__(self, path: Path, corners: Corners | None = None) -> None:
        self.path = path
        self.data: bytes | None = None
        """of a GeoTIFF, as it is shown; None: the file's own"""
        south, west, north, east = corners or (0.0, 0.0, 1.0, 1.0)
        if not (-90.0 <= south < north <= 90.0 and -180.0 <= west < east <= 180.0):
            expected = "degrees: south, west, north, east, as -35.37,149.15,-35.36,149.17"
            raise BadConfig(f"picture {path}: corners {corners}", field="corners", value=corners, expected=expected)
        try:
            with path.open("rb") as file:
                head = file.read(12)
        except OSError as e:
            raise BadConfig(f"picture {path}: {e}", field="picture", value=str(path), expected="a readable file") from e
        if head.startswith(MAGICS):
            if corners is not None:
                text = f"picture {path}: a GeoTIFF says itself where it lies"
                text += "; 'gdal_translate -of PNG' makes a picture that does not"
                raise BadConfig(text, field="corners", value=corners, expected="no corners")
            self.data, self.kind, self.corners = lay(path)
            return
        if corners is None:
            text = f"picture {path}: it lies somewhere: give its corners"
            raise BadConfig(text, field="corners", value=None, expected="south, west, north, east in degrees")
        self.corners = corners
        self.kind = next((kind for magic, kind in PICTURES.items() if head.startswith(magic)), "")
        if not self.kind:
            text = f"picture {path}: no PNG, JPEG, WebP or GeoTIFF"
            raise BadConfig(
                text, field="picture", value=str(path), expected="FILE.png, FILE.jpg, FILE.webp or FILE.tif"
            )


class Tiles:
    """One file. Raises :class:`BadConfig` where it is none that can be shown."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            with path.open("rb") as file:
                self.kind = MAGIC.get(file.read(8), "")
            self.closest = self._query("SELECT max(zoom_level) FROM tiles") if self.kind == "mbtiles" else None
        except (OSError, sqlite3.Error) as e:
            raise BadConfig(f"tiles {path}: {e}", field="tiles", value=str(path), expected="a readable file") from e
        if not self.kind:
            text = f"tiles {path}: neither PMTiles (version 3) nor MBTiles"
            raise BadConfig(text, field="tiles", value=str(path), expected="FILE.pmtiles or FILE.mbtiles")

    def _query(self, text: str, *values: int) -> object:
        """The first value of the first row; None: there is none."""
        with contextlib.closing(sqlite3.connect(f"{self.path.resolve().as_uri()}?mode=ro", uri=True)) as file:
            row = file.execute(text, values).fetchone()
        return row[0] if row else None

    async def fetch(self, z: int, x: int, y: int) -> bytes | None:
        return await asyncio.to_thread(self.tile, z, x, y)

    def close(self) -> None:
        """Nothing is held."""

    def tile(self, z: int, x: int, y: int) -> bytes | None:
        """Rows are counted from the south in the file, from the north in addresses."""
        where = "zoom_level=? AND tile_column=? AND tile_row=?"
        found = self._query(f"SELECT tile_data FROM tiles WHERE {where}", z, x, (1 << z) - 1 - y)
        return found if isinstance(found, bytes) else None
