"""How far above the ground a vehicle is led: places, straight ways, segments and missions over a ridge."""

from __future__ import annotations

import array
import asyncio
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.services.authority.test_setpoint import Pilot
from zmav import geo, wire
from zmav.config import Geofence
from zmav.errors import BadInput
from zmav.services.authority.clearance import Clearance, Place
from zmav.terrain import Piece, Terrain, corner_of, names_within, pack
from zmav.verbs import VERBS, Access

if TYPE_CHECKING:
    from tests.services.conftest import Bench, StartBench
    from tests.services.missions.mission_peer import MissionBench

ORIGIN = wire.Origin(lat_deg=-35.3632, lon_deg=149.1652, alt_amsl=600.0)
RIDGE = (200.0, 400.0)
"""m north of the origin: there the ground is 100 m higher"""
KNOWN = 700.0
"""m east of the origin: beyond, the ground is not known"""
HOME = Place(ORIGIN.lat_deg, ORIGIN.lon_deg, 600.0)


class Ridge:
    empty = False

    def height(self, lat_deg: float, lon_deg: float) -> float | None:
        north, east, _ = geo.to_ned(ORIGIN, lat_deg, lon_deg, 0.0)
        return None if east > KNOWN else 700.0 if RIDGE[0] < north < RIDGE[1] else 600.0


def place(north: float, east: float, up: float) -> Place:
    return Place(*geo.to_global(ORIGIN, (north, east, -up)))


@pytest.mark.parametrize(
    ("least", "goal", "start", "words"),
    [
        (None, place(300, 0, 105), HOME, "27.8 m under the ground"),  # straight up there leads through the slope
        (None, place(300, 0, 105), place(0, 0, 110), ""),
        (None, place(300, 0, 80), None, "20.0 m under the ground"),
        (None, place(300, 0, 95), None, ""),  # SRTM may be that wrong
        (None, place(600, 0, 20), place(0, 0, 20), "80.0 m under the ground"),  # behind the ridge
        (None, place(600, 800, 20), place(600, 0, 20), ""),  # what is not known may be
        (20.0, place(600, 0, 20), place(500, 0, 20), ""),
        (20.0, place(600, 0, 19), place(500, 0, 20), "19.4 m above the ground"),
        (20.0, place(600, 0, 30), place(500, 0, 2), ""),  # up from where it is
        (20.0, place(300, 0, 119), None, "19.0 m above the ground"),
        (20.0, place(600, 800, 50), None, "is not known here"),
        (20.0, place(600, 600, 50), place(600, 800, 50), "is not known here"),
    ],
)
def test_what_is_too_low_is_refused(least: float | None, goal: Place, start: Place | None, words: str) -> None:
    judge = Clearance(Ridge(), least)
    if not words:
        judge.check(goal, start, HOME, force=False)
        return
    with pytest.raises(BadInput, match=words) as caught:
        judge.check(goal, start, HOME, force=False)
    assert caught.value.detail["count"] == "ground"
    if least is None:
        assert "--force" in caught.value.message
        judge.check(goal, start, HOME, force=True)
        with pytest.raises(BadInput):
            judge.check(goal, start, HOME, force=None)
    else:
        with pytest.raises(BadInput):
            judge.check(goal, start, HOME, force=True)


def test_the_ground_is_as_high_as_home_says() -> None:
    """A receiver that is 12 m off, or a tile that is: what counts is the height above where it stood."""
    judge = Clearance(Ridge(), 20.0)
    off = Place(HOME.lat_deg, HOME.lon_deg, 612.0)
    judge.check(place(300, 0, 133), None, off, force=False)
    with pytest.raises(BadInput, match=r"19\.0 m above"):
        judge.check(place(300, 0, 131), None, off, force=False)
    assert judge.above_sea(*place(300, 0, 0)[:2], 30.0, off) == pytest.approx(742.0)
    assert judge.above_sea(*place(300, 0, 0)[:2], 30.0, None) == pytest.approx(730.0)
    wild = Place(HOME.lat_deg, HOME.lon_deg, 900.0)
    assert judge.above_sea(*place(300, 0, 0)[:2], 30.0, wild) == pytest.approx(760.0), "30 m at most"
    with pytest.raises(BadInput, match="not known"):
        judge.above_sea(*place(0, 800, 0)[:2], 30.0, HOME)
    assert Clearance(Ridge(), None).above_sea(*place(0, 800, 0)[:2], 30.0, HOME) is None


