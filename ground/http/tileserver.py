"""Pictures of the ground from a tile server, kept in a file of bounded size: where there is no network it serves those.

Addresses: https://wiki.openstreetmap.org/wiki/Slippy_map_tilenames. What nobody asked for longest goes first.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import http.client
import importlib.metadata
import sqlite3
import threading
import time
import urllib.error
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from urllib.parse import urlsplit

from zmav.errors import BadConfig

AT_ONCE, WAITING = 4, 64
"""requests to the server, and tiles that wait for one: a map that is moved on asks for others"""
TIMEOUT_S, LARGEST = 8.0, 1_000_000
"""for an answer, and bytes of a tile"""
DOWN_S = 15.0
"""for which a server that cannot be reached is left alone"""
ROOM = 0.9
"""share of the size to which a full cache is emptied"""
CLOSEST = 19


class TileServer:
    """``url`` holds ``{z}``, ``{x}``, ``{y}``; ``most`` bytes of tiles are kept below ``folder``. Its :attr:`kind` is
    how a page asks: tile by tile. Raises :class:`BadConfig` where the address is none, or the folder cannot be written.
    """

    kind, closest = "mbtiles", CLOSEST
    fresh_s = 30 * 86400.0
    """after which a tile is asked for again; until an answer comes the old one is served"""
    used_s = 3600.0
    """to which it is known when a tile was asked for last"""

    def __init__(self, url: str, folder: Path, most: int) -> None:
        parts = urlsplit(url)
        if parts.scheme not in ("http", "https") or not parts.netloc or not all(f"{{{k}}}" in url for k in "zxy"):
            form = "https://HOST/{z}/{x}/{y}.png"
            raise BadConfig(f"tile server {url}: expected {form}", field="tile_server", value=url, expected=form)
        self._url, self._most, self._lock = url, most, threading.Lock()
        self._pool = ThreadPoolExecutor(AT_ONCE, "tiles")
        self._waiting = 0
        self._down_until = 0.0
        self.path = folder / f"{hashlib.sha256(url.encode()).hexdigest()[:16]}.sqlite"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._file = sqlite3.connect(self.path, check_same_thread=False, isolation_level=None)
            self._file.execute("PRAGMA auto_vacuum=FULL")
            self._file.execute("PRAGMA synchronous=OFF")  # a tile that is lost is asked for again
            table = "tiles (place TEXT PRIMARY KEY, data BLOB NOT NULL, came REAL NOT NULL, used REAL NOT NULL)"
            self._file.execute(f"CREATE TABLE IF NOT EXISTS {table}")
            # bytes of all tiles kept
            self.size = int(self._file.execute("SELECT total(length(data)) FROM tiles").fetchone()[0])
        except (OSError, sqlite3.Error) as e:
            raise BadConfig(f"tile cache {folder}: {e}", field="tile_cache", value=str(folder)) from e

    async def fetch(self, z: int, x: int, y: int) -> bytes | None:
        """A tile; None: there is none, or it cannot be had now."""
        kept = await asyncio.to_thread(self._kept, z, x, y)
        if kept is not None and kept[1]:
            return kept[0]
        data = None
        if self._waiting < WAITING and time.monotonic() >= self._down_until:
            self._waiting += 1
            try:
                data = await asyncio.get_running_loop().run_in_executor(self._pool, self._ask, z, x, y)
            finally:
                self._waiting -= 1
        return data or (kept[0] if kept else None)

    def close(self) -> None:
        self._pool.shutdown(wait=False, cancel_futures=True)
        with self._lock:
            self._file.close()

    def _kept(self, z: int, x: int, y: int) -> tuple[bytes, bool] | None:
        """The tile in the cache, and whether it is fresh."""
        now, place, row = time.time(), f"{z}/{x}/{y}", None
        with self._lock, contextlib.suppress(sqlite3.Error):
            row = self._file.execute("SELECT data, came, used FROM tiles WHERE place=?", (place,)).fetchone()
            if row is not None and abs(now - row[2]) > self.used_s:  # which a disk that is full does not take
                self._file.execute("UPDATE tiles SET used=? WHERE place=?", (now, place))
        return None if row is None else (bytes(row[0]), 0.0 <= now - row[1] < self.fresh_s)

    def _ask(self, z: int, x: int, y: int) -> bytes | None:
        if time.monotonic() < self._down_until:
            return None
        address = self._url.replace("{z}", str(z)).replace("{x}", str(x)).replace("{y}", str(y))
        agent = f"zmav/{importlib.metadata.version('zmav')}"
        try:
            request = urllib.request.Request(address, headers={"User-Agent": agent})
            with urllib.request.urlopen(request, timeout=TIMEOUT_S) as answer:
                data: bytes = answer.read(LARGEST + 1)
        except urllib.error.HTTPError as e:
            if e.code in (403, 429) or e.code >= 500:  # it does not want to be asked so often
                self._down_until = time.monotonic() + DOWN_S
            return None
        except (OSError, http.client.HTTPException, ValueError):
            self._down_until = time.monotonic() + DOWN_S
            return None
        if not data or len(data) > LARGEST:
            return None
        self._keep(f"{z}/{x}/{y}", data)
        return data

    def _keep(self, place: str, data: bytes) -> None:
        """A disk that is full keeps none; the tile is shown all the same."""
        now = time.time()
        with self._lock, contextlib.suppress(sqlite3.Error):
            old = self._file.execute("SELECT length(data) FROM tiles WHERE place=?", (place,)).fetchone()
            self._file.execute("INSERT OR REPLACE INTO tiles VALUES (?, ?, ?, ?)", (place, data, now, now))
            self.size += len(data) - (old[0] if old else 0)
            if self.size > self._most:
                self._make_room()

    def _make_room(self) -> None:
        oldest = self._file.execute("SELECT place, length(data) FROM tiles ORDER BY used").fetchall()
        gone, left = [], self.size
        for place, size in oldest:
            if left <= ROOM * self._most:
                break
            gone.append((place,))
            left -= size
        with self._file:  # all of it or nothing: a transaction that stays open would be the last one
            self._file.execute("BEGIN")
            self._file.executemany("DELETE FROM tiles WHERE place=?", gone)
        self.size = left
