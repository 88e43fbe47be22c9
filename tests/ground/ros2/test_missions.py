"""Missions by MAVROS's services and topics, asked by other people's clients."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pytest
from zenoh_ros2_sdk.session import ZenohSession

from ground.ros2.types import known
from tests.ground.ros2.conftest import HOME, Fleet, Peer, first
from tests.waiting import wait_until
from zmav import wire
from zmav.sim import VehicleSpec

PUSH, PULL = "mavros_msgs/srv/WaypointPush", "mavros_msgs/srv/WaypointPull"
CLEAR, CURRENT = "mavros_msgs/srv/WaypointClear", "mavros_msgs/srv/WaypointSetCurrent"
LIST, ONE = "mavros_msgs/msg/WaypointList", "mavros_msgs/msg/Waypoint"
NAMES = ["quad1", "px4"]
NAV, JUMP = 16, 177


@pytest.fixture(scope="module")
def fleet() -> Iterator[Fleet]:
    specs = [VehicleSpec(params={"DISARM_DELAY": 0.0}), VehicleSpec(autopilot="px4", sysid=2)]
    with Fleet(NAMES, specs, speed=1.0, may_order=True) as fleet:
        yield fleet


def client(peer: Peer, service: str, kind: str) -> Any:
    session = ZenohSession.get_instance(**peer.where)
    session.register_message_type(known().definition(ONE), ONE)
    return peer.client(service, kind)


def waypoint(north: float, **fields: Any) -> Any:
    """``north``: m of the fleet's origin."""
    usual = {"frame": 3, "command": NAV, "autocontinue": True, "x_lat": HOME.lat_deg + north / 111_000.0}
    return known().make(ONE, **(usual | {"y_long": HOME.lon_deg, "z_alt": 8.0, "param4": math.nan} | fields))


def plan(name: str) -> list[Any]:
    """As a script for MAVROS has it: ArduPilot's with home before it."""
    return [waypoint(0.0, frame=0)] * (name == "quad1") + [waypoint(5.0), waypoint(15.0), waypoint(25.0)]


@pytest.mark.parametrize("name", NAMES)
def test_a_plan_is_pushed_seen_and_cleared(fleet: Fleet, peer: Peer, name: str) -> None:
    lists, _ = peer.subscribe(f"/{name}/mission/waypoints", LIST, qos=":1:,1:,:,:,,")
    given = plan(name)
    answer = client(peer, f"/{name}/mission/push", PUSH).call(start_index=0, waypoints=given)
    assert (answer.success, answer.wp_transfered) == (True, len(given))
    held = fleet.run(fleet.z.vehicle(name).missions.get())
    assert [round((item.x - HOME.lat_deg) * 111_000.0) for item in held.items] == [5, 15, 25]

    wait_until(lambda: lists and len(lists[-1].waypoints) == len(given), lambda: lists)
    last = lists[-1].waypoints[-1]
    assert (last.frame, last.command, last.z_alt) == (3, NAV, pytest.approx(8.0))
    assert last.x_lat == pytest.approx(given[-1].x_lat, abs=1e-6)
    pulled = client(peer, f"/{name}/mission/pull", PULL).call(structure_needs_at_least_one_member=0)
    assert (pulled.success, pulled.wp_received) == (True, len(given))

    index = len(given) - 1
    assert client(peer, f"/{name}/mission/set_current", CURRENT).call(wp_seq=index).success
    wait_until(lambda: lists[-1].current_seq == index, lambda: lists[-1].current_seq)
    assert lists[-1].waypoints[index].is_current
    assert client(peer, f"/{name}/mission/clear", CLEAR).call(structure_needs_at_least_one_member=0).success
    wait_until(lambda: not lists[-1].waypoints)


CORNERS = ((0.0, 0.0), (60.0, 0.0), (60.0, 0.001))
"""m north, and degrees east, of the fleet's origin"""


