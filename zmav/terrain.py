"""How high the ground is: a vehicle's pieces of SRTM's grid, and the arithmetic of them.

A piece is what lies within one minute of latitude and of longitude: a square of heights (metres above the sea, big
endian, two bytes each, rows from north to south) as SRTM's ``.hgt`` files have for a degree, 61 by 61 at one arc second
and 21 by 21 at three, the edges shared with its neighbours. It is called by its south-west corner: ``S36E149-38-09`` is
south 36° plus 38', east 149° plus 9'. Source of the layout: SRTM Topography, USGS, "SRTM_Topo".
"""

from __future__ import annotations

import array
import collections
import math
import re
import sys
import threading
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, Protocol

from zmav.errors import BadInput

MINUTES = 60
"""pieces in a degree, each way"""
VOID = -32768
"""where SRTM does not know the height"""
LOWEST, HIGHEST = -500, 9000
"""m above the sea: no ground is beyond"""
SIDES = (2, 241)
"""heights along a piece's side: at four to the arc second, and no finer"""
NAME = re.compile(r"([NS])(\d\d)([EW])(\d\d\d)-(\d\d)-(\d\d)\Z")
KEPT = 64
"""pieces that are kept in memory, 0.5 MB at one arc second"""
MOST_STORED = 16_384
"""pieces in a folder: 200 km by 200 km, and no full disk"""


class Ground(Protocol):
    """How high the ground is, where that is known."""

    @property
    def empty(self) -> bool:
        """It is known nowhere. From any thread."""

    def height(self, lat_deg: float, lon_deg: float) -> float | None:
        """Metres above the sea; None: not known. From any thread."""


class Piece(NamedTuple):
    """Heights within one minute: ``side`` by ``side``, the first row in the north."""

    side: int
    heights: array.array[int]

    def height(self, north: float, east: float) -> float | None:
        """Between the four nearest; ``north`` and ``east`` are 0 to 1 from the south-west corner. None by a void."""
        last = self.side - 1
        row, column = (1.0 - north) * last, east * last
        top, left = min(int(row), last - 1), min(int(column), last - 1)
        at = top * self.side + left
        h = self.heights
        a, b, c, d = h[at], h[at + 1], h[at + self.side], h[at + self.side + 1]
        if VOID in (a, b, c, d):
            return None
        down, right = row - top, column - left
        return (1 - down) * ((1 - right) * a + right * b) + down * ((1 - right) * c + right * d)


def piece_at(lat_deg: float, lon_deg: float) -> tuple[str, float, float]:
    """The piece that a place lies in, and where in it: 0 to 1 to the north and to the east."""
    lat, lon = lat_deg * MINUTES, ((lon_deg + 180.0) % 360.0 - 180.0) * MINUTES
    south, west = math.floor(lat), math.floor(lon)
    return name_of(south, west), lat - south, lon - west


def name_of(south: int, west: int) -> str:
    """The piece whose south-west corner is there, in minutes from the equator and from Greenwich."""
    lat, row = divmod(south, MINUTES)
    lon, column = divmod(west, MINUTES)
    return f"{cell_name(lat, lon)}-{row:02}-{column:02}"


def cell_name(lat: int, lon: int) -> str:
    """What SRTM calls the degree whose south-west corner is there."""
    return f"{'S' if lat < 0 else 'N'}{abs(lat):02}{'W' if lon < 0 else 'E'}{abs(lon):03}"


def corner_of(name: str) -> tuple[int, int]:
    """South and west of a piece in minutes; raises :class:`BadInput` for what is no piece's name."""
    match = NAME.match(name)
    if match is None:
        raise BadInput.wrong("piece", name, "a name as S36E149-38-09")
    ns, lat, ew, lon, row, column = match.groups()
    south = (-int(lat) if ns == "S" else int(lat)) * MINUTES + int(row)
    west = (-int(lon) if ew == "W" else int(lon)) * MINUTES + int(column)
    if name_of(south, west) != name or not -90 * MINUTES <= south < 90 * MINUTES or not -180 <= west / MINUTES < 180:
        raise BadInput.wrong("piece", name, "a place on Earth, and minutes of 00 to 59")
    return south, west


def names_within(south: float, west: float, north: float, east: float) -> Iterator[str]:
    """The pieces that an area (degrees) touches; one whose west is east of its east lies across the antimeridian."""
    rows = range(math.floor(south * MINUTES), math.floor(north * MINUTES) + 1)
    first, half = math.floor(west * MINUTES), 180 * MINUTES
    span = east - west if 0.0 <= east - west <= 360.0 else (east - west) % 360.0
    columns = min(math.floor((west + span) * MINUTES) - first + 1, 2 * half)
    for row in rows:
        for column in range(first, first + columns):
            yield name_of(row, (column + half) % (2 * half) - half)


