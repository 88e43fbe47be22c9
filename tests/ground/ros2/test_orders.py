"""A vehicle flown by other people's service clients, as a script for MAVROS does."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import zenoh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ground.ros2 import attachment, graph
from ground.ros2.types import LARGEST, known
from tests.ground.ros2.conftest import Fleet, Peer, first
from tests.waiting import wait_until
from zmav import wire
from zmav.session import SessionSettings, open_session
from zmav.sim import VehicleSpec

QUAD = VehicleSpec(params={"DISARM_DELAY": 0.0, "LAND_SPEED": 150.0})
BOOL, TOL = "mavros_msgs/srv/CommandBool", "mavros_msgs/srv/CommandTOL"
MODE, TRIGGER = "mavros_msgs/srv/SetMode", "std_srvs/srv/Trigger"
GID = b"0123456789abcdef"


@pytest.fixture(scope="module")
def fleet() -> Iterator[Fleet]:
    with Fleet(["quad1"], [QUAD], speed=4.0, may_order=True) as fleet:
        yield fleet


def state(fleet: Fleet) -> wire.VehicleState:
    found = fleet.z.vehicle("quad1").last_state
    assert found is not None
    return found


def place(**fields: Any) -> dict[str, Any]:
    """A GoTo's fields for the SDK, which has no defaults."""
    point = known().make("geometry_msgs/msg/Point", **fields)
    return {
        "global_frame": False,
        "position": point,
        "latitude": 0.0,
        "longitude": 0.0,
        "altitude": 0.0,
        "speed": 0.0,
    }


TOL_FIELDS = {"min_pitch": 0.0, "yaw": 0.0, "latitude": 0.0, "longitude": 0.0}


def test_services_are_in_the_graph(fleet: Fleet, peer: Peer) -> None:
    wait_until(lambda: "/quad1/param/get_parameters" in peer.services())
    found = peer.services()
    assert found["/quad1/cmd/arming"] == [BOOL]
    assert found["/quad1/param/get_parameters"] == ["rcl_interfaces/srv/GetParameters"]


def test_a_flight_by_services(fleet: Fleet, peer: Peer) -> None:
    logs, _ = peer.subscribe("/rosout", "rcl_interfaces/msg/Log")
    takeoff = peer.client("/quad1/cmd/takeoff", TOL)
    refused = takeoff.call(**TOL_FIELDS, altitude=6.0)
    assert (refused.success, refused.result) == (False, 4), "it is disarmed"
    wait_until(lambda: any("cmd/takeoff refused" in log.msg for log in logs), lambda: [log.msg for log in logs])

    assert peer.client("/quad1/set_mode", MODE).call(base_mode=0, custom_mode="guided").mode_sent
    assert peer.client("/quad1/cmd/arming", BOOL).call(value=True).success
    wait_until(lambda: state(fleet).armed)
    assert takeoff.call(**TOL_FIELDS, altitude=6.0).success
    wait_until(lambda: (p := state(fleet).position) is not None and p.alt_rel > 5.5)

    local = fleet.z.vehicle("quad1").local
    goto = peer.client("/quad1/goto", "zmav_msgs/srv/GoTo")
    north, east, down = local
    answer = goto.call(**place(x=east + 8.0, y=north, z=-down))
    assert answer.success, answer.message
    wait_until(lambda: fleet.z.vehicle("quad1").local[1] > east + 7.0, lambda: fleet.z.vehicle("quad1").local)

    disarm = peer.client("/quad1/cmd/arming", BOOL).call(value=False)
    assert not disarm.success, "it flies"
    held = peer.client("/quad1/hold", TRIGGER).call(structure_needs_at_least_one_member=0)
    assert held.success, held.message
    assert peer.client("/quad1/land", TRIGGER).call(structure_needs_at_least_one_member=0).success
    wait_until(lambda: state(fleet).armed is False)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"x": 0.0, "y": 0.0, "z": float("nan")}, "position.z is nan"),
        ({"x": 1e6, "y": 0.0, "z": 5.0}, ""),
        ({"x": 0.0, "y": 0.0, "z": -500.0}, ""),
    ],
)
def test_nonsense_is_refused_with_its_reason(fleet: Fleet, peer: Peer, fields: dict[str, Any], words: str) -> None:
    answer = peer.client("/quad1/goto", "zmav_msgs/srv/GoTo").call(**place(**fields))
    assert not answer.success
    assert answer.message
    assert words in answer.message


