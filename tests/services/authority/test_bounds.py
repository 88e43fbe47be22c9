"""Without a fleet file a vehicle is bounded by a club's field: two hundred nonsense orders, and none is flown."""

from __future__ import annotations

import asyncio
import inspect
import json
import math
import random
import time
from collections.abc import AsyncIterator, Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest

import zmav
from tests.services.conftest import GUIDED, STABILIZE
from zmav import keys, wire
from zmav.autopilots import Autopilot, Command, Target, autopilot_named
from zmav.autopilots.base import HERE
from zmav.autopilots.moving import Speed, leads_to
from zmav.config import Geofence, Limits
from zmav.errors import BadInput, Refused
from zmav.sim import World
from zmav.vehicle import Vehicle

if TYPE_CHECKING:
    from tests.conftest import Ground, Net, StartOnboard
    from tests.services.conftest import StartBench
    from tests.services.missions.mission_peer import MissionBench

AUTO = 3
ORIGIN = wire.Origin(lat_deg=-35.363261, lon_deg=149.165230, alt_amsl=584.09)
HEIGHT = 10.0
SEED = 20261123
HOSTILE = (math.nan, math.inf, -math.inf, 1e30, -1e30)


class Nonsense(NamedTuple):
    """An order, or a setpoint where the verb is ``setpoint``, as JSON-like values."""

    verb: str
    args: dict[str, Any]


def _far(r: random.Random) -> tuple[float, float]:
    """North and east beyond the field: some hundred metres, or in kilometres' or degrees' clothes."""
    away, course = r.choice([1100.0, 2000.0, 9_000.0, 90_000.0, 5e6]), r.uniform(0.0, math.tau)
    return away * math.cos(course), away * math.sin(course)


def _height(r: random.Random) -> float:
    """Under the ground, or beyond the ceiling: metres taken for feet or millimetres."""
    return r.choice([-0.5, -3.0, -HEIGHT, -120.0, 130.0, 328.0, 10_000.0]) * r.uniform(1.0, 1.2)


def _places(r: random.Random) -> dict[str, Any]:
    """A position that no field has, in one of the frames."""
    near = (r.uniform(-20.0, 20.0), r.uniform(-20.0, 20.0))
    kind = r.choice(["far", "high", "hostile"])
    north, east = _far(r) if kind == "far" else near
    up = _height(r) if kind == "high" else r.uniform(5.0, 20.0)
    if kind == "hostile":
        north = r.choice(HOSTILE)
    if r.random() < 0.5:
        return {"frame": "ned", "pos": [north, east, -up]}
    if r.random() < 0.2:
        return {"frame": "global", "lat_deg": 0.0, "lon_deg": 0.0, "alt_rel": 10.0}  # where nobody is
    lat, lon = ORIGIN.lat_deg + north / 111_320.0, ORIGIN.lon_deg + east / 90_800.0
    over = {"alt_rel": up} if r.random() < 0.5 else {"alt_amsl": ORIGIN.alt_amsl + up}
    return {"frame": "global", "lat_deg": lat, "lon_deg": lon, **over}


def _motion(r: random.Random) -> dict[str, Any]:
    most = r.choice([31.0, 100.0, 1000.0, math.nan, math.inf])
    axis = r.randrange(3)
    vel = [0.0, 0.0, 0.0]
    vel[axis] = most if axis < 2 else r.choice([-11.0, 11.0, 6.0, 1000.0, math.nan])
    return {"vel": vel}


def _segment(r: random.Random) -> dict[str, Any]:
    now = time.time()
    place = _places(r)
    while place["frame"] != "ned":
        place = _places(r)
    points = [{"t": now + 0.5, "pos": [0.0, 0.0, -HEIGHT]}, {"t": now + 20.0, "pos": place["pos"]}]
    return {"segment": points}


