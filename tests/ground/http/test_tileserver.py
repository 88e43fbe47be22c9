"""Pictures from a tile server: asked for once, kept in a bounded file, served from there without a network."""

from __future__ import annotations

import contextlib
import http.server
import sqlite3
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from click.testing import CliRunner

from ground.http import tileserver
from ground.http.cli import command
from ground.http.tiles import Picture
from ground.http.tileserver import TileServer
from tests.ground.http.test_tiles import png
from zmav.errors import BadConfig

if TYPE_CHECKING:
    from tests.ground.http.conftest import Serve

PLENTY = 10_000_000


class Server:
    """Tiles of 1000 bytes and more, each with its address in it."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.status, self.extra = 200, b""
        outer = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                outer.asked.append(self.path)
                body = (png() + self.path.encode()).ljust(1000, b"\0") + outer.extra
                self.send_response(outer.status)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_: object) -> None:
                pass

        self._server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()
        self.url = f"http://127.0.0.1:{self._server.server_port}/{{z}}/{{x}}/{{y}}.png"

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


@pytest.fixture
def server() -> Iterator[Server]:
    server = Server()
    yield server
    server.close()


def total(tiles: TileServer) -> int:
    with contextlib.closing(sqlite3.connect(tiles.path)) as file:
        return int(file.execute("SELECT total(length(data)) FROM tiles").fetchone()[0])


async def test_a_tile_is_asked_for_once_and_outlives_the_server(server: Server, tmp_path: Path) -> None:
    tiles = TileServer(server.url, tmp_path, PLENTY)
    first = await tiles.fetch(3, 1, 2)
    assert first is not None and b"/3/1/2.png" in first
    assert await tiles.fetch(3, 1, 2) == first and server.asked == ["/3/1/2.png"]
    tiles.close()
    server.close()
    offline = TileServer(server.url, tmp_path, PLENTY)
    assert await offline.fetch(3, 1, 2) == first
    assert await offline.fetch(3, 1, 3) is None
    offline.close()


async def test_the_cache_is_bounded_and_keeps_what_was_used_last(server: Server, tmp_path: Path) -> None:
    tiles = TileServer(server.url, tmp_path, 20_000)
    tiles.used_s = 0.0
    for n in range(60):
        await tiles.fetch(9, n, 0)
        await tiles.fetch(9, 0, 0)  # somebody looks at this one all the time
        assert total(tiles) <= 20_000
    assert server.asked.count("/9/0/0.png") == 1
    assert tiles.path.stat().st_size < 200_000
    tiles.close()
    again = TileServer(server.url, tmp_path, 20_000)
    assert again.size == total(again) > 10_000
    again.close()


def refuse(tiles: TileServer, what: str) -> None:
    """As a disk that is full: nothing can be written."""
    with contextlib.closing(sqlite3.connect(tiles.path)) as file:
        file.execute(f"CREATE TRIGGER full BEFORE {what} ON tiles BEGIN SELECT RAISE(ABORT, 'full'); END")


def allow(tiles: TileServer) -> None:
    with contextlib.closing(sqlite3.connect(tiles.path)) as file:
        file.execute("DROP TRIGGER full")


async def test_a_tile_that_is_kept_is_served_where_nothing_can_be_written(server: Server, tmp_path: Path) -> None:
    tiles = TileServer(server.url, tmp_path, PLENTY)
    first = await tiles.fetch(3, 1, 2)
    tiles.used_s = 0.0
    refuse(tiles, "UPDATE")
    server.close()
    assert await tiles.fetch(3, 1, 2) == first is not None
    tiles.close()


async def test_the_cache_is_bounded_again_once_there_is_room_to_write(server: Server, tmp_path: Path) -> None:
    tiles = TileServer(server.url, tmp_path, 20_000)
    await tiles.fetch(9, 0, 0)
    refuse(tiles, "DELETE")
    for n in range(30):
        assert await tiles.fetch(9, n, 0) is not None
    allow(tiles)
    for n in range(30, 34):
        await tiles.fetch(9, n, 0)
    assert tiles.size == total(tiles) <= 20_000
    tiles.close()


async def test_an_old_tile_is_asked_for_again_and_served_until_there_is_a_new_one(
    server: Server, tmp_path: Path
) -> None:
    tiles = TileServer(server.url, tmp_path, PLENTY)
    old = await tiles.fetch(1, 0, 0)
    tiles.fresh_s = 0.0
    server.status = 404
    assert await tiles.fetch(1, 0, 0) == old and len(server.asked) == 2
    server.status, server.extra = 200, b"new"
    assert (await tiles.fetch(1, 0, 0) or b"").endswith(b"new")
    tiles.close()


async def test_what_is_too_large_or_refused_is_no_tile(server: Server, tmp_path: Path) -> None:
    tiles = TileServer(server.url, tmp_path, PLENTY)
    server.extra = b"x" * tileserver.LARGEST
    assert await tiles.fetch(1, 0, 0) is None
    server.extra, server.status = b"", 429
    assert await tiles.fetch(1, 0, 1) is None
    server.status = 200
    count = len(server.asked)
    assert await tiles.fetch(1, 1, 1) is None and len(server.asked) == count, "it asked to be left alone"
    tiles.close()


def test_the_page_has_tiles_of_a_server_and_a_picture(serve: Serve, server: Server, tmp_path: Path) -> None:
    path = tmp_path / "field.png"
    path.write_bytes(png())
    picture = Picture(path, (-35.37, 149.15, -35.36, 149.17))
    served = serve(tiles=TileServer(server.url, tmp_path, PLENTY), picture=picture)
    reply = served.get("/tiles/3/1/2")
    assert (reply.status, reply.headers["content-type"]) == (200, "image/png")
    assert served.get("/tiles/3/9/2").status == 404 and server.asked == ["/3/1/2.png"]
    assert served.get("/picture").body == png()
    assert 'name="zmav-picture" content="-35.37 149.15 -35.36 149.17"' in served.get("/").text
    assert serve().get("/picture").status == 404


@pytest.mark.parametrize("url", ["file:///etc/{z}/{x}/{y}", "https://host/tiles", "host/{z}/{x}/{y}", ""])
def test_what_is_no_tile_server_is_refused(url: str, tmp_path: Path) -> None:
    with pytest.raises(BadConfig, match=r"expected https://HOST/\{z\}/\{x\}/\{y\}\.png"):
        TileServer(url, tmp_path, PLENTY)


def test_a_folder_that_is_none_is_named(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(BadConfig, match="tile cache"):
        TileServer("https://host/{z}/{x}/{y}", tmp_path / "taken", PLENTY)


def test_a_picture_that_cannot_be_shown_or_lies_nowhere_is_refused(tmp_path: Path) -> None:
    tiff = tmp_path / "field.tif"
    tiff.write_bytes(b"II*\0" + b"\0" * 20)
    with pytest.raises(BadConfig, match="gdal_translate"):
        Picture(tiff, (0.0, 0.0, 1.0, 1.0))
    for corners in ((1.0, 0.0, 0.0, 1.0), (0.0, 0.0, 91.0, 1.0), (0.0, 1.0, 1.0, 0.0)):
        with pytest.raises(BadConfig, match="corners"):
            Picture(tiff, corners)
    with pytest.raises(BadConfig, match=r"none\.png"):
        Picture(tmp_path / "none.png", (0.0, 0.0, 1.0, 1.0))


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (["--tiles", "a.mbtiles", "--tile-server", "https://h/{z}/{x}/{y}"], "one of --tiles and --tile-server"),
        (["--picture", "a.png"], "give --picture and --corners"),
        (["--corners", "1,2,3"], "S,W,N,E"),
        (["--tile-space", "much"], "not a number with its unit"),
    ],
)
def test_options_that_do_not_fit_are_told_at_once(given: list[str], text: str) -> None:
    result = CliRunner().invoke(command, given)
    assert result.exit_code == 2 and text in result.output
