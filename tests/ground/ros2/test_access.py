"""A fleet with credentials, from a certificate to a vehicle that flies, or does not: a viewer's node of ROS only
listens, an operator's flies.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

import zmav
from ground.ros2 import attachment, graph
from ground.ros2.cli import may_order
from ground.ros2.face import Face
from ground.ros2.types import known
from tests.ground.ros2.conftest import HOME
from tests.ground.ros2.test_setpoints import POSE, pose
from tests.mesh.credentials.conftest import Door
from tests.mesh.credentials.conftest import Fleet as Members
from tests.waiting import until
from zmav import wire
from zmav.config import FleetConfig
from zmav.config.fleet import Ros2
from zmav.onboard import Onboard, OnboardSettings
from zmav.session import SessionSettings
from zmav.sim import VehicleSpec, World
from zmav.trust.certificate import Role

PATIENCE_S = 60.0
ARM, TAKEOFF = "mavros_msgs/srv/CommandBool", "mavros_msgs/srv/CommandTOL"
SET, GOAL = "rcl_interfaces/srv/SetParameters", "zmav_msgs/action/Takeoff_SendGoal"
IMU = "sensor_msgs/msg/Imu"
MEMBERS = {"quad1": Role.VEHICLE, "ros": Role.OPERATOR, "ops": Role.OPERATOR, "eye": Role.VIEWER}


class Node:
    """A node of ROS with somebody's certificate: it publishes positions, asks services and hears a topic."""

    def __init__(self, session: zenoh.Session, name: str) -> None:
        self.session = session
        node = graph.Node(0, str(session.info.zid()), 1, "/", name)
        topic = "/quad1/setpoint_position/local"
        self._point = graph.Endpoint(node, 2, graph.PUBLISHER, topic, POSE, known().hash(POSE))
        reader = graph.Endpoint(node, 3, graph.SUBSCRIBER, "/quad1/imu/data", IMU, known().hash(IMU))
        self.came: list[Any] = []
        session.declare_subscriber(reader.key, self.came.append)
        self._tokens = [session.liveliness().declare_token(each.token) for each in (self._point, reader)]
        self._sequence = 0

    def publish(self, at: wire.Vector) -> None:
        self._sequence += 1
        said = attachment.write(self._sequence, self._point.gid)
        self.session.put(self._point.key, known().encode(pose(at), POSE), attachment=said)

    async def call(self, service: str, kind: str, timeout: float = 30.0, **fields: Any) -> Any:
        """The answer; None: nobody was asked."""
        request = known().encode(known().make(f"{kind}_Request", **fields), f"{kind}_Request")
        key = f"0/quad1/{service}/{graph.dds_of(kind)}/{known().hash(kind)}"

        def ask() -> list[zenoh.Reply]:
            said = attachment.write(1, self._point.gid)
            target = zenoh.QueryTarget.ALL_COMPLETE
            return list(self.session.get(key, payload=request, attachment=said, target=target, timeout=timeout))

        for reply in await asyncio.to_thread(ask):
            if reply.ok is not None:
                return known().decode(reply.ok.payload.to_bytes(), f"{kind}_Response")
        return None


@contextlib.asynccontextmanager
async def flown(folder: Path) -> AsyncIterator[tuple[Members, Door, Face, zmav.Client]]:
    """quad1's router and agent, and 'zmav ros2 --orders' with the certificate of the operator ``ros`` beside it."""
    members = Members(folder)
    members.issue(**MEMBERS)
    file = FleetConfig(fleet="alpha", origin=HOME, ros2=Ros2(domain=0))
    door = members.router("quad1", file=file)
    spec = VehicleSpec(params={"DISARM_DELAY": 0.0, "LAND_SPEED": 150.0})
    with contextlib.closing(members), World([spec], endpoint="tcp:0", speed=4.0, ready_s=0.5) as world:
        own = str(members.members["quad1"])
        aboard = OnboardSettings(link=world.urls[0], name="quad1", fleet="alpha", origin=HOME, credentials=own)
        settings = SessionSettings(connect=[door.tls], credentials=str(members.members["ros"]))
        async with Onboard(door.session, aboard), zmav.open(fleet="alpha", settings=settings) as z:
            (vehicle,) = await z.wait_for("quad1", timeout=PATIENCE_S)
            await vehicle.wait_until(lambda s: s.connected and bool(s.ready), PATIENCE_S)
            assert may_order(z)
            async with Face(z, 0, {}, print, may_order=True) as face:
                await until(lambda: "quad1" in face.vehicles)
                yield members, door, face, z


@pytest.mark.timeout(240)
async def test_a_viewers_node_listens_and_an_operators_flies(tmp_path: Path) -> None:
    async with flown(tmp_path) as (members, door, face, z):
        quad, steering = face.vehicles["quad1"].vehicle, face.vehicles["quad1"].steering
        before = await z.vehicle("quad1").params.get("RTL_ALT")
        viewer = Node(members.open("eye", door.tls), "spectator")
        await until(lambda: viewer.came, "a viewer's node hears")
        value = known().make("rcl_interfaces/msg/ParameterValue", type=2, integer_value=2345)
        parameter = known().make("rcl_interfaces/msg/Parameter", name="RTL_ALT", value=value)
        for service, kind, fields in (
            ("cmd/arming", ARM, {"value": True}),
            ("param/set_parameters", SET, {"parameters": [parameter]}),
            ("takeoff/_action/send_goal", GOAL, {}),
        ):
            assert await viewer.call(service, kind, timeout=3.0, **fields) is None, f"{service} was asked"
        assert quad.state.armed is False
        assert await z.vehicle("quad1").params.get("RTL_ALT") == before

        operator = Node(members.open("ops", door.tls), "pilot")
        await until(lambda: operator.came)
        assert (await operator.call("cmd/arming", ARM, value=True)).success
        assert (await operator.call("cmd/takeoff", TAKEOFF, altitude=6.0)).success
        await quad.wait_until(lambda s: s.position is not None and s.position.alt_rel > 5.0, PATIENCE_S)
        await until(lambda: quad.state.velocity is not None and math.hypot(*quad.state.velocity) < 0.2)
        north, east, down = quad.local
        ends, heard = time.monotonic() + 3.0, len(viewer.came)
        while time.monotonic() < ends:
            viewer.publish((north + 15.0, east, down))
            await asyncio.sleep(0.05)
        assert quad.state.lease is None
        assert steering.holder is None
        assert steering.dropped == 0, "not even looked at"
        assert abs(quad.local[0] - north) < 1.0
        assert len(viewer.came) > heard, "it hears all the while"

        def there() -> bool:
            operator.publish((north + 15.0, east, down))
            return quad.local[0] > north + 14.0

        await until(there)
        assert steering.holder == "/pilot"
        assert quad.state.lease is not None
        assert quad.state.lease.holder == "ros2-pilot"