@pytest.mark.parametrize(
    ("ups", "here", "lands", "words"),
    [
        ([5, 12, 25], 5, False, ""),  # it climbs away
        ([4, 12, 25], 5, False, "4.0 m above"),
        ([12, 14, 12], 5, False, "12.0 m above"),  # no lower than it has got by then
        ([25, 19, 25], 5, False, "19.0 m above"),
        ([12, 14, 25], None, False, "12.0 m above"),  # where it is, is not known
        ([12, 14, 25], 30, False, "12.0 m above"),
        ([40, 30, 4], 40, True, ""),  # straight down where it lands
        ([40, 30, 4], 40, False, "4.0 m above"),
        ([40, 30, -12], 40, True, "12.0 m under"),
    ],
)
def test_a_way_climbs_away_and_comes_down_where_it_lands(
    ups: list[float], here: float | None, lands: bool, words: str
) -> None:
    judge, start = Clearance(Ridge(), 20.0), None if here is None else place(0, 0, here)
    way = [place(0, 0, up) for up in ups]
    if not words:
        judge.check_way(way, start, HOME, lands=lands)
        return
    with pytest.raises(BadInput, match=words):
        judge.check_way(way, start, HOME, lands=lands)


def test_a_way_that_is_too_low_does_not_go_far_so() -> None:
    judge, here = Clearance(Ridge(), 20.0), place(0, 0, 5)
    judge.check_way([here, place(0, 40, 5)], here, HOME, lands=False)
    judge.check_way([here, place(0, 40, 12), place(0, 80, 20), place(0, 120, 19.6)], here, HOME, lands=False)
    with pytest.raises(BadInput, match=r"5\.0 m above"):
        judge.check_way([here, place(0, 40, 5), place(0, 80, 5)], here, HOME, lands=False)
    Clearance(Ridge(), None).check_way([place(0, 0, -12), place(0, 80, -12)], place(0, 0, -12), HOME, lands=False)


def test_a_way_comes_down_nowhere_but_where_it_lands() -> None:
    judge, here = Clearance(Ridge(), 20.0), place(0, 0, 40)
    judge.check_way([here, place(0, 50, 40), place(0, 50, 4)], here, HOME, lands=True)
    with pytest.raises(BadInput, match=r"15\.0 m above"):
        judge.check_way([here, place(0, 45, 15), place(0, 50, 4)], here, HOME, lands=True)
    with pytest.raises(BadInput, match="not known"):
        judge.check_way([here, place(0, 800, 40)], here, HOME, lands=True)


# On a vehicle.


def fill(folder: Path) -> None:
    ground, kept = Ridge(), Terrain(folder / "demo" / "quad1.terrain")
    south, west = place(-200, -200, 0)[:2]
    north, east = place(800, 300, 0)[:2]
    for name in names_within(south, west, north, east):
        row, column = corner_of(name)
        heights = array.array("h")
        for r in range(61):
            for c in range(61):
                height = ground.height((row + 1 - r / 60) / 60, (column + c / 60) / 60)
                heights.append(-32768 if height is None else round(height))
        kept.put(name, pack(Piece(61, heights)))


async def flying(b: Bench, up: float = 30.0) -> None:
    await b.flying()
    lat, lon = round(ORIGIN.lat_deg * 1e7), round(ORIGIN.lon_deg * 1e7)
    b.peer.send("HOME_POSITION", latitude=lat, longitude=lon, altitude=600000)
    await flying_at(b, up)


async def flying_at(b: Bench, up: float) -> None:
    lat, lon = round(ORIGIN.lat_deg * 1e7), round(ORIGIN.lon_deg * 1e7)
    alt = round((600.0 + up) * 1e3)
    seen = len(b.states.items)
    while len(b.states.items) < seen + 2:
        b.peer.send("GLOBAL_POSITION_INT", lat=lat, lon=lon, alt=alt, relative_alt=round(up * 1e3))
        await asyncio.sleep(0.05)