def _command(r: random.Random) -> dict[str, Any]:
    north, east = _far(r)
    lat, lon = ORIGIN.lat_deg + north / 111_320.0, max(-179.0, min(179.0, ORIGIN.lon_deg + east / 90_800.0))
    lat = max(-89.0, min(89.0, lat))
    relative = {"command": "DO_REPOSITION", "frame": "GLOBAL_RELATIVE_ALT"}
    there = {"param1": -1.0, "param5": lat, "param6": lon}
    here = {"param1": -1.0, "param2": 1.0, "param5": ORIGIN.lat_deg, "param6": ORIGIN.lon_deg, "param7": _height(r)}
    faster = {"param1": float(r.randrange(4)), "param2": 500.0, "param3": -1.0}
    return r.choice(
        [
            {**relative, "params": {**there, "param2": 1.0, "param7": 10.0}},
            {**relative, "params": here},
            {"command": "DO_CHANGE_SPEED", "params": faster},
            {"command": "NAV_TAKEOFF", "params": {"param7": 4000.0}},
            {"command": "DO_REPOSITION", "params": {**there, "param7": 10.0}},
            {"command": "DO_REPOSITION", "params": {**there, "param7": None}},
            {"command": "GUIDED_CHANGE_ALTITUDE", "frame": "GLOBAL_RELATIVE_ALT", "params": {"param7": -20.0}},
        ]
    )


def _setpoint(r: random.Random) -> dict[str, Any]:
    kinds: list[Callable[[random.Random], dict[str, Any]]] = [_places, _motion, _segment]
    return r.choice(kinds)(r)


def nonsense(count: int) -> list[Nonsense]:
    """Of every verb that leads somewhere, and of setpoints and segments; the same ones each time."""
    r = random.Random(SEED)
    makers: dict[str, Callable[[random.Random], dict[str, Any]]] = {
        "goto": lambda r: {**_places(r), **r.choice([{}, {"radius": 30.0}])},
        "takeoff": lambda r: {"alt_rel": r.choice([*HOSTILE, 0.0, -10.0, 121.0, 999.0])},
        "command": _command,
        "setpoint": _setpoint,
    }
    names = sorted(makers)
    return [Nonsense(name, makers[name](r)) for name in (names[i % len(names)] for i in range(count))]


def _more_than(before: dict[str, int]) -> Callable[[wire.VehicleState], bool]:
    """It has judged another setpoint."""
    return lambda state: sum(state.setpoints.values()) > sum(before.values())


def _json(args: dict[str, Any]) -> bytes:
    """As a careless program sends it: NaN and Infinity as Python writes them."""
    return json.dumps(args).encode()


@pytest.fixture
async def hovering(net: Net, onboard: StartOnboard) -> AsyncIterator[tuple[Vehicle, World, Ground]]:
    """A copter at HEIGHT, whose agent was given no fence and no limits."""
    with World(copters=1, endpoint="tcp:127.0.0.1:0", speed=4.0, ready_s=1.0) as world:
        session, endpoint = net.router()
        ground = net.ground(endpoint)
        await onboard(session, world.urls[0], origin=ORIGIN)
        async with zmav.open(connect=[endpoint]) as z:
            (vehicle,) = await z.wait_for("quad1")
            await vehicle.arm()
            await vehicle.takeoff(HEIGHT)
            yield vehicle, world, ground


async def test_two_hundred_nonsense_goals_are_refused_and_none_is_flown(
    hovering: tuple[Vehicle, World, Ground],
) -> None:
    vehicle, world, ground = hovering
    sim = world.vehicles[0]
    world.set_speed(1.0)
    flown: list[tuple[Nonsense, str]] = []
    lease = (await ground.do("lease", holder="careless", ttl=30)).result["lease"]
    seq = starved = 0
    for one in nonsense(200):
        if one.verb == "setpoint":
            seq += 1
            before = dict(vehicle.state.setpoints)
            point = {"lease": lease, "seq": seq, "deadline": time.time() + 2.0, **one.args}
            ground.session.put(keys.SETPOINT.key("demo", "quad1", agent="careless"), _json(point))
            state = await vehicle.wait_until(_more_than(before), 10.0)
            counted = {k for k, n in state.setpoints.items() if n > before.get(k, 0)}
            if counted == {"silent"}:
                starved += 1  # a busy machine: the simulator was not heard for a moment
            elif not counted <= {"fence", "speed", "climb", "descend", "bad_input"}:
                flown.append((one, f"counted as {counted}"))
            continue
        answers = await ground.ask(
            keys.DO.key("demo", "quad1", verb=one.verb), _json({**one.args, "lease": lease, "wait": 0.5})
        )
        error = answers[0].err if answers else None
        code = wire.error_from(error.payload.to_bytes()).code if error is not None else "done"
        if code not in ("bad_input", "refused") or (code == "refused" and one.verb != "takeoff"):
            flown.append((one, code))  # a takeoff is refused in the air, too
    assert not flown
    assert starved <= 20
    status = sim.status()
    assert status.mode == "GUIDED"
    assert math.dist(status.ned_m, (0.0, 0.0, -HEIGHT)) < 2.0