def heights_of(data: bytes) -> array.array[int]:
    """Heights of two bytes each, big endian, as SRTM has them."""
    heights = array.array("h", data)
    if sys.byteorder == "little":
        heights.byteswap()
    return heights


def pack(piece: Piece) -> bytes:
    """A piece as it crosses the network."""
    return zlib.compress(heights_of(piece.heights.tobytes()).tobytes(), 9)


def unpack(name: str, data: bytes) -> Piece:
    """A piece as it came; raises :class:`BadInput` for what is none, or no heights on Earth."""
    most = 2 * SIDES[1] ** 2
    inflate = zlib.decompressobj()
    try:
        raw = inflate.decompress(data, most + 1)
    except zlib.error as e:
        raise BadInput.wrong(name, "bytes", "a piece that zlib has packed", f"{name}: {e}") from None
    side = math.isqrt(len(raw) // 2)
    if not inflate.eof or 2 * side * side != len(raw) or not SIDES[0] <= side <= SIDES[1]:
        what = f"{name} has {len(raw)} bytes"
        raise BadInput.wrong(name, len(raw), f"a square of two-byte heights, {SIDES[1]} by {SIDES[1]} at most", what)
    heights = heights_of(raw)
    known = [height for height in heights if height != VOID]
    for height in (min(known, default=LOWEST), max(known, default=LOWEST)):
        if not LOWEST <= height <= HIGHEST:
            raise BadInput.wrong(name, height, f"{LOWEST} to {HIGHEST} m", f"{name} has ground at {height} m")
    return Piece(side, heights)


class Terrain:
    """The pieces in a folder, each a file of its name. From any thread.

    A file that cannot be read is as one that is not there: :meth:`height` knows nothing, and ``faults`` says why.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.faults: dict[str, str] = {}
        self.kept, self.most = KEPT, MOST_STORED
        self._pieces: collections.OrderedDict[str, Piece | None] = collections.OrderedDict()
        self._lock, self._writing = threading.Lock(), threading.Lock()
        self.empty = not self.names()

    def height(self, lat_deg: float, lon_deg: float) -> float | None:
        if not (abs(lat_deg) < 90.0 and math.isfinite(lon_deg)):
            return None
        name, north, east = piece_at(lat_deg, lon_deg)
        piece = self.piece(name)
        return None if piece is None else piece.height(north, east)

    def piece(self, name: str) -> Piece | None:
        """None where there is none."""
        with self._lock:
            if name in self._pieces:
                self._pieces.move_to_end(name)
                return self._pieces[name]
            piece = self._read(name)
            self._remember(name, piece)
            return piece

    def _remember(self, name: str, piece: Piece | None) -> None:
        self._pieces.pop(name, None)
        self._pieces[name] = piece
        if len(self._pieces) > self.kept:
            self._pieces.popitem(last=False)

    def put(self, name: str, data: bytes) -> None:
        """Keep a piece, in place of what was there. Raises :class:`BadInput` for what is none, and for one more than
        there is room for; OSError by the disk.
        """
        corner_of(name)
        piece = unpack(name, data)
        with self._writing:
            self.folder.mkdir(parents=True, exist_ok=True)
            if not (self.folder / name).exists() and len(self.names()) >= self.most:
                text = f"{name}: {self.most} pieces are kept already: 'zmav terrain clear' makes room"
                raise BadInput.wrong("pieces", name, f"at most {self.most} pieces", text)
            part = self.folder / f"{name}.part"
            part.write_bytes(data)
            part.replace(self.folder / name)
            self.empty = False
            with self._lock:
                self.faults.pop(name, None)
                self._remember(name, piece)

    def clear(self) -> int:
        """Forget all pieces; how many there were."""
        with self._writing:
            names = self.names()
            for name in names:
                (self.folder / name).unlink(missing_ok=True)
            self.empty = True
            with self._lock:
                self.faults.clear()
                self._pieces.clear()
            return len(names)

    def names(self) -> list[str]:
        """What is in the folder."""
        try:
            return sorted(path.name for path in self.folder.iterdir() if NAME.match(path.name))
        except FileNotFoundError:
            return []

    def _read(self, name: str) -> Piece | None:
        try:
            return unpack(name, (self.folder / name).read_bytes())
        except FileNotFoundError:
            return None
        except (OSError, BadInput) as e:
            self.faults[name] = str(e)
            return None
