"""Data of a PX4 beside its autopilot: its logs, its missions, and its events in words; against the simulated one."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest

import zmav
from tests.ports import free_udp_ports
from tests.services.files.disk import noise
from zmav import keys, wire
from zmav.autopilots.px4_events import ARMING_SUMMARY, HEALTH_SUMMARY
from zmav.cli.log import chosen_of
from zmav.errors import BadInput, Refused
from zmav.formats.plans import load
from zmav.onboard import Onboard
from zmav.sim import VehicleSpec, World
from zmav.sim.protocol.px4.node import Px4Node

if TYPE_CHECKING:
    from tests.conftest import Net, Samples, StartOnboard

PATIENCE_S = 30.0
MISSION_PLANNER = """QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t-35.363261\t149.165230\t584.09\t1
1\t0\t3\t22\t0\t0\t0\t0\t-35.363261\t149.165230\t5\t1
2\t0\t3\t178\t0\t3\t0\t0\t0\t0\t0\t1
3\t0\t3\t16\t0\t0\t0\t0\t-35.363161\t149.165230\t6\t1
4\t0\t3\t189\t0\t0\t0\t0\t0\t0\t0\t1
5\t0\t3\t20\t0\t0\t0\t0\t0\t0\t0\t1
"""


class Px4(NamedTuple):
    world: World
    node: Px4Node
    onboard: Onboard
    v: zmav.Vehicle
    events: Samples

    def log(self, data: bytes, t: float) -> bytes:
        """A log on the vehicle, ended at UTC ``t``."""
        self.world.call(lambda: self.node.storage.logs.begin(bytearray(data), t))
        return data

    async def said(self, text: str) -> dict[str, Any]:
        return await self.events.object(lambda e: text in e["text"], text)

    async def reported(self) -> None:
        """A report of its checks has come."""
        while not self.onboard.event_texts.checks.known:
            await asyncio.sleep(0.05)


@contextlib.asynccontextmanager
async def px4(
    net: Net,
    onboard: StartOnboard,
    cache: Path,
    speed: float = 4.0,
    **params: float,
) -> AsyncIterator[Px4]:
    port = free_udp_ports(1)
    spec = VehicleSpec(autopilot="px4", sysid=1, endpoints=(f"onboard:0:{port}",), params=params)
    with World([spec], ready_s=0.5, speed=speed) as world:
        node = world.vehicles[0].node
        assert isinstance(node, Px4Node)
        session, endpoint = net.router()
        events = net.ground(endpoint).samples(keys.EVENT)
        await net.linked(session, keys.EVENT.key("demo", "quad1"))
        vehicle = await onboard(session, f"udpin:127.0.0.1:{port}", cache=str(cache))
        async with zmav.open(connect=[endpoint]) as z:
            v = z.vehicle("quad1")
            await v.wait_until(lambda s: s.connected, PATIENCE_S)
            yield Px4(world, node, vehicle, v, events)
            await onboard.close(vehicle)


class TestLogs:
    async def test_the_list_is_whole_and_by_age_and_latest_is_the_newest(
        self, net: Net, onboard: StartOnboard, tmp_path: Path
    ) -> None:
        """Ids are places in a directory: the newest log has the lowest here, and the last of n is n-1."""
        async with px4(net, onboard, tmp_path, speed=1.0) as p:
            now = time.time()
            for age in (300, 200, 100):
                data = p.log(noise(1000 + age, age), now - age)
            logs = await p.v.logs.list()
            assert [(log.id, log.size) for log in logs] == [(2, 1300), (1, 1200), (0, 1100)]
            assert [log.id for log in chosen_of(logs, ("latest",))] == [0]
            assert (await p.v.logs.get(logs[-1], tmp_path / "log")).read_bytes() == data

    async def test_one_log_and_none(
        self,
        net: Net,
        onboard: StartOnboard,
        tmp_path: Path,
    ) -> None:
        async with px4(net, onboard, tmp_path, speed=1.0) as p:
            p.onboard.logs.patience = 0.2
            assert await p.v.logs.list() == []
            p.log(noise(10), time.time())
            assert [log.id for log in await p.v.logs.list()] == [0]
            assert await p.v.logs.erase() == 1
            assert await p.v.logs.list() == []


class TestMissions:
    async def test_a_file_of_mission_planner_is_taken_and_flown(
        self, net: Net, onboard: StartOnboard, tmp_path: Path
    ) -> None:
        """Items say frame 3 there; DO_SET_MISSION_CURRENT is unknown; a start right after an upload is refused once."""
        file = tmp_path / "mission.waypoints"
        file.write_text(MISSION_PLANNER)
        async with px4(net, onboard, tmp_path) as p:
            items = load(file, p.onboard.adapter.dialect.enums).mission or []
            await p.v.wait_until(lambda s: bool(s.ready), PATIENCE_S)
            await p.v.missions.upload(items)
            kept = p.world.call(lambda: [(i.command, i.frame) for i in p.node.copter.mission.items.items])
            assert kept == [(22, 3), (178, 2), (16, 3), (189, 2), (20, 2)]
            await p.v.missions.set_current(2)
            assert p.world.call(lambda: p.node.copter.mission.current) == 2
            await p.v.arm()
            await p.v.missions.clear()
            await p.v.missions.upload(items)
            await p.v.missions.start()
            await p.v.wait_until(lambda s: s.mode == "RTL", PATIENCE_S)

    async def test_a_place_where_it_takes_none_is_refused(
        self, net: Net, onboard: StartOnboard, tmp_path: Path
    ) -> None:
        async with px4(net, onboard, tmp_path) as p:
            landing = wire.MissionItem(command="MAV_CMD_DO_LAND_START", frame="MAV_FRAME_GLOBAL", x=47.0, y=8.0)
            with pytest.raises(BadInput, match="item 0: this autopilot takes MAV_CMD_DO_LAND_START without a place"):
                await p.v.missions.upload([landing])


class TestChecks:
    async def test_what_stands_against_arming_is_said(self, net: Net, onboard: StartOnboard, tmp_path: Path) -> None:
        async with px4(net, onboard, tmp_path, NAV_DLL_ACT=2.0) as p:
            why = "No ground station is heard (NAV_DLL_ACT)"
            await p.v.wait_until(lambda s: s.not_ready == [why], PATIENCE_S)
            with pytest.raises(Refused, match="not ready to arm: No ground station") as caught:
                await p.v.order("arm", wire.Arm(ready_timeout=0.5))
            assert caught.value.detail["reasons"] == [why]
            with pytest.raises(Refused, match="TEMPORARILY_REJECTED") as caught:
                await p.v.order("arm", wire.Arm(ready_timeout=0.0))
            assert caught.value.detail["reasons"] == ["Not armed: a health or arming check fails", why]
            assert (await p.said("Not armed"))["detail"]["name"] == "commander_arm_denied_resolve_failures"

    async def test_a_check_is_said_once(self, net: Net, onboard: StartOnboard, tmp_path: Path) -> None:
        async with px4(net, onboard, tmp_path) as p:
            await p.reported()
            for _ in range(3):
                await p.v.order("command", wire.RunCommand(command="MAV_CMD_RUN_PREARM_CHECKS"))
            await p.v.arm()
            await p.said("Armed")
            texts = [e["text"] for e in p.events.objects() if "name" in e["detail"]]
            assert texts.count("No mission to fly") == 1
            told = {e["detail"].get("id") for e in p.events.objects()}
            assert told.isdisjoint({ARMING_SUMMARY, HEALTH_SUMMARY}), "a report's own ends are not for people"
