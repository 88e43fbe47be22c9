"""Two vehicles as nodes of ROS 2, seen by other people's ROS 2."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest

from tests.ground.ros2.conftest import HOME, Fleet, Peer, first
from tests.waiting import wait_until
from zmav.sim import VehicleSpec

if TYPE_CHECKING:
    from ground.ros2.face import VehicleNode

QUAD = VehicleSpec(params={"DISARM_DELAY": 0.0})


@pytest.fixture(scope="module")
def fleet() -> Iterator[Fleet]:
    """quad-1 (ArduPilot) and px4 (PX4), ready on the ground."""
    specs = [QUAD, VehicleSpec(autopilot="px4", sysid=2)]
    with Fleet(["quad-1", "px4"], specs, speed=1.0, may_order=False) as fleet:
        yield fleet


def node(fleet: Fleet, name: str) -> VehicleNode:
    return fleet.face.vehicles[name]


def test_each_vehicle_is_a_node_with_its_topics(fleet: Fleet, peer: Peer) -> None:
    wait_until(lambda: "/px4/imu/data" in peer.topics())
    found = peer.topics()
    for name in ("quad_1", "px4"):
        assert found[f"/{name}/imu/data"] == ["sensor_msgs/msg/Imu"]
        assert found[f"/{name}/state"] == ["mavros_msgs/msg/State"]
        assert found[f"/{name}/local_position/odom"] == ["nav_msgs/msg/Odometry"]
    assert found["/tf"] == ["tf2_msgs/msg/TFMessage"]
    info = peer.info("/quad_1/imu/data")
    (publisher,) = info.publishers
    assert (publisher.node_namespace, publisher.node_name) == ("/quad_1", "zmav")
    assert publisher.qos == "2::,5:,:,:,,"
    assert len(peer.info("/tf").publishers) == 2


def test_another_ones_topic_command_lists_and_describes_them(fleet: Fleet) -> None:
    """As 'ros2 topic list -t' and 'ros2 topic info -v'."""

    def run(*arguments: str) -> str:
        where = ("--router", f"127.0.0.1:{fleet.port}", "--domain-id", "0")
        command = [sys.executable, "-m", "zenoh_ros2_sdk.topic_cli", *where, *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True, timeout=60).stdout

    assert "/px4/imu/data [sensor_msgs/msg/Imu]" in run("list", "-t")
    info = run("info", "-v", "/px4/imu/data")
    assert "Publisher count: 1" in info
    assert "Node name: zmav" in info


def test_nothing_is_wanted_before_somebody_subscribes_nor_after(fleet: Fleet, peer: Peer) -> None:
    vehicle = node(fleet, "quad_1")
    assert vehicle.telemetry.wanted == []
    wait_until(lambda: not fleet.wants("quad-1"))
    came, close = peer.subscribe("/quad_1/imu/data", "sensor_msgs/msg/Imu")
    imu = first(came)
    assert vehicle.telemetry.wanted == ["imu/data"]
    wait_until(lambda: {"ATTITUDE", "RAW_IMU"} <= fleet.wants("quad-1"))  # the second may be known a moment later
    assert not fleet.wants("px4"), "nobody subscribes to the other's"
    assert imu.header.frame_id == "quad_1/base_link"
    close()
    wait_until(lambda: not vehicle.telemetry.wanted)
    wait_until(lambda: not fleet.wants("quad-1"))


@pytest.mark.parametrize(("name", "vehicle"), [("quad_1", "quad-1"), ("px4", "px4")])
def test_what_it_feels_is_up(fleet: Fleet, peer: Peer, name: str, vehicle: str) -> None:
    """On the ground the body is pushed up with g: along z in ROS's frame."""
    came, _ = peer.subscribe(f"/{name}/imu/data", "sensor_msgs/msg/Imu")
    wait_until(lambda: came and came[-1].linear_acceleration_covariance[0] == 0.0)
    imu = came[-1]
    assert imu.linear_acceleration.z == pytest.approx(9.81, abs=0.5)
    yaw = yaw_of(imu.orientation)
    state = fleet.z.vehicle(vehicle).state
    assert state.attitude is not None
    assert math.remainder(yaw - (math.pi / 2 - state.attitude.yaw), 2 * math.pi) == pytest.approx(0.0, abs=0.1)


def yaw_of(q: Any) -> float:
    return math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y**2 + q.z**2))


def test_where_it_is_agrees_in_every_topic(fleet: Fleet, peer: Peer) -> None:
    local = fleet.z.vehicle("px4").local
    poses, _ = peer.subscribe("/px4/local_position/pose", "geometry_msgs/msg/PoseStamped")
    odometry, _ = peer.subscribe("/px4/local_position/odom", "nav_msgs/msg/Odometry")
    frames, _ = peer.subscribe("/tf", "tf2_msgs/msg/TFMessage")
    fixes, _ = peer.subscribe("/px4/global_position/global", "sensor_msgs/msg/NavSatFix")
    heights, _ = peer.subscribe("/px4/global_position/rel_alt", "std_msgs/msg/Float64")
    pose = first(poses)
    assert pose.header.frame_id == "demo"
    at = pose.pose.position
    assert (at.y, at.x, -at.z) == pytest.approx(local, abs=0.5)
    odom = first(odometry)
    assert (odom.header.frame_id, odom.child_frame_id) == ("demo", "px4/base_link")
    assert (odom.pose.pose.position.x, odom.pose.pose.position.y) == pytest.approx((at.x, at.y), abs=0.5)
    wait_until(lambda: {each.transforms[0].child_frame_id for each in frames} >= {"px4/base_link", "quad_1/base_link"})
    assert {each.transforms[0].header.frame_id for each in frames} == {"demo"}
    wait_until(lambda: fixes and fixes[-1].status.status >= 0)  # -2 until the receiver was heard, too
    fix = fixes[-1]
    assert fix.latitude == pytest.approx(HOME.lat_deg, abs=1e-3)
    assert abs(first(heights).data) < 2.0


def test_who_comes_late_is_given_the_state(fleet: Fleet, peer: Peer) -> None:
    came, _ = peer.subscribe("/px4/state", "mavros_msgs/msg/State", qos=":1:,1:,:,:,,")
    state = first(came)
    assert state.connected
    assert not state.armed
    assert state.mode.isupper()
    wait_until(lambda: came[-1].mode == "AUTO.LOITER", lambda: came[-1].mode)


def test_battery_and_diagnostics(fleet: Fleet, peer: Peer) -> None:
    came, _ = peer.subscribe("/quad_1/battery", "sensor_msgs/msg/BatteryState")
    told, _ = peer.subscribe("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
    battery = first(came)
    assert 9.0 < battery.voltage < 60.0
    assert 0.5 < battery.percentage <= 1.0
    wait_until(lambda: {each.status[0].name for each in told} >= {"quad_1: vehicle", "px4: vehicle"})
    assert {value.key for value in told[-1].status[0].values} >= {"mode", "link"}


def test_a_type_of_another_version_is_said(fleet: Fleet, peer: Peer) -> None:
    """Humble's and older definitions have other hashes: who subscribes so would wait for ever."""
    peer.subscribe("/px4/battery", "std_msgs/msg/String")
    wait_until(lambda: any("/px4/battery as std_msgs/msg/String" in line for line in fleet.said), lambda: fleet.said)
    assert node(fleet, "px4").telemetry.wanted == []
    peer.publish("/px4/setpoint_position/local", "std_msgs/msg/String")
    wait_until(lambda: any("/px4/setpoint_position/local as std" in line for line in fleet.said), lambda: fleet.said)
