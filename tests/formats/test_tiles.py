"""Where heights come from: tiles in a folder, on a server, and a GeoTIFF."""

from __future__ import annotations

import gzip
import http.server
import io
import socket
import threading
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from zmav.errors import BadInput, TimedOut
from zmav.formats.tiles import Folder, Server, open_source
from zmav.process import free_port
from zmav.terrain import VOID, name_of, piece_at

SIDE = 1201
STEP = 20


def height(row: int, column: int) -> int:
    """Some height for each place of a tile, other ones for neighbours."""
    return (7 * row + 3 * column) % 4000


def tile() -> bytes:
    places = np.arange(SIDE)
    return bytes((np.add.outer(7 * places, 3 * places) % 4000).astype(">i2").tobytes())


def with_password() -> bytes:
    """An archive that says that it has one."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as archive:
        archive.writestr("S36E149.hgt", tile())
    data = bytearray(made.getvalue())
    data[6] |= 1
    data[data.rindex(b"PK\x01\x02") + 8] |= 1
    return bytes(data)


def torn_inside() -> bytes:
    """An archive packed by LZMA, whose content is spoilt."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("S36E149.hgt", tile())
    data = bytearray(made.getvalue())
    data[60:90] = bytes(each ^ 0xA5 for each in data[60:90])
    return bytes(data)


@pytest.fixture(scope="module")
def packed() -> dict[str, bytes]:
    return {"S36E149.hgt": tile()}


@pytest.mark.parametrize("ending", ["", ".gz", ".zip"])
def test_pieces_of_a_tile(tmp_path: Path, packed: dict[str, bytes], ending: str) -> None:
    data, path = packed["S36E149.hgt"], tmp_path / f"S36E149.hgt{ending}"
    if ending == ".zip":
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("S36E149.hgt", data)
    else:
        path.write_bytes(gzip.compress(data, 1) if ending else data)
    source = open_source(str(tmp_path), tmp_path)
    piece = source.piece("S36E149-38-09")
    assert piece is not None
    assert piece.side == STEP + 1
    top, left = (59 - 38) * STEP, 9 * STEP
    expected = [height(top + r, left + c) for r in range(STEP + 1) for c in range(STEP + 1)]
    assert list(piece.heights) == expected
    name, north, east = piece_at(-36.0 + 1000 / 1200, 149.0 + 200 / 1200)
    corner = source.piece(name)
    assert corner is not None
    assert corner.height(north, east) == pytest.approx(height(200, 200))
    assert source.piece("S37E149-38-09") is None


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("S36E149.hgt", b"short", "has 5 bytes"),
        ("S36E149.hgt.gz", b"no gzip", "S36E149.hgt.gz"),
        ("S36E149.hgt.zip", b"no archive", "S36E149.hgt.zip"),
        ("S36E149.hgt.zip", with_password(), "password"),
        ("S36E149.hgt.zip", torn_inside(), "S36E149.hgt.zip"),
        ("S36E149.hgt.gz", gzip.compress(tile(), 1)[:5000], "S36E149.hgt.gz"),
    ],
)
def test_what_is_no_tile_is_refused(tmp_path: Path, name: str, data: bytes, words: str) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(BadInput, match=words):
        Folder(tmp_path).piece("S36E149-38-09")


@pytest.mark.parametrize("what", ["/no/such/folder", "https://host/tiles.hgt", "dem.txt"])
def test_what_is_no_source_is_refused(what: str, tmp_path: Path) -> None:
    with pytest.raises(BadInput) as caught:
        open_source(what, tmp_path)
    assert caught.value.detail["field"] == "from"


