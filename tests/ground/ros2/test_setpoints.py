"""Streams of setpoints from ROS: flown under a lease, held when they are cut, and dropped for every reason there is."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
import os
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import zenoh

from ground.ros2 import graph
from ground.ros2.attachment import Attachment
from ground.ros2.setpoints import pose_fields, velocity
from ground.ros2.steering import SILENCE, Steering
from ground.ros2.types import known
from tests.ground.ros2.conftest import PATIENCE_S, Fleet, Peer
from tests.waiting import wait_until
from zmav import wire
from zmav.errors import NotHolder, Refused
from zmav.session import SessionSettings, open_session
from zmav.sim import VehicleSpec

QUAD = VehicleSpec(params={"DISARM_DELAY": 0.0, "LAND_SPEED": 150.0})
POSE, TWIST = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/Twist"


@pytest.fixture(scope="module")
def fleet() -> Iterator[Fleet]:
    """quad1 at 6 m."""
    with Fleet(["quad1"], [QUAD], speed=2.0, may_order=True) as fleet:

        async def up() -> None:
            quad = fleet.z.vehicle("quad1")
            await quad.arm()
            await quad.takeoff(6.0)

        fleet.run(up())
        yield fleet


@pytest.fixture(scope="module")
def raw(fleet: Fleet) -> Iterator[zenoh.Session]:
    with open_session(SessionSettings(connect=[f"tcp/127.0.0.1:{fleet.port}"])) as session:
        yield session


@pytest.fixture(autouse=True)
def nobody_commands(fleet: Fleet) -> Iterator[None]:
    yield
    wait_until(lambda: state(fleet).lease is None and fleet.face.vehicles["quad1"].steering.holder is None)


def state(fleet: Fleet) -> wire.VehicleState:
    found = fleet.z.vehicle("quad1").last_state
    assert found is not None
    return found


class Stream:
    """Setpoints of one publisher, 20 a second, from a thread."""

    def __init__(self, raw: zenoh.Session, topic: str, kind: str, message: Any, gid: bytes = b"") -> None:
        self._raw, self._kind, self.message, self._gid = raw, kind, message, gid or os.urandom(16)
        self._key = f"0/quad1/{topic}/{graph.dds_of(kind)}/{known().hash(kind)}"
        self.sequence = int(time.time() * 1e3)
        self.last = 0.0
        self._stop = threading.Event()

    def put(self, sequence: int | None = None, age: float = 0.0, said: bytes | None = None) -> None:
        self.sequence += 1
        stamp = time.time_ns() - int(age * 1e9)
        attached = said or Attachment(sequence or self.sequence, stamp, self._gid).encode()
        self.last = time.monotonic()
        self._raw.put(self._key, known().encode(self.message, self._kind), attachment=attached)

    @contextlib.contextmanager
    def running(self) -> Iterator[Stream]:
        self._stop.clear()
        thread = threading.Thread(target=self._run)
        thread.start()
        try:
            yield self
        finally:
            self._stop.set()
            thread.join()

    def _run(self) -> None:
        while not self._stop.wait(0.05):
            self.put()


def pose(at: wire.Vector, frame: str = "map", **q: float) -> Any:
    """Of a place north, east, down."""
    types = known()
    point = types.make("geometry_msgs/msg/Point", x=at[1], y=at[0], z=-at[2])
    turned = types.make("geometry_msgs/msg/Quaternion", **q)
    made = types.make("geometry_msgs/msg/Pose", position=point, orientation=turned)
    return types.make(POSE, header=types.make("std_msgs/msg/Header", frame_id=frame), pose=made)


def near(fleet: Fleet, **away: float) -> wire.Vector:
    n, e, d = fleet.z.vehicle("quad1").local
    return n + away.get("n", 0.0), e + away.get("e", 0.0), d


def yaw(fleet: Fleet) -> float:
    attitude = state(fleet).attitude
    assert attitude is not None
    return attitude.yaw


def drops(fleet: Fleet) -> int:
    return fleet.face.vehicles["quad1"].steering.dropped


def test_a_stream_of_another_implementation_is_flown_and_a_cut_one_ends_in_a_hold(fleet: Fleet, peer: Peer) -> None:
    publisher = peer.publish("/quad1/setpoint_position/local", POSE)
    target = near(fleet, n=6.0)
    message = pose(target, w=1.0)  # east
    came: list[str] = []
    deadline = time.monotonic() + PATIENCE_S
    while abs(fleet.z.vehicle("quad1").local[0] - target[0]) > 0.5 or abs(yaw(fleet) - math.pi / 2) > 0.2:
        assert time.monotonic() < deadline, (state(fleet).setpoints, came)
        publisher.publish(header=message.header, pose=message.pose)
        time.sleep(0.05)
    assert state(fleet).mover == "stream"
    lease = state(fleet).lease
    assert lease is not None
    assert lease.holder.startswith("ros2-")
    cut = time.monotonic()
    wait_until(lambda: state(fleet).mover == "hold")
    assert 0.3 < time.monotonic() - cut < 2.0
    wait_until(lambda: state(fleet).lease is None)
    end = state(fleet).lease_end
    assert end is not None
    assert end.reason in ("gone", "expired"), "nobody gave it back: land_after follows"


def test_velocities_are_flown_east_north_up(fleet: Fleet, raw: zenoh.Session) -> None:
    types = known()
    before = near(fleet)
    east = types.make("geometry_msgs/msg/Vector3", x=1.5)
    stream = Stream(raw, "setpoint_velocity/cmd_vel_unstamped", TWIST, types.make(TWIST, linear=east))
    with stream.running():
        wait_until(lambda: near(fleet)[1] > before[1] + 2.0, lambda: (near(fleet), before))
    assert near(fleet)[0] == pytest.approx(before[0], abs=1.0)


def test_a_turn_to_the_left_in_ros_is_one_to_the_left() -> None:
    """Counter-clockwise from above in ROS, clockwise in MAVLink; headings are from east, and from north."""
    types = known()
    turning = types.make(TWIST, angular=types.make("geometry_msgs/msg/Vector3", z=0.5))
    assert velocity(turning)["yaw_rate"] == -0.5
    half = math.sqrt(0.5)
    for q, heading in (({"w": 1.0}, math.pi / 2), ({"z": half, "w": half}, 0.0), ({"z": -half, "w": half}, math.pi)):
        turned = pose_fields(pose((1.0, 2.0, -3.0), "map", **q).pose)["yaw"]
        assert math.remainder(turned - heading, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)
    assert pose_fields(pose((1.0, 2.0, -3.0)).pose) == {"pos": (1.0, 2.0, -3.0)}


def test_the_first_publisher_is_flown_and_another_dropped(fleet: Fleet, raw: zenoh.Session) -> None:
    here = near(fleet)
    first = Stream(raw, "setpoint_position/local", POSE, pose(here))
    other = Stream(raw, "setpoint_position/local", POSE, pose(near(fleet, e=30.0)))
    with first.running():
        wait_until(lambda: state(fleet).mover == "stream")
        before = drops(fleet)
        with other.running():
            wait_until(lambda: drops(fleet) > before + 10)
        assert near(fleet) == pytest.approx(here, abs=2.0)


def test_what_cannot_be_flown_is_dropped(fleet: Fleet, raw: zenoh.Session) -> None:
    good = pose(near(fleet))
    stream = Stream(raw, "setpoint_position/local", POSE, good)
    with stream.running():
        wait_until(lambda: state(fleet).mover == "stream")
    wait_until(lambda: state(fleet).lease is None)
    flown = state(fleet).setpoints.get("flown")
    for case, message, said in (
        ("late", good, {"age": 2.0}),
        ("of the future", good, {"age": -2.0}),
        ("out of order", good, {"sequence": 1}),
        ("nan", pose((float("nan"), 0.0, -6.0)), {}),
        ("another frame", pose((0.0, 0.0, -6.0), frame="base_link"), {}),
        ("no unit quaternion", pose((0.0, 0.0, -6.0), w=3.0), {}),
    ):
        stream.message = message
        for _ in range(3):
            before = drops(fleet)
            stream.put(**said)
            wait_until(lambda before=before: drops(fleet) > before, case)  # type: ignore[misc]
        assert state(fleet).lease is None, case
        assert state(fleet).setpoints.get("flown") == flown, case
    stream.message = good
    with stream.running():  # nothing but each message's own fault kept it from being flown
        wait_until(lambda: state(fleet).mover == "stream", "what can be flown, after it")


def test_an_attachment_that_is_none_is_counted_and_nothing_more(fleet: Fleet, raw: zenoh.Session) -> None:
    stream, before = Stream(raw, "setpoint_position/local", POSE, pose(near(fleet))), fleet.face.ros.bad
    stream.put(said=bytes(77))
    stream.put(said=b"x")
    wait_until(lambda: fleet.face.ros.bad == before + 2)
    assert state(fleet).lease is None


def test_a_stream_that_goes_on_does_not_take_again_what_was_taken_from_it(fleet: Fleet, raw: zenoh.Session) -> None:
    stream = Stream(raw, "setpoint_position/local", POSE, pose(near(fleet)))
    with stream.running():
        wait_until(lambda: state(fleet).mover == "stream")
        fleet.run(fleet.z.vehicle("quad1").revoke("enough"))
        wait_until(lambda: state(fleet).lease is None)
        until = time.monotonic() + 2 * SILENCE
        while time.monotonic() < until:
            assert state(fleet).lease is None
            time.sleep(0.05)
    time.sleep(1.2 * SILENCE)
    with stream.running():  # a new request
        wait_until(lambda: state(fleet).mover == "stream")


def steered(fleet: Fleet, **more: bool) -> tuple[Steering, Callable[[], None]]:
    """Another 'zmav ros2', and how it is given one more point of a stream."""
    gid, numbers = os.urandom(16), itertools.count()
    other = Steering(fleet.z.vehicle("quad1"), fleet.face.watch, print, may_order=True, **more)
    here = {"pos": near(fleet)}
    return other, lambda: other.fly(Attachment(next(numbers), time.time_ns(), gid), here)


def test_who_takes_over_flies_a_stream_once_that_has_paused(fleet: Fleet) -> None:
    async def take_over() -> None:
        other, fly = steered(fleet, takes_over=True)
        until = time.monotonic() + 2 * SILENCE
        while time.monotonic() < until:
            fly()
            assert other.holder is None
            await asyncio.sleep(0.05)
        await asyncio.sleep(1.2 * SILENCE)
        fly()
        assert other.holder is not None
        await other.close()

    fleet.run(take_over())


def test_who_ends_takes_no_lease_any_more(fleet: Fleet) -> None:
    """Its topics are there until all else has ended."""

    async def end() -> None:
        other, fly = steered(fleet)
        fly()
        assert other.holder is not None
        await other.close()
        fly()
        assert other.holder is None
        with pytest.raises(Refused, match="shows quad1 no longer"):
            await other.take(os.urandom(16), 9)

    fleet.run(end())


def test_neither_does_its_node_on_another_topic(fleet: Fleet, raw: zenoh.Session) -> None:
    node = graph.Node(0, str(raw.info.zid()), 71, "/", "offboard")
    kinds = {"setpoint_position/local": POSE, "setpoint_velocity/cmd_vel_unstamped": TWIST}
    ends = [
        graph.Endpoint(node, eid, graph.PUBLISHER, f"/quad1/{topic}", kind, known().hash(kind))
        for eid, (topic, kind) in enumerate(kinds.items())
    ]
    tokens = [raw.liveliness().declare_token(end.token) for end in ends]
    watch = fleet.face.watch
    wait_until(lambda: all(watch.who(end.gid) is not None for end in ends))
    messages = pose(near(fleet)), known().make(TWIST)
    one, other = (
        Stream(raw, topic, kind, message, end.gid)
        for (topic, kind), message, end in zip(kinds.items(), messages, ends, strict=True)
    )
    with one.running():
        wait_until(lambda: (lease := state(fleet).lease) is not None and lease.holder == "ros2-offboard")
        fleet.run(fleet.z.vehicle("quad1").revoke("enough"))
        wait_until(lambda: state(fleet).lease is None)
        with other.running():
            until = time.monotonic() + 2 * SILENCE
            while time.monotonic() < until:
                assert state(fleet).lease is None
                time.sleep(0.05)
    for token in tokens:
        token.undeclare()
    wait_until(lambda: not watch.has_node((node.zid, node.nid)))


def test_one_node_does_not_get_what_another_holds_with_a_higher_priority(fleet: Fleet) -> None:
    async def ask() -> None:
        steering, watch = fleet.face.vehicles["quad1"].steering, fleet.face.watch
        node = graph.Node(0, "ab", 1, "/", "first")
        end = graph.Endpoint(node, 2, graph.ASKER, "/quad1/lease", "zmav_msgs/srv/Lease", "RIHS01_ab")
        token = fleet.z.session.liveliness().declare_token(end.token)
        while watch.who(end.gid) is None:
            await asyncio.sleep(0.01)
        stranger = os.urandom(16)
        assert await steering.take(end.gid, 50) == "ros2-first"
        with pytest.raises(NotHolder, match="ros2-first"):
            await steering.take(stranger, 5)
        assert steering.holder == "/first"
        assert (await steering.take(stranger, 60)).startswith("ros2-")
        assert steering.holder != "/first"
        await steering.give_back(stranger)
        token.undeclare()

    fleet.run(ask())


def test_a_node_that_asks_again_gets_the_higher_priority(fleet: Fleet, peer: Peer) -> None:
    lease = peer.client("/quad1/lease", "zmav_msgs/srv/Lease")
    assert lease.call(take=True, priority=3).success
    assert lease.call(take=True, priority=7).success
    wait_until(
        lambda: (now := state(fleet).lease) is not None and now.priority == 7,
        lambda: (state(fleet).lease, state(fleet).lease_end),
    )
    time.sleep(1.2 * SILENCE)
    held = state(fleet).lease
    assert held is not None
    assert held.priority == 7, "and keeps it"
    assert lease.call(take=False, priority=0).success


def test_the_lease_service_keeps_the_lease_for_its_stream(fleet: Fleet, raw: zenoh.Session, peer: Peer) -> None:
    lease = peer.client("/quad1/lease", "zmav_msgs/srv/Lease")
    assert lease.call(take=True, priority=3).success
    held = state(fleet)
    wait_until(lambda: (now := state(fleet).lease) is not None and now.priority == 3, lambda: held)
    time.sleep(1.2 * SILENCE)
    assert state(fleet).lease is not None, "nothing streams, and it is kept"
    with Stream(raw, "setpoint_position/local", POSE, pose(near(fleet))).running():
        wait_until(lambda: state(fleet).mover == "stream")
    assert lease.call(take=False, priority=0).success
    wait_until(lambda: state(fleet).lease is None)
    end = state(fleet).lease_end
    assert end is not None
    assert end.reason == "released"
