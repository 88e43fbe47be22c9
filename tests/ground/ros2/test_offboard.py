"""PX4's own example for MAVROS by its calls: stream, ask for OFFBOARD, arm, and look at the state until it is so."""

from __future__ import annotations

import threading
import time

from ground.ros2.types import known
from tests.ground.ros2.conftest import PATIENCE_S, Fleet, Peer, first
from zmav.sim import VehicleSpec

POSE = "geometry_msgs/msg/PoseStamped"
ASK_EVERY = 1.0


def test_the_offboard_example_takes_off() -> None:
    with Fleet(["px4"], [VehicleSpec(autopilot="px4")], speed=2.0, may_order=True) as fleet:
        peer = Peer(fleet.port)
        try:
            offboard(peer)
        finally:
            peer.close()


def offboard(peer: Peer) -> None:
    states, _ = peer.subscribe("/px4/state", "mavros_msgs/msg/State")
    poses, _ = peer.subscribe("/px4/local_position/pose", POSE)
    points = peer.publish("/px4/setpoint_position/local", POSE)
    set_mode = peer.client("/px4/set_mode", "mavros_msgs/srv/SetMode")
    arming = peer.client("/px4/cmd/arming", "mavros_msgs/srv/CommandBool")
    types, start = known(), first(poses).pose.position
    up = types.make("geometry_msgs/msg/Point", x=start.x, y=start.y, z=start.z + 2.0)
    east = types.make("geometry_msgs/msg/Quaternion", w=1.0)
    wanted = types.make(POSE, pose=types.make("geometry_msgs/msg/Pose", position=up, orientation=east))
    stop = threading.Event()

    def stream() -> None:
        while not stop.wait(0.05):
            points.publish(header=wanted.header, pose=wanted.pose)

    streaming = threading.Thread(target=stream)
    streaming.start()
    try:
        first(states)
        asked, deadline = 0.0, time.monotonic() + PATIENCE_S
        while poses[-1].pose.position.z < start.z + 1.5:
            assert time.monotonic() < deadline, (states[-1], poses[-1].pose.position)
            if time.monotonic() - asked > ASK_EVERY:
                if states[-1].mode != "OFFBOARD":
                    set_mode.call(base_mode=0, custom_mode="OFFBOARD")
                if not states[-1].armed:
                    arming.call(value=True)
                asked = time.monotonic()
            time.sleep(0.05)
        assert states[-1].mode == "OFFBOARD"
        assert states[-1].guided
    finally:
        stop.set()
        streaming.join()