async def test_a_refusal_says_how_the_field_is_widened_and_force_passes_once(
    hovering: tuple[Vehicle, World, Ground],
) -> None:
    vehicle, _, _ = hovering
    async with vehicle.lease("lander") as lease:  # near the ground it sinks no faster than for a landing
        lease.setpoint(vel=(0.0, 0.0, 1.0))
        await vehicle.wait_until(lambda s: s.setpoints.get("flown", 0) > 0, 10.0)
        lease.setpoint(vel=(0.0, 0.0, 8.0))
        await vehicle.wait_until(lambda s: s.setpoints.get("fence", 0) > 0, 10.0)
    with pytest.raises(BadInput, match=r"over the ceiling of 120 m.*\[geofence\].*--force"):
        await vehicle.order("goto", wire.GoTo(pos=(0.0, 0.0, -150.0)))
    with pytest.raises(BadInput, match=r"5\.0 m under the ground at home"):
        await vehicle.order("goto", wire.GoTo(pos=(0.0, 0.0, 5.0)))
    await vehicle.order("goto", wire.GoTo(pos=(5.0, 0.0, -121.5), force=True, arrive=False))
    await vehicle.hold()


async def test_what_is_declared_is_not_forced(bench: StartBench) -> None:
    declared = {"origin": ORIGIN, "geofence": Geofence(radius=50.0, ceiling=30.0), "limits": Limits(speed=4.0)}
    b = await (await (await bench(settings=declared)).connected()).flying()
    for args, why in (
        ({"pos": [60.0, 0.0, -10.0]}, "radius of 50 m"),
        ({"pos": [10.0, 0.0, -31.0]}, "ceiling of 30 m"),
    ):
        b.peer.send(
            "GLOBAL_POSITION_INT",
            lat=round(ORIGIN.lat_deg * 1e7),
            lon=round(ORIGIN.lon_deg * 1e7),
            alt=594090,
            relative_alt=10000,
        )
        await b.state(lambda s: s["position"] and s["ages"]["position"] < 1.0, "its position")
        with pytest.raises(BadInput, match=why):
            await b.ground.do("goto", **args, force=True)


async def test_a_wider_field_is_what_the_fleet_file_says(bench: StartBench) -> None:
    wide = Geofence(radius=math.inf, floor=-math.inf, ceiling=math.inf)
    b = await (await bench(settings={"origin": ORIGIN, "geofence": wide, "limits": Limits(speed=math.inf)})).connected()
    await b.flying()
    b.peer.send(
        "GLOBAL_POSITION_INT",
        lat=round(ORIGIN.lat_deg * 1e7),
        lon=round(ORIGIN.lon_deg * 1e7),
        alt=594090,
        relative_alt=10000,
    )
    await b.state(lambda s: s["position"], "its position")
    for pos in ([9000.0, 0.0, -10.0], [0.0, 0.0, -900.0], [0.0, 0.0, 40.0]):
        await b.ground.do("goto", pos=pos, arrive=False)