def test_what_only_mavros_would_take_is_refused(fleet: Fleet, peer: Peer) -> None:
    takeoff = peer.client("/quad1/cmd/takeoff", TOL)
    answer = takeoff.call(**(TOL_FIELDS | {"latitude": 50.0}), altitude=6.0)
    assert (answer.success, answer.result) == (False, 2)
    mode = peer.client("/quad1/set_mode", MODE)
    assert not mode.call(base_mode=216, custom_mode="").mode_sent
    assert not mode.call(base_mode=0, custom_mode="NO_SUCH_MODE").mode_sent


def value(**fields: Any) -> Any:
    return known().make("rcl_interfaces/msg/ParameterValue", **fields)


def parameter(name: str, **fields: Any) -> Any:
    return known().make("rcl_interfaces/msg/Parameter", name=name, value=value(**fields))


def test_parameters_are_read_set_and_described(fleet: Fleet, peer: Peer) -> None:
    get = peer.client("/quad1/param/get_parameters", "rcl_interfaces/srv/GetParameters")
    found = get.call(names=["DISARM_DELAY", "NO_SUCH"]).values
    assert [each.type for each in found] in ([2, 0], [3, 0])
    set_ = peer.client("/quad1/param/set_parameters", "rcl_interfaces/srv/SetParameters")
    given_ = [
        parameter("RTL_ALT", type=2, integer_value=1800),
        parameter("NO_SUCH", type=3, double_value=1.0),
        parameter("RTL_ALT", type=4, string_value="high"),
        parameter("RTL_ALT", type=3, double_value=float("nan")),
    ]
    results = set_.call(parameters=given_).results
    assert [each.successful for each in results] == [True, False, False, False]
    assert "NO_SUCH" in results[1].reason
    assert "integer or a double" in results[2].reason
    assert "RTL_ALT is nan" in results[3].reason
    (now,) = get.call(names=["RTL_ALT"]).values
    assert max(now.integer_value, now.double_value) == 1800
    listed = peer.client("/quad1/param/list_parameters", "rcl_interfaces/srv/ListParameters").call(prefixes=[], depth=0)
    assert {"RTL_ALT", "DISARM_DELAY"} <= set(listed.result.names)
    kinds = peer.client("/quad1/param/get_parameter_types", "rcl_interfaces/srv/GetParameterTypes")
    assert list(kinds.call(names=["RTL_ALT", "NO_SUCH"]).types) == [now.type, 0]
    atomically = peer.client("/quad1/param/set_parameters_atomically", "rcl_interfaces/srv/SetParametersAtomically")
    assert atomically.call(parameters=given_[:1]).result.successful
    assert "one parameter at a time" in atomically.call(parameters=given_).result.reason
    described = peer.client("/quad1/param/describe_parameters", "rcl_interfaces/srv/DescribeParameters")
    (descriptor,) = described.call(names=["RTL_ALT"]).descriptors
    assert (descriptor.name, descriptor.type) == ("RTL_ALT", now.type)


def test_parameters_as_mavros_has_them_besides(fleet: Fleet, peer: Peer) -> None:
    pulled = peer.client("/quad1/param/pull", "mavros_msgs/srv/ParamPull").call(force_pull=False)
    assert pulled.success
    assert pulled.param_received > 10
    set_ = peer.client("/quad1/param/set", "mavros_msgs/srv/ParamSetV2")
    done = set_.call(force_set=False, param_id="RTL_ALT", value=value(type=2, integer_value=1700))
    assert done.success
    assert max(done.value.integer_value, done.value.double_value) == 1700
    assert not set_.call(force_set=False, param_id="NO_SUCH", value=value(type=2)).success


def test_a_lease_goes_to_the_higher_priority_and_keeps_others_out(fleet: Fleet, peer: Peer) -> None:
    async def another() -> str:
        async with fleet.z.vehicle("quad1").lease("planner", priority=5):
            held = fleet.z.vehicle("quad1")
            await held.wait_until(lambda s: s.lease is not None, 10.0)
            low = await fleet.loop.run_in_executor(None, lambda: lease.call(take=True, priority=5))
            high = await fleet.loop.run_in_executor(None, lambda: lease.call(take=True, priority=50))
            assert not low.success
            assert high.success, high.message
            return str(low.message)

    lease = peer.client("/quad1/lease", "zmav_msgs/srv/Lease")
    assert "planner" in fleet.run(another())
    steering = fleet.face.vehicles["quad1"].steering
    assert steering.holder is not None
    assert not lease.call(take=True, priority=200).success
    assert lease.call(take=False, priority=0).success
    assert steering.holder is None
    answer = lease.call(take=False, priority=0)
    assert not answer.success
    assert "does not hold" in answer.message


