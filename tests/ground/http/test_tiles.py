"""The user's own pictures of the ground, as they are served and as the page shows them."""

from __future__ import annotations

import sqlite3
import struct
import zlib
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from ground.http.guard import Rules
from ground.http.tiles import Tiles
from tests.ground.http.browser import Tab
from zmav.errors import BadConfig

if TYPE_CHECKING:
    from tests.ground.http.conftest import Serve


def png(side: int = 256) -> bytes:
    """A grey picture: https://www.w3.org/TR/png-3/"""

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    rows = (b"\0" + b"\x80" * side) * side
    head = struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


@pytest.fixture
def mbtiles(tmp_path: Path) -> Path:
    """One tile at zoom 1, north-west: row 1 from the south."""
    path = tmp_path / "field.mbtiles"
    with sqlite3.connect(path) as file:
        file.execute("CREATE TABLE tiles (zoom_level integer, tile_column integer, tile_row integer, tile_data blob)")
        file.execute("INSERT INTO tiles VALUES (1, 0, 1, ?)", (png(),))
    file.close()
    return path


@pytest.fixture
def pmtiles(tmp_path: Path) -> Path:
    """One tile, of the whole world."""
    picture = png()
    root = b"".join(map(varint, (1, 0, 1, len(picture), 1)))
    meta, start = b"{}", 127
    places = (start, len(root), start + len(root), len(meta), 0, 0, start + len(root) + len(meta), len(picture))
    head = b"PMTiles\x03" + struct.pack("<11Q", *places, 1, 1, 1) + bytes([1, 1, 1, 2, 0, 0])
    head += struct.pack("<4i", -1800000000, -850000000, 1800000000, 850000000) + bytes([0]) + struct.pack("<2i", 0, 0)
    path = tmp_path / "field.pmtiles"
    path.write_bytes(head + root + meta + picture)
    return path


def test_tiles_are_served_and_nothing_else_is(serve: Serve, mbtiles: Path, pmtiles: Path) -> None:
    served = serve(tiles=Tiles(mbtiles))
    reply = served.get("/tiles/1/0/0")
    assert (reply.status, reply.headers["content-type"], reply.body) == (200, "image/png", png())
    for path in ("/tiles/1/0/1", "/tiles/1/7/0", "/tiles/99/0/0", "/tiles"):
        assert served.get(path).status == 404, path
    served = serve(tiles=Tiles(pmtiles))
    part = served.request("GET", "/tiles", range="bytes=0-126")
    assert (part.status, part.body) == (206, pmtiles.read_bytes()[:127])
    assert serve().get("/tiles").status == 404


def test_a_file_that_holds_no_tiles_is_refused(tmp_path: Path) -> None:
    other = tmp_path / "notes.txt"
    other.write_text("no tiles")
    broken = tmp_path / "broken.mbtiles"
    broken.write_bytes(b"SQLite format 3\0" + b"x" * 100)
    for path in (other, broken, tmp_path / "missing.pmtiles"):
        with pytest.raises(BadConfig, match=path.name):
            Tiles(path)


@pytest.mark.asyncio(loop_scope="module")
@pytest.mark.parametrize("kind", ["mbtiles", "pmtiles"])
async def test_the_page_shows_them(tab: Tab, serve: Serve, kind: str, request: pytest.FixtureRequest) -> None:
    served = serve(Rules(token="secret"), tiles=Tiles(request.getfixturevalue(kind)))
    await tab.open(f"http://127.0.0.1:{served.port}/?token=secret")
    await tab.until("document.querySelector('.leaflet-ground-pane .leaflet-tile-loaded').naturalWidth === 256")
    assert [each for each in tab.said if "404" not in each] == []  # MBTiles have no tile for the rest of the world