async def test_without_an_origin_the_field_is_about_where_it_was_armed(bench: StartBench) -> None:
    b = await (await bench()).connected()
    b.peer.send("GLOBAL_POSITION_INT", lat=470000000, lon=80000000, alt=500000, relative_alt=0)
    await b.flying()
    away = {"frame": "global", "lon_deg": 8.0, "alt_rel": 10.0, "arrive": False}
    await b.ground.do("goto", lat_deg=47.008, **away)
    b.peer.send("GLOBAL_POSITION_INT", lat=470080000, lon=80000000, alt=510000, relative_alt=10000)
    await b.state(lambda s: s["position"] is not None and s["position"]["lat_deg"] > 47.007, "the new place")
    with pytest.raises(BadInput, match="beyond the geofence's radius of 1000 m"):
        await b.ground.do("goto", lat_deg=47.0125, **away)


async def test_nobody_is_sent_anywhere_who_does_not_know_where_it_is(bench: StartBench) -> None:
    b = await bench()
    b.peer.place = None
    await (await b.connected()).flying()
    with pytest.raises(BadInput, match="where the vehicle is, is not known"):
        await b.ground.do("goto", frame="global", lat_deg=47.0, lon_deg=8.0, alt_rel=10.0)


COPTER, PX4 = autopilot_named("ardupilot", "copter"), autopilot_named("px4", "copter")
REL, AMSL = "MAV_FRAME_GLOBAL_RELATIVE_ALT", "MAV_FRAME_GLOBAL"
Led = tuple[float | None, float | None, float | None, float | None]


def cmd(name: str, *params: float, frame: str | None = None) -> Command:
    return Command(f"MAV_CMD_{name}", params, frame)


@pytest.mark.parametrize(
    ("command", "autopilot", "led"),
    [
        (cmd("DO_CHANGE_SPEED", 1.0, 50.0), COPTER, Speed("speed", 50.0)),
        (cmd("DO_CHANGE_SPEED", 2.0, 5.0), COPTER, Speed("climb", 5.0)),
        (cmd("DO_CHANGE_SPEED", 1.0, -1.0), COPTER, None),
        (cmd("NAV_TAKEOFF", 0, 0, 0, 0, 0, 0, 40.0), COPTER, (None, None, None, 40.0)),
        (cmd("NAV_TAKEOFF", 0, 0, 0, 0, math.nan, math.nan, 40.0), PX4, (None, None, 40.0, None)),
        (cmd("NAV_TAKEOFF", 0, 0, 0, 0, math.nan, math.nan, math.nan), PX4, None),
        (cmd("DO_CHANGE_ALTITUDE", 40.0, 3.0), COPTER, (None, None, None, 40.0)),
        (cmd("DO_CHANGE_ALTITUDE", 40.0, 3.0), PX4, (None, None, 40.0, None)),
        (cmd("GUIDED_CHANGE_ALTITUDE", 0, 0, 0, 0, 0, 0, 40.0, frame=REL), COPTER, (None, None, None, 40.0)),
        (cmd("DO_REPOSITION", -1, 1, 0, 0, 47e7, 8e7, 5.0, frame=AMSL), COPTER, (47.0, 8.0, 5.0, None)),
        (cmd("DO_REPOSITION", -1, 1, 0, 0, 47e7, 8e7, 5.0, frame=REL), COPTER, (47.0, 8.0, None, 5.0)),
        # PX4 looks at no frame: 5 m above home would be flown as 5 m above the sea.
        (cmd("DO_REPOSITION", -1, 1, 0, 0, 47e7, 8e7, 5.0, frame=REL), PX4, (47.0, 8.0, 5.0, None)),
        # ... and that of no place on the globe as well: it would be flown to, whatever the fence.
        (cmd("DO_REPOSITION", -1, 1, 0, 0, 47e7, 8e7, 5.0, frame="MAV_FRAME_LOCAL_NED"), PX4, (47.0, 8.0, 5.0, None)),
        (cmd("DO_ORBIT", 10, 1, 0, 0, 47e7, 8e7, 5.0, frame="MAV_FRAME_MISSION"), PX4, (47.0, 8.0, 5.0, None)),
        (cmd("DO_REPOSITION", -1, 1, 0, 0, 47e7, 8e7, 5.0, frame="MAV_FRAME_LOCAL_NED"), COPTER, None),
        (cmd("DO_REPOSITION", -1, 1, 0, 0, 47.0, 8.0, 5.0), COPTER, (47.0, 8.0, None, 5.0)),
        (cmd("DO_REPOSITION", -1, 1, 0, 0, 47.0, 8.0, 5.0), PX4, (47.0, 8.0, 5.0, None)),
        # At the height where it is, however far away that is.
        (cmd("DO_REPOSITION", -1, 1, 0, 0, 47.0, 8.0, math.nan), PX4, (47.0, 8.0, None, None)),
        (cmd("DO_REPOSITION", -1, 1, 0, 0, 0.0, 0.0, 5.0), PX4, (0.0, 0.0, 5.0, None)),
        (cmd("DO_REPOSITION", -1, 1, 0, 0, HERE, HERE, 5.0, frame=AMSL), PX4, (None, None, 5.0, None)),
        (cmd("NAV_LAND", 0, 0, 0, 0, 47e7, 8e7, -5.0, frame=REL), COPTER, (47.0, 8.0, None, None)),
        (cmd("DO_SET_SERVO", 1.0, 1500.0), COPTER, None),
    ],
)
def test_where_a_command_leads(command: Command, autopilot: Autopilot, led: Speed | Led | None) -> None:
    found = leads_to(command, autopilot)
    if led is None or isinstance(led, Speed):
        assert found == led
    else:
        assert found == Target(*led)


