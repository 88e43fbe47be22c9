"""A simulated ArduCopter follows the terrain by our tiles alone: it asks for what it needs, as the real one does."""

from __future__ import annotations

import array
import math
from pathlib import Path

import pytest

from tests.agents.planner.execute.fleet import ORIGIN, airborne
from tests.descents import COPTER_DOWN
from tests.waiting import until
from zmav import geo, wire
from zmav.formats.tiles import Folder, pieces_within
from zmav.terrain import Terrain, cell_name, heights_of, pack

HIGH, TOP, WIDE = 50.0, (180.0, 30.0), 120.0
SPACING, ABOVE = 30.0, 25.0
OFF, OFF_BACK = 4.0, 6.0
"""m: heights are whole metres, 30 m apart or more on both sides, and in RTL the copter follows late"""


def hill(north: float, east: float) -> float:
    return HIGH * math.exp(-((north - TOP[0]) ** 2 + (east - TOP[1]) ** 2) / WIDE**2)


def tile(folder: Path) -> None:
    """The degree about the origin as SRTM has it, three arc seconds: flat but for the hill."""
    south, west = math.floor(ORIGIN.lat_deg), math.floor(ORIGIN.lon_deg)
    side = 1201
    heights = array.array("h", [round(ORIGIN.alt_amsl)] * side * side)
    row, column = ((south + 1 - ORIGIN.lat_deg) * (side - 1), (ORIGIN.lon_deg - west) * (side - 1))
    for r in range(round(row) - 20, round(row) + 20):
        for c in range(round(column) - 20, round(column) + 20):
            lat, lon = south + 1 - r / (side - 1), west + c / (side - 1)
            north, east, _ = geo.to_ned(ORIGIN, lat, lon, 0.0)
            heights[r * side + c] = round(ORIGIN.alt_amsl + hill(north, east))
    (folder / f"{cell_name(south, west)}.hgt").write_bytes(heights_of(heights.tobytes()).tobytes())


@pytest.mark.timeout(300)
async def test_a_mission_and_a_return_follow_the_terrain_by_our_tiles_alone(tmp_path: Path) -> None:
    tile(tmp_path)
    low, high = (geo.to_global(ORIGIN, (sign * 3000.0, sign * 3000.0, 0.0))[:2] for sign in (-1.0, 1.0))
    found = pieces_within(Folder(tmp_path), *low, *high)
    kept = Terrain(tmp_path / "demo" / "quad1.terrain")
    for name, piece in found.items():
        kept.put(name, pack(piece))

    def up(north: float, east: float) -> float:
        """m of the ground above home's: heights count from where it stood."""
        heights = [kept.height(*geo.to_global(ORIGIN, (n, e, 0.0))[:2]) for n, e in ((north, east), (0.0, 0.0))]
        assert heights[0] is not None
        assert heights[1] is not None
        return heights[0] - heights[1]

    def item(north: float, east: float) -> wire.MissionItem:
        lat, lon, _ = geo.to_global(ORIGIN, (north, east, 0.0))
        frame = "MAV_FRAME_GLOBAL_TERRAIN_ALT"
        return wire.MissionItem(command="MAV_CMD_NAV_WAYPOINT", frame=frame, x=lat, y=lon, z=ABOVE)

    own = {"TERRAIN_SPACING": SPACING, "RTL_ALT_TYPE": 1.0, "RTL_ALT": 100.0 * ABOVE, "WPNAV_SPEED": 400.0}
    params = {**COPTER_DOWN, **own}
    async with airborne([(0.0, 0.0)], ABOVE, params=params, cache=str(tmp_path)) as fleet:
        (vehicle,) = await fleet.z.wait_for("quad1")
        await vehicle.missions.upload([item(40.0, 0.0), item(180.0, 0.0), item(300.0, 0.0)], "mission")
        reports = [await vehicle.terrain.report()]

        async def loaded() -> bool:
            reports.append(await vehicle.terrain.report())
            return reports[-1].pending == 0 and bool(reports[-1].loaded)

        for _ in range(300):
            if await loaded():
                break
        assert reports[-1].pending == 0, reports[-1]
        assert reports[-1].loaded is not None
        assert 0 < reports[-1].loaded <= reports[-1].answered
        assert not reports[-1].missing
        fleet.world.set_speed(3.0)
        await vehicle.order("mission_start", wire.MissionStart())
        async with fleet.watch() as watch:
            await until(lambda: watch.rows and watch.rows[-1][1]["quad1"][0] > 295.0, "it is there", 120.0)
            there = len(watch.rows)
            await vehicle.order("rtl", wire.Order())
        way = [places["quad1"] for _, places in watch.rows]
        out = [-down - up(north, east) for north, east, down in way[:there] if north > 40.0]
        back = [-down - up(north, east) for north, east, down in way[there:] if 30.0 < north < 285.0]
        for heights, off in ((out, OFF), (back, OFF_BACK)):
            assert len(heights) > 50
            assert ABOVE - off < min(heights) < max(heights) < ABOVE + off
        assert max(-down for _, _, down in way) > ABOVE + 0.7 * HIGH, "it went over the hill"
