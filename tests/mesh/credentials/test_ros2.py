"""A domain of ROS 2 at a router's door: by role, and none where the fleet file names none."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import pytest
import zenoh

from tests.mesh.credentials.test_acl import MEMBERS, reached
from zmav.config import FleetConfig
from zmav.config.fleet import Ros2
from zmav.trust.certificate import Role

if TYPE_CHECKING:
    from tests.mesh.credentials.conftest import Door, Fleet

SETPOINT = "0/quad1/setpoint_position/local/geometry_msgs::msg::dds_::PoseStamped_/RIHS01_ab"
SERVICE = "0/quad1/hold/std_srvs::srv::dds_::Trigger_/RIHS01_cd"
TOPIC = "0/quad1/imu/data/sensor_msgs::msg::dds_::Imu_/RIHS01_ef"
END = "zmav/alpha/ops/msg/END"
BLOCK = zenoh.CongestionControl.BLOCK
PATIENCE_S = 30.0


class Face:
    """What ``zmav ros2`` has on the router's own host: a topic, a service, and a subscriber of setpoints."""

    def __init__(self, session: zenoh.Session) -> None:
        self.session, self.came, self.asked = session, set[str](), set[str]()
        self._tokens: set[str] = set()
        self._news = threading.Condition()
        session.declare_subscriber("0/**", lambda sample: self._add(self.came, sample))
        session.liveliness().declare_subscriber("@ros2_lv/0/**", lambda sample: self._add(self._tokens, sample))
        session.declare_queryable(SERVICE, self._answer, complete=True)
        session.declare_queryable(END, self._answer)
        session.declare_subscriber(END, lambda sample: None)

    def _add(self, where: set[str], sample: zenoh.Sample) -> None:
        with self._news:
            where.add(str(sample.key_expr))
            self._news.notify_all()

    def _answer(self, query: zenoh.Query) -> None:
        with query:
            self.asked.add(str(query.key_expr))
            query.reply(query.key_expr, b"done")

    def until_token(self, token: str) -> set[str]:
        """All tokens that came so far, once that one did."""
        with self._news:
            assert self._news.wait_for(lambda: token in self._tokens, PATIENCE_S), self._tokens
            return set(self._tokens)


def tried(program: zenoh.Session, face: Face, publishes: bool) -> tuple[set[str], bool, bool]:
    """What a node's setpoints, its question and its subscription come to: put, answered, heard. ``publishes``: wait for
    its publisher's token, which may come after a later one.
    """
    node = f"@ros2_lv/0/{program.info.zid()}/0"
    first = f"{node}/1/MP/%/%/spy/%quad1/t::msg::dds_::T_/RIHS01_0/::,1:,:,:,,"
    tokens = [program.liveliness().declare_token(first)]
    heard = threading.Event()
    program.declare_subscriber(TOPIC, lambda sample: heard.set())
    reached(program, END)
    program.put(SETPOINT, b"", congestion_control=BLOCK)
    replies = list(program.get(SERVICE, target=zenoh.QueryTarget.ALL_COMPLETE, timeout=5.0))
    list(program.get(END, timeout=PATIENCE_S))
    last = f"{node}/2/MS/%/%/spy/%quad1%imu%data/t::msg::dds_::T_/RIHS01_0/::,1:,:,:,,"
    tokens.append(program.liveliness().declare_token(last))
    seen = face.until_token(last)
    if publishes:
        seen = face.until_token(first)
    for _ in range(100):
        face.session.put(TOPIC, b"", congestion_control=BLOCK)
        if heard.wait(0.1):
            break
    published = {each for each in seen if "/MP/" in each and str(program.info.zid()) in each}
    for token in tokens:
        token.undeclare()
    return published | (face.came & {SETPOINT}), any(reply.ok for reply in replies), heard.is_set()


def opened(fleet: Fleet, domain: int | None) -> tuple[Door, Face]:
    fleet.issue(quad1=Role.VEHICLE, **MEMBERS)
    door = fleet.router("ops", file=FleetConfig(fleet="alpha", ros2=Ros2(domain=domain)))
    return door, Face(fleet.open(None, door.unix))


def member_of(role: Role) -> str:
    return next(name for name, each in MEMBERS.items() if each is role and name != "ops")


@pytest.mark.parametrize("way", ["unix", "local"])
def test_programs_of_the_host_speak_ros(fleet: Fleet, way: str) -> None:
    door, face = opened(fleet, 0)
    put, answered, heard = tried(fleet.open(None, getattr(door, way)), face, True)
    assert SETPOINT in put
    assert len(put) == 2, "its publisher is in the graph"
    assert answered
    assert heard


def test_a_viewer_hears_and_neither_publishes_nor_asks(fleet: Fleet) -> None:
    door, face = opened(fleet, 0)
    put, answered, heard = tried(fleet.open(member_of(Role.VIEWER), door.tls), face, False)
    assert put == set()
    assert not answered
    assert SERVICE not in face.asked
    assert heard, "and is shown as a subscriber: telemetry flows for it"


def test_a_planner_publishes_and_asks(fleet: Fleet) -> None:
    door, face = opened(fleet, 0)
    put, answered, heard = tried(fleet.open(member_of(Role.PLANNER), door.tls), face, True)
    assert len(put) == 2
    assert answered
    assert heard


def test_no_ros_passes_where_the_file_names_no_domain(fleet: Fleet) -> None:
    door, face = opened(fleet, None)
    program = fleet.open(member_of(Role.PLANNER), door.tls)
    reached(program, END)
    program.put(SETPOINT, b"", congestion_control=BLOCK)
    assert not list(program.get(SERVICE, target=zenoh.QueryTarget.ALL_COMPLETE, timeout=3.0))
    list(program.get(END, timeout=PATIENCE_S))
    assert face.came == set()
    assert face.asked <= {END}


def test_another_domain_does_not_pass(fleet: Fleet) -> None:
    door, face = opened(fleet, 7)
    program = fleet.open(member_of(Role.PLANNER), door.tls)
    reached(program, END)
    program.put(SETPOINT, b"", congestion_control=BLOCK)
    list(program.get(END, timeout=PATIENCE_S))
    assert face.came == set()
