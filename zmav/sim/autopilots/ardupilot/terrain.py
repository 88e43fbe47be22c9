"""The ground as an ArduPilot knows it: blocks of 28 by 32 heights that it asks its station for, as AP_Terrain does.

The simulated world is flat; what it is told decides only how high it flies over which place.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from zmav.sim.autopilots.ardupilot.state import VehicleState
from zmav.sim.autopilots.items import LOCATED, Item
from zmav.sim.geo import Position, from_ned

METRES_PER_DEGREE = 111319.5
"""of latitude, in MAVLink's terrain protocol"""
STRIDES = (24, 28)
"""heights from one block to the next to the north and to the east: four fewer than it has"""
ACROSS, GRID = 8, 4
"""grids from west to east in a block, and heights along a grid"""
BITS = 56
MOST_BLOCKS = 1024
"""that it keeps: more than a mission has places (650), few enough for the 16 bits of what TERRAIN_REPORT has pending.
Beyond them those that it looked at the longest ago go.
"""


class Block(NamedTuple):
    """Its south-west corner in 1e-7 degrees, and m between two heights."""

    lat: int
    lon: int
    spacing: int

    def steps_to(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        """Heights north and east of its corner."""
        south = self.lat / 1e7
        wide = METRES_PER_DEGREE * max(math.cos(math.radians((south + lat_deg) / 2.0)), 0.01)
        return (lat_deg - south) * METRES_PER_DEGREE / self.spacing, (lon_deg - self.lon / 1e7) * wide / self.spacing


class Terrain:
    """One vehicle's."""

    def __init__(self, vehicle: VehicleState) -> None:
        self._vehicle = vehicle
        self._blocks: dict[Block, dict[int, list[int]]] = {}
        self._turn = 0

    @property
    def _enabled(self) -> bool:
        """By TERRAIN_ENABLE, which a rover does not have."""
        return bool(self._vehicle.params.get("TERRAIN_ENABLE"))

    def height(self, lat_deg: float, lon_deg: float) -> float | None:
        """m above the sea; None: not known yet, and asked for where it has terrain at all."""
        if not self._enabled:
            return None
        block = self._block_at(lat_deg, lon_deg)
        grids = self._blocks[block] = self._blocks.pop(block, {})
        if len(self._blocks) > MOST_BLOCKS:
            del self._blocks[next(iter(self._blocks))]
        north, east = block.steps_to(lat_deg, lon_deg)
        i, j = int(north), int(east)
        found = [self._height_of(grids, i + di, j + dj) for di in (0, 1) for dj in (0, 1)]
        if None in found:
            return None
        a, b, c, d = (float(each or 0) for each in found)
        up, right = north - i, east - j
        return (1.0 - up) * ((1.0 - right) * a + right * b) + up * ((1.0 - right) * c + right * d)

    def above_home(self, north: float, east: float) -> float:
        """m by which the ground at a place (the world's NED) is higher than at home; 0 where that is not known."""
        here, home = (self._height_at(place) for place in ((north, east), self._vehicle.home_world[:2]))
        return 0.0 if here is None or home is None else here - home

    def request(self) -> dict[str, Any] | None:
        """The fields of TERRAIN_REQUEST; None: it has all that it wants, or TERRAIN_ENABLE is 0. Incomplete blocks take
        turns: nobody may know one of them.
        """
        vehicle = self._vehicle
        if not self._enabled or not vehicle.position_ok:
            return None
        for seq in range(1, len(vehicle.mission)):
            item = vehicle.mission.read(seq)
            if isinstance(item, Item) and item.command in LOCATED and not item.here:
                self.height(item.x * 1e-7, item.y * 1e-7)
        self.above_home(vehicle.sense.north, vehicle.sense.east)
        missing = [each for each in self._blocks.items() if len(each[1]) < BITS]
        if not missing:
            return None
        self._turn += 1
        block, grids = missing[self._turn % len(missing)]
        mask = sum(1 << bit for bit in range(BITS) if bit not in grids)
        return {"lat": block.lat, "lon": block.lon, "grid_spacing": block.spacing, "mask": mask}

    def report(self) -> dict[str, Any] | None:
        """The fields of TERRAIN_REPORT."""
        vehicle = self._vehicle
        if not self._enabled:
            return None
        place = self._place((vehicle.sense.north, vehicle.sense.east))
        height = self.height(place.lat_deg, place.lon_deg)
        loaded = sum(map(len, self._blocks.values()))
        return {
            "lat": round(place.lat_deg * 1e7),
            "lon": round(place.lon_deg * 1e7),
            "spacing": 0 if height is None else int(vehicle.params["TERRAIN_SPACING"]),
            "terrain_height": height or 0.0,
            "current_height": vehicle.height - self.above_home(vehicle.sense.north, vehicle.sense.east),
            "pending": BITS * len(self._blocks) - loaded,
            "loaded": loaded,
        }

    def take(self, told: dict[str, Any]) -> None:
        """A TERRAIN_DATA, of a block that was asked for."""
        grids = self._blocks.get(Block(told["lat"], told["lon"], told["grid_spacing"]))
        if grids is not None and told["gridbit"] < BITS:
            grids[told["gridbit"]] = list(told["data"])

    def _height_at(self, place: tuple[float, float]) -> float | None:
        where = self._place(place)
        return self.height(where.lat_deg, where.lon_deg)

    def _place(self, place: tuple[float, float]) -> Position:
        return from_ned(*place, 0.0, self._vehicle.world)

    def _block_at(self, lat_deg: float, lon_deg: float) -> Block:
        spacing = max(int(self._vehicle.params["TERRAIN_SPACING"]), 1)
        south, west = math.floor(lat_deg), math.floor(lon_deg)
        high, wide = (spacing * stride / METRES_PER_DEGREE for stride in STRIDES)
        wide /= max(math.cos(math.radians(south)), 0.01)
        row, column = int((lat_deg - south) / high), int((lon_deg - west) / wide)
        return Block(round((south + row * high) * 1e7), round((west + column * wide) * 1e7), spacing)

    @staticmethod
    def _height_of(grids: dict[int, list[int]], i: int, j: int) -> int | None:
        grid = grids.get(i // GRID * ACROSS + j // GRID)
        return None if grid is None else grid[i % GRID * GRID + j % GRID]