def test_a_mission_item_s_frame_counts_on_px4_too() -> None:
    item = cmd("NAV_WAYPOINT", 0, 0, 0, 0, 470000000, 80000000, 30.0, frame=REL)
    assert leads_to(item, PX4, in_mission=True) == Target(47.0, 8.0, None, 30.0)


WAYPOINT = "MAV_CMD_NAV_WAYPOINT"
HERE_X, HERE_Y = -35.36, 149.16
BAD_ITEMS: list[tuple[dict[str, Any], str]] = [
    ({"command": WAYPOINT, "x": -35.46, "y": HERE_Y, "z": 20.0}, "item 1: pos: .* beyond the geofence's radius"),
    ({"command": WAYPOINT, "x": HERE_X, "y": HERE_Y, "z": -20.0}, r"item 1: pos: 20\.0 m under the ground"),
    ({"command": WAYPOINT, "x": HERE_X, "y": HERE_Y, "z": 500.0}, "item 1: pos: .* over the ceiling"),
    ({"command": "MAV_CMD_NAV_TAKEOFF", "x": 0.0, "y": 0.0, "z": 5000.0}, "item 1: .* over the ceiling"),
    ({"command": "MAV_CMD_DO_CHANGE_SPEED", "params": [1, 900.0, -1, 0]}, "item 1: speed: 900 m/s"),
    ({"command": "MAV_CMD_NAV_LAND", "x": -35.46, "y": HERE_Y, "z": 0.0}, "item 1: pos: .* beyond"),
]

BEGINNINGS: dict[str, tuple[str, dict[str, Any]]] = {
    "mission_start": ("mission_start", {}),
    "set_mode": ("set_mode", {"mode": "AUTO"}),
    "MISSION_START": ("command", {"command": "MISSION_START"}),
    "DO_LAND_START": ("command", {"command": "DO_LAND_START"}),
    "DO_SET_MODE": ("command", {"command": "DO_SET_MODE", "params": {"Mode": 1, "Custom Mode": AUTO}}),
}


@pytest.mark.parametrize(("item", "why"), BAD_ITEMS)
async def test_a_mission_that_leaves_the_field_is_not_begun(
    mission_bench: MissionBench, subtests: pytest.Subtests, item: dict[str, Any], why: str
) -> None:
    b, peer = await mission_bench("ardupilot")
    good = {"command": WAYPOINT, "x": HERE_X, "y": HERE_Y, "z": 20.0}
    await b.ground.do("mission_upload", kind="mission", items=[good, item])
    await b.flying()
    for how, (verb, args) in BEGINNINGS.items():
        with subtests.test(how):
            with pytest.raises(BadInput, match=why):
                await b.ground.do(verb, **args)
            assert peer.mode == GUIDED


