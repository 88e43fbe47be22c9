"""The ground below a scene: how high it is, and as columns that vehicles keep out of. ENU metres about the origin.

Between the heights of a piece its surface is linear along each side, so the highest point of a rectangle of it is at
one of its corners, at a height within, or where a side crosses a line of the grid. A column is as high as that: none is
lower than its ground.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from agents.planner.model.problem import Floats
from agents.planner.model.scene import Bounds, Box, Corner, Point
from zmav import geo, wire
from zmav.errors import BadInput
from zmav.services.authority.clearance import USUAL, Clearance, Place
from zmav.terrain import MINUTES, VOID, Piece, corner_of, names_within, piece_at

NAME, UNKNOWN = "the ground", "ground that is not known"
"""what columns are called: no obstacle that is told can be"""
MOST = 1200
"""columns of a scene; where there would be more, they are made wider"""
SPARE = 0.5
"""m more above the ground than is asked for"""
LEAF = 8.0
"""m: columns are no wider beside a place that they would else reach"""
BESIDE = 1.0
"""m, beyond the radius, within which a place is beside a column"""
BELOW = 0.3
"""m, beyond the radius, by which a column ends below a vehicle that is there already"""
GRAIN = 50.0
"""m to which areas are rounded, so that columns are not made again while vehicles move"""
SKY, DEEP = 20_000.0, 200.0
"""m to which unknown ground reaches, and by which columns begin below the scene"""
KEPT = 8
"""areas whose columns are kept"""
Area = tuple[float, float, float, float]
"""west, south, east, north"""


class Block(NamedTuple):
    """A part of a piece: rows from its north, columns from its west, in steps of its grid."""

    piece: str
    top: float
    left: float
    bottom: float
    right: float
    height: float
    """m above the sea, of its highest point; NaN: not known"""


class GroundMap:
    """Pieces of ground about an origin, all in memory. It is a :class:`zmav.terrain.Ground`."""

    def __init__(self, pieces: Mapping[str, Piece], origin: wire.Origin) -> None:
        self.pieces, self.origin = dict(pieces), origin
        self._grids: dict[str, Floats] = {}
        self._frames: dict[str, Area] = {}
        self._kept: dict[tuple[Area, float, bool], list[Block]] = {}

    @property
    def empty(self) -> bool:
        return not self.pieces

    def height(self, lat_deg: float, lon_deg: float) -> float | None:
        name, north, east = piece_at(lat_deg, lon_deg)
        piece = self.pieces.get(name)
        return None if piece is None else piece.height(north, east)

    def place(self, x: float, y: float, z: float) -> Place:
        return Place(*geo.to_global(self.origin, (y, x, -z)))

    def within(self, area: Area) -> GroundMap:
        """The pieces of that area only."""
        names = set(self._names(area))
        return GroundMap({name: piece for name, piece in self.pieces.items() if name in names}, self.origin)

    def highest(self, area: Area) -> float | None:
        """m above the sea, of the highest point of a rectangle; None: some of it is not known."""
        found = [self._block(name, *self._inside(name, area)).height for name in self._names(area)]
        return None if any(map(math.isnan, found)) else max(found)

    def lowest(self, area: Area) -> float:
        """Of what is known of it, within a step of the grid."""
        parts = [(name, self._inside(name, area)) for name in self._names(area) if name in self.pieces]
        grids = [self._grid(n)[int(t) : int(b) + 2, int(left) : int(r) + 2] for n, (t, left, b, r) in parts]
        return min((float(np.nanmin(grid)) for grid in grids if not np.isnan(grid).all()), default=0.0)

    def blocks(self, area: Area, lowest: float, unknown: bool) -> list[Block]:
        """What is higher than ``lowest`` (above the sea), as finely as :data:`MOST` allows; ``unknown``: and what is
        not known, all of it or a part. Else a block is as high as what is known of it.
        """
        key = (area, lowest, unknown)
        if key not in self._kept:
            step = 1
            while len(found := list(self._blocks(area, lowest, unknown, step))) > MOST and step < MINUTES:
                step *= 2
            while len(self._kept) >= KEPT:
                del self._kept[next(iter(self._kept))]
            self._kept[key] = found
        return self._kept[key]

    def halves(self, block: Block, unknown: bool) -> list[Block]:
        """The block as four; ``unknown``: as for :meth:`blocks`."""
        row, column = (block.top + block.bottom) / 2.0, (block.left + block.right) / 2.0
        rows, columns = ((block.top, row), (row, block.bottom)), ((block.left, column), (column, block.right))
        name = block.piece
        return [self._block(name, top, left, bottom, right, unknown) for top, bottom in rows for left, right in columns]

    def area_of(self, block: Block) -> Area:
        west, south, east, north = self._frame(block.piece)
        last = self._last(block.piece)
        wide, high = (east - west) / last, (north - south) / last
        return (
            west + wide * block.left,
            north - high * block.bottom,
            west + wide * block.right,
            north - high * block.top,
        )

    # How it is done.

    def _names(self, area: Area) -> Iterator[str]:
        west, south, east, north = area
        low, high = self.place(west, south, 0.0), self.place(east, north, 0.0)
        return names_within(low.lat_deg, low.lon_deg, high.lat_deg, high.lon_deg)

    def _frame(self, name: str) -> Area:
        """Where a piece lies."""
        if name in self._frames:
            return self._frames[name]
        row, column = corner_of(name)
        south, west, _ = geo.to_ned(self.origin, row / MINUTES, column / MINUTES, 0.0)
        north, _, _ = geo.to_ned(self.origin, (row + 1) / MINUTES, column / MINUTES, 0.0)
        _, east, _ = geo.to_ned(self.origin, row / MINUTES, (column + 1) / MINUTES, 0.0)
        self._frames[name] = west, south, east, north
        return self._frames[name]

    def _last(self, name: str) -> int:
        return self.pieces[name].side - 1 if name in self.pieces else 1

    def _inside(self, name: str, area: Area) -> tuple[float, float, float, float]:
        """The top, left, bottom and right of what of an area is in a piece."""
        (west, south, east, north), last = self._frame(name), self._last(name)
        rows = [(north - y) / (north - south) * last for y in (area[3], area[1])]
        columns = [(x - west) / (east - west) * last for x in (area[0], area[2])]
        top, bottom, left, right = (min(max(each, 0.0), float(last)) for each in (*rows, *columns))
        return top, left, bottom, right

    def _grid(self, name: str) -> Floats:
        if name not in self._grids:
            piece = self.pieces[name]
            heights = np.array(piece.heights, dtype=np.float64).reshape(piece.side, piece.side)
            self._grids[name] = np.where(heights == VOID, np.nan, heights)
        return self._grids[name]

    def _block(self, name: str, top: float, left: float, bottom: float, right: float, unknown: bool = True) -> Block:
        height = math.nan
        if name in self.pieces:
            grid = self._grid(name)
            level = _between(_between(grid, top, bottom).T, left, right)
            height = float(level.max() if unknown else np.fmax.reduce(level.ravel()))
        return Block(name, top, left, bottom, right, height)

    def _blocks(self, area: Area, lowest: float, unknown: bool, step: int) -> Iterator[Block]:
        for name in self._names(area):
            if name not in self.pieces:
                if unknown:
                    yield Block(name, 0.0, 0.0, 1.0, 1.0, math.nan)
                continue
            grid, last = self._grid(name), self._last(name)
            cells = np.maximum(np.maximum(grid[1:, 1:], grid[1:, :-1]), np.maximum(grid[:-1, 1:], grid[:-1, :-1]))
            starts = np.arange(0, last, step)
            most = np.maximum if unknown else np.fmax
            tops = most.reduceat(most.reduceat(cells, starts, axis=0), starts, axis=1)
            top, left, bottom, right = self._inside(name, area)
            row, column = np.meshgrid(starts, starts, indexing="ij")
            near = (row <= bottom) & (row + step >= top) & (column <= right) & (column + step >= left)
            with np.errstate(invalid="ignore"):
                wanted = near & ((tops > lowest) | (np.isnan(tops) & unknown))
            for i, j in zip(*np.nonzero(wanted), strict=True):
                above, west = float(starts[i]), float(starts[j])
                yield Block(name, above, west, min(above + step, last), min(west + step, last), float(tops[i, j]))


@dataclass(frozen=True)
class Floor:
    """How low the vehicles of a goal may be."""

    ground: GroundMap
    declared: float | None
    """m above the ground that are asked for; None: none"""
    offset: float
    """m by which the ground is taken to be higher than the map has it"""
    radii: tuple[float, float]
    """the least and the greatest"""
    ceiling: float
    """m up: no way leads higher"""
    walls: bool = True
    """False: some of them drive, so that ways among columns cannot be looked for"""

    def up(self, x: float, y: float) -> float | None:
        """How high the ground is there; None: not known."""
        place = self.ground.place(x, y, 0.0)
        height = self.ground.height(place.lat_deg, place.lon_deg)
        return None if height is None else height + self.offset - self.ground.origin.alt_amsl

    def lowest(self, x: float, y: float) -> float | None:
        """How low one may rest there, with the columns beside it; None: the ground is not known. Where no height is
        asked for it is as low as a vehicle permits.
        """
        if self.declared is None:
            up = self.up(x, y)
            return None if up is None else up + USUAL
        reach = self.radii[1] + BESIDE + LEAF
        height = self.ground.highest((x - reach, y - reach, x + reach, y + reach))
        return None if height is None else height + self._lift + self.radii[1]

    def peak(self, corners: Sequence[Corner]) -> float | None:
        """How low one may be wherever it is between these; None: the ground is not known somewhere."""
        xs, ys = zip(*(corner[:2] for corner in corners), strict=True)
        height = self.ground.highest((min(xs), min(ys), max(xs), max(ys)))
        return None if height is None else height + self._lift + self.radii[1]

    def span(self, area: Area) -> tuple[float, float]:
        """m up: how low and how high the ground is. Raises :class:`BadInput` where it is not known."""
        highest = self.ground.highest(area)
        if highest is None:
            text = "not all of the ground there is known to the planner: 'zmav swarm planner --terrain'"
            raise BadInput(text, field="polygon", value=None, expected="ground that is known")
        base = self.offset - self.ground.origin.alt_amsl
        return self.ground.lowest(area) + base, highest + base

    def within(self, bounds: Bounds) -> Floor:
        """The same for less ground: that of all that is looked at for a place in there."""
        (west, south), (east, north) = bounds.min[:2], bounds.max[:2]
        return replace(self, ground=self.ground.within((west - GRAIN, south - GRAIN, east + GRAIN, north + GRAIN)))

    def columns(self, bounds: Bounds, starts: Sequence[Point], places: Sequence[Point]) -> list[Box]:
        """What is to be kept out of within ``bounds``, finer beside the ``places``, and no higher than ``starts`` are:
        one that is too low may climb from there. Where no height is asked for, places may be low, too.
        """
        if not self.walls:
            return []
        least, most = bounds.min, bounds.max
        west, south = (math.floor(each / GRAIN) * GRAIN for each in least[:2])
        east, north = (math.ceil(each / GRAIN) * GRAIN for each in most[:2])
        lowest = math.floor(least[2] - self.radii[1]) - self._lift
        blocks = self.ground.blocks((west, south, east, north), lowest, self.declared is not None)
        beside = [(place, True) for place in starts] + [(place, self.declared is None) for place in places]
        return [
            Box(min=(x0, y0, min(top, least[2]) - DEEP), max=(x1, y1, top), name=name)
            for block in blocks
            for (x0, y0, x1, y1), top, name in self._finer(block, beside)
        ]

    @property
    def _lift(self) -> float:
        """From a height above the sea to the top of its column."""
        return self.offset + (self.declared or 0.0) + SPARE - self.radii[0] - self.ground.origin.alt_amsl

    def _finer(self, block: Block, beside: Sequence[tuple[Point, bool]]) -> Iterator[tuple[Area, float, str]]:
        area, known = self.ground.area_of(block), not math.isnan(block.height)
        if not known and self.declared is None:
            return
        top, name = (block.height + self._lift, NAME) if known else (SKY, UNKNOWN)
        under, reach = self.radii[1] + BELOW, self.radii[1] + BESIDE
        near = [each for each in beside if _away(area, each[0]) < reach and top > each[0][2] - under]
        if near and max(area[2] - area[0], area[3] - area[1]) > LEAF:
            for part in self.ground.halves(block, self.declared is not None):
                yield from self._finer(part, near)
            return
        yield area, min([top, *(place[2] - under for place, is_start in near if is_start)]), name

    # What vehicles would judge themselves.

    def check(self, motion: Sequence[Sequence[float]], home: Point | None) -> float | None:
        """The least height above the ground of samples t, x, y, z, where it is known. Raises
        :class:`~zmav.errors.BadInput` for a way that its vehicle would not fly.
        """
        judge, place = Clearance(self.ground, self.declared), self.ground.place
        way, stood = [place(*row[1:4]) for row in motion], None if home is None else place(*home)
        judge.check_way(way, way[0], stood, lands=False)
        above = [judge.above(each, stood) for each in way]
        return min((each for each in above if each is not None), default=None)


def _between(rows: Floats, first: float, last: float) -> Floats:
    """The rows of a grid between two, which need not be whole: theirs come first and last."""
    inner = np.arange(math.ceil(first), math.floor(last) + 1)
    at = np.unique(np.concatenate(([first], inner, [last])))
    low = np.minimum(at.astype(np.int64), len(rows) - 2)
    share = (at - low)[:, None]
    lower, upper = np.where(share < 1.0, rows[low], 0.0), np.where(share > 0.0, rows[low + 1], 0.0)
    found: Floats = lower * (1.0 - share) + upper * share  # what has no share in it may be unknown
    return found


def _away(area: Area, place: Point) -> float:
    """m over the ground from an area to a place; 0 inside."""
    x, y, _ = place
    return math.hypot(max(area[0] - x, x - area[2], 0.0), max(area[1] - y, y - area[3], 0.0))
