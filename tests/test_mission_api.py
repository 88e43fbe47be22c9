"""``vehicle.missions`` as a script uses it: real routers, the real agent beside the embedded simulator."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import zmav
from zmav.errors import BadInput, Refused
from zmav.formats import plans
from zmav.formats.items import Plan
from zmav.mavlink import load_dialect
from zmav.services.missions.transfer import TransferTimes
from zmav.sim import VehicleSpec, World
from zmav.wire import MissionItem

if TYPE_CHECKING:
    from tests.conftest import Net, StartOnboard

ENUMS = load_dialect().enums
PATIENCE_S = 30.0
LAT, LON = -35.363261, 149.165230
WAYPOINT = "MAV_CMD_NAV_WAYPOINT"
RALLY = [MissionItem(command="MAV_CMD_NAV_RALLY_POINT", x=LAT, y=LON, z=20.0)]


def waypoints(count: int, alt: float = 5.0) -> list[MissionItem]:
    return [
        MissionItem(command=WAYPOINT, params=[0.0] * 4, x=round(LAT + i * 2e-5, 7), y=LON, z=alt) for i in range(count)
    ]


class Scene:
    """A simulated copter, its agent in a router, and a client."""

    def __init__(self, net: Net, onboard: StartOnboard) -> None:
        self._net, self._onboard = net, onboard

    async def __call__(self, z_of: Any, world: World, link: str | None = None) -> tuple[zmav.Vehicle, Any]:
        session, endpoint = self._net.router()
        agent = await self._onboard(session, link or world.urls[0])
        z = await z_of(zmav.open(connect=[endpoint]))
        (quad,) = await z.wait_for("quad1", timeout=PATIENCE_S)
        await quad.wait_until(lambda s: s.connected, PATIENCE_S)
        return quad, agent


@pytest.fixture
def scene(net: Net, onboard: StartOnboard) -> Scene:
    return Scene(net, onboard)


def world(speed: float = 8.0) -> World:
    return World([VehicleSpec(params={"DISARM_DELAY": 0.0})], endpoint="tcp:0", speed=speed, ready_s=0.5)


async def test_what_can_be_uploaded(scene: Scene, tmp_path: Path) -> None:
    async with contextlib.AsyncExitStack() as stack:
        quad, _ = await scene(stack.enter_async_context, stack.enter_context(world()))
        told: list[dict[str, Any]] = []
        done = await quad.missions.upload(waypoints(4), progress=told.append)
        assert (list(done), done["mission"]["count"]) == (["mission"], 4)
        assert (await quad.missions.get()).items == waypoints(4)
        await quad.missions.upload(RALLY, "rally")
        assert [i.z for i in (await quad.missions.get("rally")).items] == [20.0]
        path = tmp_path / "both.plan"
        plans.save(path, Plan(mission=waypoints(2), rally=RALLY * 2), ENUMS)
        done = await quad.missions.upload(path)
        assert {kind: each["count"] for kind, each in done.items()} == {"mission": 2, "rally": 2}
        await quad.missions.upload(path, "mission")
        got = await quad.missions.download("rally")
        assert (got.kind, len(got.items)) == ("rally", 2)
        await quad.missions.clear()
        assert (await quad.missions.get()).items == []
        with pytest.raises(BadInput, match="holds no fence"):
            await quad.missions.upload(path, "fence")
        with pytest.raises(BadInput, match="item 1: latitude"):
            await quad.missions.upload([*waypoints(1), MissionItem(command=WAYPOINT, x=100.0)])


async def test_an_ardupilot_s_plans_are_read_as_files(scene: Scene) -> None:
    """A refusal among them: not one item is asked for."""
    unknown = MissionItem(command="MAV_CMD_NAV_GUIDED_ENABLE", params=[1.0])
    async with contextlib.AsyncExitStack() as stack:
        quad, agent = await scene(stack.enter_async_context, stack.enter_context(world()))
        await quad.wait_until(lambda s: s.uid is not None, PATIENCE_S)  # it has said what it can
        await quad.missions.upload(waypoints(60))
        await quad.missions.upload(RALLY, "rally")
        words = r"refused item 60 \(MAV_CMD_NAV_GUIDED_ENABLE\).*the old mission \(60 items\), restored"
        with pytest.raises(Refused, match=words):
            await quad.missions.upload([*waypoints(60, alt=9.0), unknown, *waypoints(5)])
        assert (await quad.missions.download()).items == waypoints(60)
        assert [i.z for i in (await quad.missions.download("rally")).items] == [20.0]
        assert agent.adapter.newest("MISSION_ITEM_INT") is None
        fence = MissionItem(
            command="MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION", frame="MAV_FRAME_GLOBAL", params=[300.0], x=LAT, y=LON
        )
        await quad.missions.upload([fence], "fence")
        assert [i.params[0] for i in (await quad.missions.get("fence")).items] == [300.0]


async def test_a_mission_is_flown_to_its_end(scene: Scene) -> None:
    async with contextlib.AsyncExitStack() as stack:
        quad, _ = await scene(stack.enter_async_context, stack.enter_context(world()))
        takeoff = MissionItem(command="MAV_CMD_NAV_TAKEOFF", params=[0.0] * 4, z=5.0)
        await quad.missions.upload([takeoff, *waypoints(3)])
        with pytest.raises(Refused, match="disarmed: arm it first"):
            await quad.missions.start()
        await quad.set_mode("GUIDED")
        await quad.arm(ready_timeout=PATIENCE_S)
        told: list[dict[str, Any]] = []
        ended = await quad.missions.start(wait_end=True, progress=lambda news: told.append(dict(news)))
        assert (ended["total"], ended["reached"]) == (4, 3)
        assert {"current", "total"} <= {name for news in told for name in news}
        assert quad.state.position
        assert quad.state.position.alt_rel == pytest.approx(5.0, abs=1.0)
        assert quad.state.position.lat_deg == pytest.approx(LAT + 4e-5, abs=3e-5)


async def test_go_on_with_another_item(scene: Scene) -> None:
    async with contextlib.AsyncExitStack() as stack:
        quad, _ = await scene(stack.enter_async_context, stack.enter_context(world()))
        await quad.missions.upload(waypoints(6))
        await quad.set_mode("GUIDED")
        await quad.arm(ready_timeout=PATIENCE_S)
        await quad.takeoff(5.0)
        await quad.missions.start(first=1)
        await quad.missions.set_current(5)
        await quad.wait_until(lambda s: bool(s.position and s.position.lat_deg > LAT + 9e-5), PATIENCE_S)
        assert (await quad.missions.get()).current == 5
        with pytest.raises(BadInput, match="no item 6: the mission has 6"):
            await quad.missions.set_current(6)


async def test_many_items_over_a_lossy_link(scene: Scene) -> None:
    """20 % of the frames lost and 200 ms delay each way, all of it ten times as fast as life."""
    async with contextlib.AsyncExitStack() as stack:
        fast = stack.enter_context(world(speed=10.0))
        link = f"lossy:{fast.urls[0]}?loss=0.2&delay=0.02&seed=3"
        quad, agent = await scene(stack.enter_async_context, fast, link)
        agent.missions.pace = TransferTimes(reply=0.07, shortest=0.02, longest=0.15)
        done = await quad.missions.upload(waypoints(60))
        assert done["mission"]["known_by"] == "read back"
        assert (await quad.missions.download()).items == waypoints(60)
