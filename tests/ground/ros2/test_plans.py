"""What a planner has vehicles fly, as paths of ROS."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.ground.ros2.conftest import Fleet, Peer
from tests.waiting import wait_until
from zmav import keys, wire
from zmav.session import SessionSettings, open_session
from zmav.sim import VehicleSpec
from zmav.wire import swarm

KIND = "nav_msgs/msg/Path"
PLAN = swarm.PlanReport(
    t=1.0,
    planner="planner",
    goal="g1",
    start=1000.25,
    makespan=2.5,
    clearance=None,
    tracks={"quad-1": [(0.0, 1.0, 2.0, -3.0), (2.5, 4.0, 5.0, -6.0)], "other": [(0.0, 9.0, 9.0, 9.0)]},
)


@pytest.fixture(scope="module")
def fleet() -> Iterator[Fleet]:
    with Fleet(["quad-1"], [VehicleSpec()], speed=1.0, may_order=False) as fleet:
        yield fleet


def test_a_plan_is_each_vehicles_path(fleet: Fleet, peer: Peer) -> None:
    came, close = peer.subscribe("/quad_1/plan", KIND, qos=":1:,1:,:,:,,")
    with open_session(SessionSettings(connect=[f"tcp/127.0.0.1:{fleet.port}"])) as session:
        publisher = session.declare_publisher(keys.FLEET.key("demo", topic="plan"), **keys.FLEET.publishing())

        def said() -> bool:
            publisher.put(b"{")
            publisher.put(wire.encode(PLAN))
            return bool(came)

        wait_until(said)
        path = came[-1]
        assert (path.header.frame_id, path.header.stamp.sec, path.header.stamp.nanosec) == ("demo", 1000, 250_000_000)
        assert [(p.pose.position.x, p.pose.position.y, p.pose.position.z) for p in path.poses] == [(2, 1, 3), (5, 4, 6)]
        last = path.poses[-1]
        assert (last.header.stamp.sec, last.header.stamp.nanosec) == (1002, 750_000_000)
        assert last.pose.orientation.w == 1.0
        close()
        plans = fleet.face.vehicles["quad_1"].plans
        wait_until(lambda: not plans.heard, "nobody subscribes, and plans are still heard")