@pytest.fixture(scope="module")
def raw(fleet: Fleet) -> Iterator[zenoh.Session]:
    with open_session(SessionSettings(connect=[f"tcp/127.0.0.1:{fleet.port}"])) as session:
        yield session


def ask(raw: zenoh.Session, key: str, payload: bytes, said: bytes | None) -> list[zenoh.Reply]:
    found: list[zenoh.Reply] = []
    over = threading.Event()
    handler = zenoh.handlers.Callback(found.append, over.set)
    raw.get(key, handler, payload=payload, attachment=said, target=zenoh.QueryTarget.ALL_COMPLETE, timeout=30.0)
    assert over.wait(40.0)
    return found


def key_of(name: str, kind: str) -> str:
    return f"0/quad1/{name}/{graph.dds_of(kind)}/{known().hash(kind)}"


def test_any_request_is_answered_or_refused(fleet: Fleet, raw: zenoh.Session, peer: Peer) -> None:
    """Bytes of every kind, and the service goes on: a lease and a list, which move nothing."""
    wait: Callable[..., Any] = attachment.write
    good = known().encode(known().make(f"{TRIGGER}_Request"), f"{TRIGGER}_Request")
    key = key_of("param/list_parameters", "rcl_interfaces/srv/ListParameters")
    (reply,) = ask(raw, key, good, None)
    assert reply.err is not None
    assert "an attachment has 33 bytes" in str(wire.error_from(reply.err.payload.to_bytes()))

    @settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
    @given(st.binary(max_size=80), st.binary(max_size=80) | st.none() | st.just(wait(1, GID)))
    def spoil(payload: bytes, said: bytes | None) -> None:
        (reply,) = ask(raw, key, payload, said)
        assert (reply.ok is None) != (reply.err is None)

    spoil()
    assert fleet.face.ros.bad > 0
    right = known().encode(
        known().make("rcl_interfaces/srv/ListParameters_Request"), "rcl_interfaces/srv/ListParameters_Request"
    )
    (reply,) = ask(raw, key, right, wait(77, GID))
    assert reply.ok is not None
    assert reply.ok.attachment is not None
    answered = attachment.read(reply.ok.attachment.to_bytes())
    assert (answered.sequence, answered.gid) == (77, GID)


def test_what_is_too_large_is_not_kept(fleet: Fleet, raw: zenoh.Session) -> None:
    before, large = fleet.face.ros.bad, bytes(LARGEST + 1)
    assert ask(raw, key_of("hold", TRIGGER), large, attachment.write(1, GID)) == []
    pose = key_of("setpoint_position/local", "geometry_msgs/msg/PoseStamped")
    raw.put(pose, large, attachment=attachment.write(1, GID))
    wait_until(lambda: fleet.face.ros.bad == before + 2)


def test_a_read_only_face_gives_no_orders(fleet: Fleet, peer: Peer) -> None:
    with Fleet(["quad1"], [QUAD], speed=4.0, may_order=False) as reading:
        other = Peer(reading.port)
        peer.close()  # the SDK has one session in a process
        try:
            answer = other.client("/quad1/hold", TRIGGER).call(structure_needs_at_least_one_member=0)
            assert not answer.success
            assert "without --orders" in answer.message
            assert not other.client("/quad1/cmd/arming", BOOL).call(value=True).success
            assert state(reading).armed is False
            lease = other.client("/quad1/lease", "zmav_msgs/srv/Lease").call(take=True, priority=1)
            assert "without --orders" in lease.message
            set_ = other.client("/quad1/param/set_parameters", "rcl_interfaces/srv/SetParameters")
            (result,) = set_.call(parameters=[parameter("RTL_ALT", type=2, integer_value=1)]).results
            assert "without --orders" in result.reason
            pull = other.client("/quad1/param/pull", "mavros_msgs/srv/ParamPull")
            assert pull.call(force_pull=False).success, "the cache is read"
            assert not pull.call(force_pull=True).success, "the autopilot is asked for nothing"
            logs, _ = other.subscribe("/rosout", "rcl_interfaces/msg/Log", qos=":1:,10:,:,:,,")
            assert first(logs).name == "quad1.zmav"
        finally:
            other.close()