@pytest.mark.parametrize(
    ("base", "topic", "kind", "points"),
    [
        (
            "geofence",
            "fences",
            "fence",
            [
                {"north": n, "command": 5001, "y_long": HOME.lon_deg + e, "param1": 3.0, "param4": 0.0, "z_alt": 0.0}
                for n, e in CORNERS
            ],
        ),
        ("rallypoint", "rallypoints", "rally", [{"north": 30.0, "command": 5100, "param4": 0.0}]),
    ],
)
@pytest.mark.parametrize("name", NAMES)
def test_a_fence_and_rally_points(
    fleet: Fleet, peer: Peer, name: str, base: str, topic: str, kind: wire.MissionKind, points: list[dict[str, Any]]
) -> None:
    """No home stands before them, whichever autopilot it is."""
    given = [waypoint(**point) for point in points]
    lists, _ = peer.subscribe(f"/{name}/{base}/{topic}", LIST, qos=":1:,1:,:,:,,")
    answer = client(peer, f"/{name}/{base}/push", PUSH).call(start_index=0, waypoints=given)
    assert (answer.success, answer.wp_transfered) == (True, len(given))
    held = fleet.run(fleet.z.vehicle(name).missions.get(kind))
    assert [item.x for item in held.items] == pytest.approx([each.x_lat for each in given], abs=1e-6)
    wait_until(lambda: lists and len(lists[-1].waypoints) == len(given), lambda: lists)
    shown = lists[-1].waypoints
    assert [each.command for each in shown] == [each.command for each in given]
    assert not any(each.is_current for each in shown)
    pulled = client(peer, f"/{name}/{base}/pull", PULL).call(structure_needs_at_least_one_member=0)
    assert (pulled.success, pulled.wp_received) == (True, len(given))
    assert client(peer, f"/{name}/{base}/clear", CLEAR).call(structure_needs_at_least_one_member=0).success
    wait_until(lambda: not lists[-1].waypoints)


def test_what_is_reached_is_told(fleet: Fleet, fast: None, peer: Peer) -> None:
    async def fly() -> None:
        vehicle = fleet.z.vehicle("quad1")
        await vehicle.arm()
        await vehicle.takeoff(8.0)
        await vehicle.missions.start()

    assert client(peer, "/quad1/mission/push", PUSH).call(start_index=0, waypoints=plan("quad1")).success
    came, _ = peer.subscribe("/quad1/mission/reached", "mavros_msgs/msg/WaypointReached")
    fleet.run(fly())
    assert 1 <= first(came).wp_seq <= 3
    wait_until(lambda: came[-1].wp_seq == 3, lambda: [each.wp_seq for each in came])


@pytest.mark.parametrize(
    ("index", "fields", "words"),
    [
        (0, {"x_lat": math.nan}, "x_lat is nan"),
        (0, {"frame": 200}, "frame is 200"),
        (1, {}, "start_index is 1"),
    ],
)
def test_nonsense_is_refused_with_its_reason(
    fleet: Fleet, peer: Peer, index: int, fields: dict[str, Any], words: str
) -> None:
    logs, _ = peer.subscribe("/rosout", "rcl_interfaces/msg/Log")
    answer = client(peer, "/px4/mission/push", PUSH).call(start_index=index, waypoints=[waypoint(5.0, **fields)])
    assert not answer.success
    wait_until(lambda: any(words in log.msg for log in logs), lambda: [log.msg for log in logs])


def test_nothing_is_changed_without_orders() -> None:
    with Fleet(["px4"], [VehicleSpec(autopilot="px4")], speed=1.0, may_order=False) as fleet:
        peer, missions = Peer(fleet.port), fleet.z.vehicle("px4").missions
        before = fleet.run(missions.get())
        assert not client(peer, "/px4/mission/push", PUSH).call(start_index=0, waypoints=[waypoint(9.0)]).success
        assert not client(peer, "/px4/mission/clear", CLEAR).call(structure_needs_at_least_one_member=0).success
        assert not client(peer, "/px4/mission/set_current", CURRENT).call(wp_seq=0).success
        assert fleet.run(missions.get()).items == before.items
        peer.close()


def test_jumps_count_as_the_autopilot_does(fleet: Fleet) -> None:
    missions = fleet.face.vehicles["quad1"].missions.plans["mission"]
    item = missions.item_of(3, waypoint(0.0, command=JUMP, param1=2.0, param2=1.0, param4=0.0), 1)
    assert (item.command, item.params[0]) == ("MAV_CMD_DO_JUMP", 1.0)
    assert missions.waypoint_of(item, 1).param1 == 2.0
