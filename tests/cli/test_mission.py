"""``zmav mission``: plans into vehicles and out of them, in tables, in files and in the air."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import pytest

from zmav.errors import BadInput
from zmav.formats import plans
from zmav.formats.items import Plan
from zmav.mavlink import load_dialect
from zmav.sim import World
from zmav.sim.spec import VehicleSpec
from zmav.wire import MissionItem

if TYPE_CHECKING:
    from tests.cli.conftest import Here, Vehicle
    from tests.conftest import Net, StartOnboard

ENUMS = load_dialect().enums
LAT, LON = -35.363261, 149.165230
WAYPOINT = "MAV_CMD_NAV_WAYPOINT"
SHORT = [
    MissionItem(command="MAV_CMD_NAV_TAKEOFF", params=[0.0] * 4, z=4.0),
    MissionItem(command=WAYPOINT, params=[0.0] * 4, x=LAT + 5e-5, y=LON, z=4.0),
    MissionItem(command="MAV_CMD_NAV_LAND", params=[0.0, 0.0, 0.0, 1.0], x=LAT + 5e-5, y=LON),
]
RING = [(-35.373, 149.155), (-35.373, 149.175), (-35.353, 149.165)]


def around() -> list[MissionItem]:
    command = "MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION"
    return [MissionItem(command=command, frame="MAV_FRAME_GLOBAL", params=[3.0], x=x, y=y) for x, y in RING]


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    """A .plan with all three kinds."""
    path = tmp_path / "survey.plan"
    rally = [MissionItem(command="MAV_CMD_NAV_RALLY_POINT", x=LAT, y=LON, z=20.0)]
    plans.save(path, Plan(mission=SHORT, fence=around(), rally=rally), ENUMS)
    return path


@pytest.fixture
def plain(vehicle: Vehicle) -> Any:
    """The vehicle, left without plans."""
    yield vehicle
    vehicle.zmav("mission", "clear", "quad1", "--kind", "all")


def test_a_plan_there_and_back(plain: Vehicle, survey: Path, tmp_path: Path) -> None:
    do = plain.zmav
    assert do("mission", "upload", "quad*", str(survey)).out.splitlines() == [
        "quad1: mission uploaded, 3 items",
        "quad1: fence uploaded, 3 items",
        "quad1: rally uploaded, 1 items",
    ]
    back = tmp_path / "{vehicle}-back.plan"
    told = do("mission", "download", "quad*", str(back))
    path = tmp_path / "quad1-back.plan"
    assert told.out == f"quad1: {path}: mission 3 items, fence 3 items, rally 1 items\n"
    sent, got = plans.load(survey, ENUMS), plans.load(path, ENUMS)
    assert got.mission == sent.mission
    assert [(i.command, i.x, i.y) for i in got.fence or []] == [(i.command, i.x, i.y) for i in around()]
    assert [(i.x, i.y, i.z) for i in got.rally or []] == [(LAT, LON, 20.0)]
    assert (got.firmware, got.vehicle) == (3, 2)
    (line,) = do("mission", "show", "quad1", "--kind", "rally", "--json").lines
    assert line["name"] == "quad1"
    assert [(i["command"], i["z"]) for i in line["mission"]["items"]] == [("MAV_CMD_NAV_RALLY_POINT", 20.0)]
    told = do("mission", "show", "quad1")
    assert "quad1: mission, 3 items" in told.out
    assert "NAV_TAKEOFF" in told.out
    assert "-35.3632110" in told.out
    lines = do("mission", "clear", "quad1", "--kind", "all", "--json").lines
    assert [(each["vehicle"], each["kind"]) for each in lines] == [
        ("quad1", "mission"),
        ("quad1", "fence"),
        ("quad1", "rally"),
    ]
    assert do("mission", "show", "quad1", "--json").lines[0]["mission"]["items"] == []


def test_one_kind_of_a_file(plain: Vehicle, survey: Path, tmp_path: Path) -> None:
    do = plain.zmav
    (line,) = do("mission", "upload", "quad1", str(survey), "--kind", "fence", "--json").lines
    assert (line["vehicle"], line["kind"], line["result"]["count"]) == ("quad1", "fence", 3)
    path = tmp_path / "fence.waypoints"
    do("mission", "download", "quad1", str(path), "--kind", "fence")
    assert len(plans.load(path, ENUMS).fence or []) == 3


@pytest.mark.usefixtures("hurried")
def test_a_mission_flown_from_the_shell(plain: Vehicle, survey: Path, tmp_path: Path) -> None:
    do, sim = plain.zmav, plain.sim
    do("mission", "upload", "quad1", str(survey), "--kind", "mission")
    told = do.fails("mission", "start", "quad1")
    assert told.out == "quad1: not done: it is disarmed: arm it first\n"
    do("do", "quad1", "set_mode", "mode=GUIDED")
    do("do", "quad1", "arm")
    far = tmp_path / "far.plan"
    plans.save(far, Plan(mission=[SHORT[0], msgspec.structs.replace(SHORT[1], x=LAT + 0.5), SHORT[2]]), ENUMS)
    assert (
        "an operator's order with force (--force) passes once" in do.fails("mission", "upload", "quad1", str(far)).out
    )
    do("mission", "upload", "quad1", str(far), "--force")
    assert "--force" in do.fails("mission", "start", "quad1").out
    do("mission", "upload", "quad1", str(survey), "--kind", "mission")
    (line,) = do("mission", "start", "quad1", "--wait", "--json").lines
    assert line["result"]["total"] == 3
    plain.until(lambda s: not s.armed)
    assert sim.status().ned_m[0] == pytest.approx(5.5, abs=1.5)
    do("do", "quad1", "set_mode", "mode=STABILIZE")
    plain.until(lambda s: bool(s.ready and s.mode == "STABILIZE"))


def test_what_is_refused_says_what_is_in_force(plain: Vehicle, survey: Path, tmp_path: Path) -> None:
    do = plain.zmav
    do("mission", "upload", "quad1", str(survey), "--kind", "mission")
    path = tmp_path / "bad.plan"
    bad = [
        SHORT[0],
        SHORT[2],
        SHORT[1],
        MissionItem(command="MAV_CMD_CONTROL_HIGH_LATENCY", frame="MAV_FRAME_MISSION", params=[0.0] * 4),
    ]
    plans.save(path, Plan(mission=bad, rally=[]), ENUMS)
    told = do.fails("mission", "upload", "quad1", str(path))
    assert told.out.startswith(
        "quad1: mission not done: the autopilot refused item 3 (MAV_CMD_CONTROL_HIGH_LATENCY): MAV_"
    )
    assert told.out.endswith("in force: the old mission (3 items), restored\n")
    (line,) = do.fails("mission", "upload", "quad1", str(path), "--json").lines
    assert (line["error"], line["in_force"]) == ("refused", "old")
    assert len(do("mission", "show", "quad1", "--json").lines[0]["mission"]["items"]) == 3


def test_files_are_read_before_anybody_is_asked(here: type[Here], tmp_path: Path) -> None:
    nobody = here("-e", "tcp/127.0.0.1:1")
    path = tmp_path / "bad.plan"
    path.write_text(json.dumps({"fileType": "Plan", "version": 1, "mission": {"version": 2, "items": [{"type": "X"}]}}))
    error = nobody.fails("mission", "upload", "quad1", str(path)).error
    assert isinstance(error, BadInput)
    assert error.detail["field"] == "$.mission.items[0].type"
    plans.save(path, Plan(rally=[]), ENUMS)
    error = nobody.fails("mission", "upload", "quad1", str(path), "--kind", "fence").error
    assert isinstance(error, BadInput)
    assert "holds no fence" in error.message


async def test_several_vehicles_side_by_side(
    here: type[Here], net: Net, onboard: StartOnboard, survey: Path, tmp_path: Path
) -> None:
    """Each is told; where one fails, the others are done all the same."""
    with World([VehicleSpec(sysid=n) for n in (1, 2)], endpoint="tcp:0", speed=8.0, ready_s=0.5) as world:
        session, endpoint = net.router()
        for n in (0, 1):
            await onboard(session, world.urls[n], f"quad{n + 1}")
        agents = onboard.running
        do = here("-e", endpoint)
        for agent in agents:
            while not agent.identity.connected:
                await asyncio.sleep(0.05)
        told = await asyncio.to_thread(do, "mission", "upload", "quad*", str(survey), "--kind", "mission", "--json")
        assert [(line["vehicle"], line["result"]["count"]) for line in told.lines] == [("quad1", 3), ("quad2", 3)]
        told = await asyncio.to_thread(do.fails, "mission", "download", "quad*", str(tmp_path / "one.plan"))
        assert isinstance(told.error, BadInput)
        assert "put {vehicle} into its name" in told.error.message
        agents[1].leases.allow = _refuse  # type: ignore[method-assign]
        told = await asyncio.to_thread(do.fails, "mission", "clear", "quad*")
        assert told.out == "quad1: mission cleared\nquad2: mission not done: not now\n"


def _refuse(token: str, origin: object = None) -> None:
    raise BadInput("not now")