@pytest.mark.parametrize("armed", [False, True])
async def test_a_rally_point_beyond_the_field_is_not_taken(
    mission_bench: MissionBench, subtests: pytest.Subtests, *, armed: bool
) -> None:
    """A return or a failsafe leads there, and nobody is asked then."""
    b, peer = await mission_bench("ardupilot")
    await (b.flying() if armed else b.connected())
    point = {"command": "MAV_CMD_NAV_RALLY_POINT", "x": HERE_X, "y": HERE_Y, "z": 20.0}
    for bad, why in (
        ({"x": -35.46}, "beyond the geofence's radius"),
        ({"z": -20.0}, "under the ground"),
        ({"z": 500.0}, "over the ceiling"),
    ):
        with subtests.test(why), pytest.raises(BadInput, match=f"item 1: pos: .*{why}"):
            await b.ground.do("mission_upload", kind="rally", items=[point, point | bad])
    assert peer.heard("MISSION_COUNT") == []
    await b.ground.do("mission_upload", kind="rally", items=[point])


async def test_a_mission_that_leaves_the_field_is_not_taken_in_flight(
    mission_bench: MissionBench, subtests: pytest.Subtests
) -> None:
    """In AUTO it would be flown as soon as it is there."""
    b, peer = await mission_bench("ardupilot")
    good = {"command": WAYPOINT, "x": HERE_X, "y": HERE_Y, "z": 20.0}
    await b.ground.do("mission_upload", kind="mission", items=[good])
    await b.flying()
    peer.mode = AUTO
    await b.state(lambda s: s["mode"] == "AUTO", "AUTO")
    for item, why in BAD_ITEMS:
        with subtests.test(why), pytest.raises(BadInput, match=why):
            await b.ground.do("mission_upload", kind="mission", items=[good, item])
    assert len(peer.heard("MISSION_COUNT")) == 1
    for item, why in BAD_ITEMS:
        await b.ground.do("mission_upload", kind="mission", items=[good])
        assert len(peer.plans[0]) == 2  # home first
        await b.ground.do("mission_upload", kind="mission", items=[good, item], force=True)
        assert len(peer.plans[0]) == 3, why


HOME_AMSL = 600.0
"""m: what the bench's autopilot says of itself"""


def home(lat: float = HERE_X, lon: float = HERE_Y, alt: float = HOME_AMSL, here: float = 0.0) -> dict[str, Any]:
    return {"command": "DO_SET_HOME", "params": {"param1": here, "param5": lat, "param6": lon, "param7": alt}}


BAD_HOMES = [
    (home(lat=-35.46), "pos: .* beyond the geofence's radius"),
    (home(alt=0.0), r"by -600\.0 m"),
    (home(alt=700.0), r"by 100\.0 m"),
    (home(0.0, 0.0, 0.0), "beyond"),
    (home(alt=100.0) | {"frame": "GLOBAL_RELATIVE_ALT"}, r"by 100\.0 m"),
    (home(here=1.0), r"by 50\.0 m"),
]


async def test_a_home_beyond_the_field_or_far_above_or_below_it_is_not_set(
    mission_bench: MissionBench, subtests: pytest.Subtests
) -> None:
    """A return leads there, and all heights count from it."""
    b, peer = await mission_bench("ardupilot")
    await b.flying()
    await b.ground.do("command", **home(HERE_X + 1e-4, alt=HOME_AMSL - 3.0))
    await b.ground.do("command", **home(here=1.0))  # 10 m up
    peer.send("GLOBAL_POSITION_INT", lat=-353600000, lon=1491600000, alt=650000, relative_alt=50000)
    await b.state(lambda s: (s["position"] or {}).get("alt_rel") == 50.0, "a place 50 m up")
    for order, why in BAD_HOMES:
        with subtests.test(order=order), pytest.raises(BadInput, match=why):
            await b.ground.do("command", **order)
    item = {"command": "MAV_CMD_DO_SET_HOME", "params": [0, 0, 0, 0], "x": -35.46, "y": HERE_Y, "z": HOME_AMSL}
    with pytest.raises(BadInput, match=r"item 0: pos: .* beyond"):
        await b.ground.do("mission_upload", kind="mission", items=[item | {"frame": "MAV_FRAME_GLOBAL"}])
    with pytest.raises(BadInput, match="item 0: it moves home's height to where nobody knows yet"):
        await b.ground.do("mission_upload", kind="mission", items=[item | {"params": [1, 0, 0, 0]}])
    assert len(sets_of_home(peer)) == 2
    for count, (order, _) in enumerate(BAD_HOMES, 3):
        await b.ground.do("command", **order, force=True)
        assert len(sets_of_home(peer)) == count, order