async def test_orders_and_streams_keep_off_the_ground(bench: StartBench, tmp_path: Path) -> None:
    fill(tmp_path)
    settings = {"cache": str(tmp_path), "origin": ORIGIN, "geofence": Geofence(ceiling=200.0)}
    b = await (await bench(settings=settings)).connected()
    await flying(b)
    with pytest.raises(BadInput, match="under the ground"):
        await b.ground.do("goto", pos=[600.0, 0.0, -30.0], arrive=False)
    await flying(b)
    await b.ground.do("goto", pos=[150.0, 0.0, -30.0], arrive=False)
    await flying(b)
    await b.ground.do("goto", pos=[600.0, 0.0, -30.0], arrive=False, force=True)
    await b.ground.do("hold")
    alice = Pilot(b, (await b.ground.do("lease", holder="alice", ttl=30)).result["lease"])
    await flying(b)
    alice.put(pos=(300.0, 0.0, -30.0))
    await alice.counted(ground=1)
    start = time.time() + 0.5
    points = [(0.0, -30.0, 0.0), (300.0, -100.0, 20.0), (600.0, -30.0, 40.0)]
    alice.put(vel=None, segment=[wire.SegmentPoint(t=start + t, pos=(n, 0.0, d)) for n, d, t in points])
    await alice.counted(ground=2)  # it cuts through the slope behind the ridge


async def test_a_command_without_a_height_is_judged_at_the_present_one(bench: StartBench, tmp_path: Path) -> None:
    fill(tmp_path)
    settings = {"cache": str(tmp_path), "origin": ORIGIN, "geofence": Geofence(ceiling=200.0)}
    b = await (await bench(settings=settings)).connected()
    lat, lon, _ = place(300, 0, 0)
    order = {"command": "DO_REPOSITION", "params": {"param5": lat, "param6": lon, "param7": None}}
    await flying(b)
    with pytest.raises(BadInput, match="under the ground"):
        await b.ground.do("command", **order)
    await flying(b, 110.0)
    await b.ground.do("command", **order)


WAYPOINT, LAND = "MAV_CMD_NAV_WAYPOINT", "MAV_CMD_NAV_LAND"
ABOVE = "MAV_FRAME_GLOBAL_TERRAIN_ALT"


def item(north: float, up: float, frame: str = "MAV_FRAME_GLOBAL_RELATIVE_ALT") -> dict[str, Any]:
    lat, lon, _ = place(north, 0.0, 0.0)
    return {"command": WAYPOINT, "frame": frame, "x": lat, "y": lon, "z": up}


@pytest.mark.parametrize(
    ("items", "words"),
    [
        ([item(100, 120), {**item(100, 0), "command": LAND}], ""),
        ([item(100, 120), {**item(600, 0), "command": LAND}], ""),  # over the ridge, and down there
        ([item(100, 30), {**item(600, 0), "command": LAND}], "item 1: pos: .* under the ground"),
        ([item(100, 30), item(600, 30)], "item 1: pos: .* under the ground"),
        ([item(100, 30), item(300, 30)], "item 1: pos: 70.0 m under the ground"),
        ([item(100, 30, ABOVE), item(300, 30, ABOVE), item(600, 30, ABOVE)], ""),
        ([item(100, 120), item(600, 120)], ""),
        ([item(300, 30, ABOVE)], "over the ceiling of 120 m"),  # which it is above home, 100 m lower
    ],
)
async def test_missions_keep_off_the_ground_or_follow_it(
    mission_bench: MissionBench, tmp_path: Path, items: list[dict[str, Any]], words: str
) -> None:
    fill(tmp_path)
    high = "ceiling" not in words
    fence = Geofence(ceiling=200.0) if high else Geofence()
    b, _ = await mission_bench("ardupilot", settings={"cache": str(tmp_path), "origin": ORIGIN, "geofence": fence})
    await b.ground.do("mission_upload", kind="mission", items=items)
    await flying(b)
    if words:
        with pytest.raises(BadInput, match=words):
            await b.ground.do("mission_start")
    else:
        await b.ground.do("mission_start")