class Tiles(http.server.BaseHTTPRequestHandler):
    """Has one tile, is broken for another, and knows no others."""

    data = b""
    asked: ClassVar[list[str]] = []

    def do_GET(self) -> None:
        self.asked.append(self.path)
        status = {"/S36/S36E149.hgt.gz": 200, "/S36/S36E150.hgt.gz": 500}.get(self.path, 404)
        self.send_response(status)
        self.end_headers()
        if status == 200:
            self.wfile.write(self.data)

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def server() -> Iterator[tuple[str, list[str]]]:
    Tiles.data, Tiles.asked = gzip.compress(tile(), 1), []
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Tiles) as web:
        thread = threading.Thread(target=web.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{web.server_port}/{{band}}/{{cell}}.hgt.gz", Tiles.asked
        web.shutdown()
        thread.join()


def test_tiles_of_a_server_are_fetched_once(server: tuple[str, list[str]], tmp_path: Path) -> None:
    url, asked = server
    source = open_source(url, tmp_path / "tiles")
    assert source.piece("S36E149-38-09") is not None
    assert source.piece("S36E149-39-09") is not None
    assert source.piece("S37E149-38-09") is None
    assert source.piece("S37E149-38-10") is None
    assert asked == ["/S36/S36E149.hgt.gz", "/S37/S37E149.hgt.gz"]
    assert Server(url, tmp_path / "tiles").piece("S36E149-38-09") is not None
    assert len(asked) == 2, "it is kept"
    with pytest.raises(BadInput, match="500"):
        source.piece("S36E150-00-00")


def test_what_a_server_sends_is_a_tile_or_is_not_kept(server: tuple[str, list[str]], tmp_path: Path) -> None:
    Tiles.data = gzip.compress(b"a page that says sorry")
    with pytest.raises(BadInput, match="22 bytes"):
        Server(server[0], tmp_path).piece("S36E149-38-09")
    assert list(tmp_path.iterdir()) == []


def test_a_server_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(TimedOut, match="load the tiles where there is a network"):
        Server(f"http://127.0.0.1:{free_port()}/{{cell}}.hgt", tmp_path).piece("S36E149-38-09")


@pytest.mark.parametrize("host", ["[x", "a..b", "127.0.0.1:80a", "127.0.0.1/a b"])
def test_what_is_no_address_of_a_server(tmp_path: Path, host: str) -> None:
    with pytest.raises(BadInput, match="https://HOST/"):
        Server(f"http://{host}/{{cell}}.hgt", tmp_path).piece("S36E149-38-09")


def test_what_is_no_web_server(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def answer() -> None:
            with listener.accept()[0] as connection:
                connection.recv(4096)
                connection.sendall(b"SSH-2.0-no\r\n")

        thread = threading.Thread(target=answer)
        thread.start()
        with pytest.raises(TimedOut, match="SSH-2"):
            Server(f"http://127.0.0.1:{listener.getsockname()[1]}/{{cell}}.hgt", tmp_path).piece("S36E149-38-09")
        thread.join()


def test_a_geotiff_in_metres_gives_the_heights_of_its_places(tmp_path: Path) -> None:
    """In UTM: a plane that rises by 1 m in 100 m to the east and 1 m in 50 m to the north."""
    rasterio = pytest.importorskip("rasterio", reason="the extra 'terrain' is not installed")
    from_origin = pytest.importorskip("rasterio.transform").from_origin
    transform = pytest.importorskip("rasterio.warp").transform

    left, top, step, size = 690_000.0, 6_086_000.0, 20.0, 400
    east, north = np.meshgrid(left + step * (np.arange(size) + 0.5), top - step * (np.arange(size) + 0.5))
    heights = (500.0 + (east - left) / 100.0 + (north - (top - step * size)) / 50.0).astype("float32")
    path = tmp_path / "dem.tif"
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        width=size,
        height=size,
        count=1,
        dtype="float32",
        crs="EPSG:32755",
        transform=from_origin(left, top, step, step),
    ) as made:
        made.write(heights, 1)
    (lon,), (lat,) = transform("EPSG:32755", "EPSG:4326", [694_000.0], [6_082_000.0])
    name, up, right = piece_at(lat, lon)
    source = open_source(str(path), tmp_path)
    piece = source.piece(name)
    assert piece is not None
    assert piece.height(up, right) == pytest.approx(500.0 + 40.0 + 80.0, abs=1.0)
    assert source.piece(name_of(0, 0)) is None
    edge = source.piece(piece_at(*reversed([c[0] for c in transform("EPSG:32755", "EPSG:4326", [left], [top])]))[0])
    assert edge is not None
    assert VOID in edge.heights, "what is outside is not known"
    (tmp_path / "broken.tif").write_bytes(b"II*\0 and no more")
    with pytest.raises(BadInput, match=r"broken\.tif"):
        open_source(str(tmp_path / "broken.tif"), tmp_path)