def sets_of_home(peer: Any) -> list[Any]:
    return [told for told in peer.told if told.fields.get("command") == 179]


async def test_no_force_moves_home_s_height_where_heights_are_declared(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot", settings={"geofence": Geofence(ceiling=60.0)})
    await b.flying()
    with pytest.raises(BadInput, match=r"by 100\.0 m"):
        await b.ground.do("command", **home(alt=700.0), force=True)
    assert sets_of_home(peer) == []


async def test_a_mission_that_lands_is_begun_over_a_declared_floor(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot", settings={"geofence": Geofence(floor=2.0)})
    items = [
        {"command": WAYPOINT, "x": HERE_X, "y": HERE_Y, "z": 20.0},
        {"command": "MAV_CMD_NAV_LAND", "x": HERE_X, "y": HERE_Y, "z": 0.0},
    ]
    await b.ground.do("mission_upload", kind="mission", items=items)
    await b.flying()
    assert (await b.ground.do("mission_start")).status == "done"
    assert peer.mode != GUIDED


async def test_a_start_that_waits_is_overtaken_by_what_makes_safe(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    await b.ground.do(
        "mission_upload", kind="mission", items=[{"command": WAYPOINT, "x": HERE_X, "y": HERE_Y, "z": 9.0}]
    )
    await b.flying()
    reading = asyncio.Event()

    read = b.vehicle.missions.plan

    async def plan(kind: Any, report: Any) -> list[Any]:
        await reading.wait()
        return await read(kind, report)

    b.vehicle.missions.plan = plan  # type: ignore[method-assign]
    start = asyncio.create_task(b.ground.do("mission_start", id="start", wait=5.0))
    await b.state(lambda s: True, "the start is being judged")
    await b.ground.do("hold")
    reading.set()
    with pytest.raises(Refused, match="overtaken"):
        await start
    assert peer.mode == GUIDED


async def test_a_polygon_without_an_origin_is_where_it_is_wherever_the_vehicle_is_armed(bench: StartBench) -> None:
    corners = [(47.0, 8.0), (47.01, 8.0), (47.01, 8.01)]
    b = await (await bench(settings={"geofence": Geofence(polygon=corners)})).connected()
    b.peer.send("GLOBAL_POSITION_INT", lat=12, lon=-7, alt=0, relative_alt=0)  # it does not know yet
    await b.flying()
    await b.ground.do("lease", holder="alice", ttl=30)
    b.peer.mode = STABILIZE
    await b.event("the mode is now STABILIZE, which was not ordered here: the lease has ended")


def test_each_class_that_moves_a_vehicle_cannot_be_made_without_its_bounds() -> None:
    from zmav.services.authority.authority import Authority
    from zmav.services.authority.separation import Separation
    from zmav.services.authority.setpoints import Setpoints
    from zmav.services.missions.flight import MissionFlight
    from zmav.services.missions.missions import Missions
    from zmav.services.orders.flight import Flight
    from zmav.services.orders.payload import Payload

    for made in (Authority, Flight, MissionFlight, Missions, Payload, Separation, Setpoints):
        (bounds,) = [p for p in inspect.signature(made).parameters.values() if p.annotation == "Bounds"]
        assert bounds.default is inspect.Parameter.empty, made
