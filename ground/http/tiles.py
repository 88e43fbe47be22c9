"""``/tiles``: the user's own pictures of the ground, out of one file: PMTiles by ranges, MBTiles tile by tile.

https://github.com/protomaps/PMTiles/blob/main/spec/v3/spec.md, https://github.com/mapbox/mbtiles-spec
"""

from __future__ import annotations

import asyncio
import contextlib
import sqlite3
from pathlib import Path

from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import BaseRoute, Route

from ground.http.gateway import Gateway
from ground.http.reply import Failure
from zmav.errors import BadConfig

MAGIC = {b"PMTiles\x03": "pmtiles", b"SQLite f": "mbtiles"}
PICTURES = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg", b"RIFF": "image/webp"}


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

    def tile(self, z: int, x: int, y: int) -> bytes | None:
        """Rows are counted from the south in the file, from the north in addresses."""
        where = "zoom_level=? AND tile_column=? AND tile_row=?"
        found = self._query(f"SELECT tile_data FROM tiles WHERE {where}", z, x, (1 << z) - 1 - y)
        return found if isinstance(found, bytes) else None


def routes(gateway: Gateway) -> list[BaseRoute]:
    tiles = gateway.tiles

    async def file(request: Request) -> Response:
        """The file of tiles that the gateway was started with, or the part that a Range header asks for."""
        if tiles is None or tiles.kind != "pmtiles":
            raise Failure(404, "not_found", "no PMTiles here: zmav http --tiles FILE.pmtiles")
        return FileResponse(tiles.path, media_type="application/vnd.pmtiles")

    async def tile(request: Request) -> Response:
        """One tile of the MBTiles that the gateway was started with."""
        z, x, y = (request.path_params[name] for name in "zxy")
        inside = tiles is not None and tiles.kind == "mbtiles" and z <= 30 and x < 1 << z and y < 1 << z
        data = await asyncio.to_thread(tiles.tile, z, x, y) if tiles is not None and inside else None
        if data is None:
            raise Failure(404, "not_found", "there is no such tile")
        kind = next((kind for magic, kind in PICTURES.items() if data.startswith(magic)), "application/octet-stream")
        return Response(data, media_type=kind, headers={"X-Content-Type-Options": "nosniff"})

    return [
        Route("/tiles", file, methods=["GET"]),
        Route("/tiles/{z:int}/{x:int}/{y:int}", tile, methods=["GET"]),
    ]