async def test_ground_that_is_not_known_is_refused_where_the_fleet_file_asks_for_height(
    bench: StartBench, tmp_path: Path
) -> None:
    settings = {"cache": str(tmp_path), "origin": ORIGIN, "geofence": Geofence(above_ground=15.0)}
    b = await (await bench(settings=settings)).connected()
    await flying(b)
    with pytest.raises(BadInput, match="zmav terrain load"):
        await b.ground.do("goto", pos=[10.0, 0.0, -30.0], arrive=False, force=True)
    fill(tmp_path)
    await b.ground.do("terrain_clear")
    fill(tmp_path)
    await flying(b)
    await b.ground.do("goto", pos=[10.0, 0.0, -30.0], arrive=False)


async def test_the_ground_stays_as_it_was_when_the_vehicle_was_armed(bench: StartBench, tmp_path: Path) -> None:
    """A home that is raised afterwards, again and again, makes nothing lower: nor does one that it had before."""
    fill(tmp_path)
    settings = {"cache": str(tmp_path), "origin": ORIGIN, "geofence": Geofence(above_ground=15.0)}
    b = await (await bench(settings=settings)).connected()
    lat, lon = round(ORIGIN.lat_deg * 1e7), round(ORIGIN.lon_deg * 1e7)
    b.peer.send("HOME_POSITION", latitude=lat, longitude=lon, altitude=580000)
    b.peer.send("EXTENDED_SYS_STATE", landed_state=1)
    b.peer.send("GLOBAL_POSITION_INT", lat=lat, lon=lon, alt=600000, relative_alt=0)
    await b.state(lambda s: s["landed"] is True, "that it stands")
    await flying(b)
    for alt in (590000, 580000, 570000):
        b.peer.send("HOME_POSITION", latitude=lat, longitude=lon, altitude=alt)
        await flying_at(b, 30.0)
        with pytest.raises(BadInput, match=r"12\.0 m above the ground"):
            await b.ground.do("goto", pos=[10.0, 0.0, -12.0], arrive=False, force=True)


JUDGED: dict[str, str | tuple[str, Any]] = {
    "takeoff": "straight up from where it stands",
    "goto": ("pos", [600.0, 0.0, -30.0]),
    "set_mode": ("mode", "AUTO"),
    "command": ("command", "DO_REPOSITION"),
    "mission_start": ("first", 0),
    "mission_current": ("index", 0),
    "arm": "it moves nothing",
}
"""what moves a vehicle, and how it is asked to lead it into the ridge; or why it cannot"""


async def test_each_order_that_moves_is_held_above_the_ground(
    mission_bench: MissionBench, tmp_path: Path, subtests: pytest.Subtests
) -> None:
    """What makes safe (hold, land, rtl, disarm) is asked of nothing; a new order that moves must be listed here."""
    assert JUDGED.keys() == {verb.name for verb in VERBS.values() if verb.access is Access.MOVE}
    fill(tmp_path)
    fence = Geofence(ceiling=200.0)
    b, _ = await mission_bench("ardupilot", settings={"cache": str(tmp_path), "origin": ORIGIN, "geofence": fence})
    await b.ground.do("mission_upload", kind="mission", items=[item(300, 30), item(600, 30)])
    lat, lon, _ = place(300, 0, 0)
    for verb, told in JUDGED.items():
        if isinstance(told, str):
            continue
        await flying(b)
        more: dict[str, Any] = {"params": {"param5": lat, "param6": lon, "param7": None}} if verb == "command" else {}
        more |= {"arrive": False} if verb == "goto" else {}
        with subtests.test(verb):
            with pytest.raises(BadInput, match="under the ground") as caught:
                await b.ground.do(verb, **{told[0]: told[1]}, **more)
            assert caught.value.detail["count"] == "ground"
    with pytest.raises(BadInput, match="under the ground"):
        await b.ground.do("mission_upload", kind="mission", items=[item(300, 30), item(600, 30)])


async def test_a_height_without_a_place_is_judged_where_the_vehicle_is(bench: StartBench, tmp_path: Path) -> None:
    fill(tmp_path)
    settings = {"cache": str(tmp_path), "origin": ORIGIN, "geofence": Geofence(above_ground=15.0)}
    b = await (await bench(settings=settings)).connected()
    await flying(b)
    with pytest.raises(BadInput, match=r"5\.0 m above the ground"):
        await b.ground.do("command", command="DO_CHANGE_ALTITUDE", params={"param1": 5.0, "param2": 3.0})
    await b.ground.do("command", command="DO_CHANGE_ALTITUDE", params={"param1": 16.0, "param2": 3.0})
