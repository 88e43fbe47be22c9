"""Long orders as actions: what rclpy's action client does on the wire, done with other people's service clients."""

from __future__ import annotations

import asyncio
import os
import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import zenoh

from ground.ros2 import attachment, graph
from ground.ros2.actions import ABORTED, CANCELED, SUCCEEDED, TERMINATED, UNKNOWN_GOAL, Action
from ground.ros2.types import known
from tests.ground.ros2.conftest import Fleet, Peer
from tests.waiting import wait_until
from zmav import wire
from zmav.session import SessionSettings, open_session
from zmav.sim import VehicleSpec

QUAD = VehicleSpec(params={"DISARM_DELAY": 0.0, "LAND_SPEED": 150.0})
CANCEL = "action_msgs/srv/CancelGoal"
LINE = "\n" + "=" * 80 + "\nMSG: "
FEEDBACK = LINE.join(
    (
        "unique_identifier_msgs/UUID goal_id\nzmav_msgs/Takeoff_Feedback feedback",
        "unique_identifier_msgs/UUID\nuint8[16] uuid",
        "zmav_msgs/Takeoff_Feedback\nfloat32 altitude\n",
    )
)
"""rosbags writes the definitions of messages only"""


@pytest.fixture(scope="module")
def fleet() -> Iterator[Fleet]:
    with Fleet(["quad1"], [QUAD], speed=4.0, may_order=True) as fleet:
        yield fleet


@pytest.fixture(scope="module")
def client(fleet: Fleet) -> Iterator[Client]:
    with open_session(SessionSettings(connect=[f"tcp/127.0.0.1:{fleet.port}"])) as session:
        yield Client(session)


class Client:
    """An action client, as rcl_action has it: services and topics below ``_action``."""

    def __init__(self, session: zenoh.Session, base: str = "quad1") -> None:
        self.session, self._base, self._gid, self._sequence = session, base, os.urandom(16), 0
        self.accepted: Any = None

    def call(self, name: str, kind: str, /, **fields: Any) -> Any:
        types = known()
        request = types.encode(types.make(f"{kind}_Request", **fields), f"{kind}_Request")
        key = f"0/{self._base}/{name}/{graph.dds_of(kind)}/{types.hash(kind)}"
        found: list[zenoh.Reply] = []
        over = threading.Event()
        self._sequence += 1
        self.session.get(
            key,
            zenoh.handlers.Callback(found.append, over.set),
            payload=request,
            attachment=attachment.write(self._sequence, self._gid),
            target=zenoh.QueryTarget.ALL_COMPLETE,
            timeout=60.0,
        )
        assert over.wait(60.0)
        assert found and found[0].ok is not None, [each.err and each.err.payload.to_string() for each in found]
        return types.decode(found[0].ok.payload.to_bytes(), f"{kind}_Response")

    def send(self, action: str, kind: str, name: bytes, **goal: Any) -> bool:
        full = f"zmav_msgs/action/{kind}"
        made = known().make(f"{full}_Goal", **goal)
        answer = self.call(f"{action}/_action/send_goal", f"{full}_SendGoal", goal_id=uuid(name), goal=made)
        self.accepted = answer.stamp
        return bool(answer.accepted)

    def result(self, action: str, kind: str, name: bytes) -> tuple[int, Any]:
        full = f"zmav_msgs/action/{kind}"
        answer = self.call(f"{action}/_action/get_result", f"{full}_GetResult", goal_id=uuid(name))
        return answer.status, answer.result

    def cancel(self, action: str, name: bytes, **stamp: Any) -> Any:
        info = known().make("action_msgs/msg/GoalInfo", goal_id=uuid(name), **stamp)
        return self.call(f"{action}/_action/cancel_goal", CANCEL, goal_info=info)


def uuid(name: bytes) -> Any:
    return known().make("unique_identifier_msgs/msg/UUID", uuid=np.frombuffer(name, dtype=np.uint8))


def state(fleet: Fleet) -> wire.VehicleState:
    found = fleet.z.vehicle("quad1").last_state
    assert found is not None
    return found


def point(at: wire.Vector) -> Any:
    return known().make("geometry_msgs/msg/Point", x=at[1], y=at[0], z=-at[2])


def arm(fleet: Fleet) -> None:
    async def armed() -> None:
        await fleet.z.vehicle("quad1").arm()

    fleet.run(armed())


def test_a_flight_by_actions_with_feedback_and_a_cancel(fleet: Fleet, client: Client, peer: Peer) -> None:
    kind = "zmav_msgs/action/Takeoff_FeedbackMessage"
    feedback, _ = peer.subscribe("/quad1/takeoff/_action/feedback", kind, definition=FEEDBACK)
    one = os.urandom(16)
    assert client.send("takeoff", "Takeoff", one, altitude=6.0)
    status, result = client.result("takeoff", "Takeoff", one)
    assert (status, result.success) == (ABORTED, False)
    assert "armed" in result.message

    arm(fleet)
    two = os.urandom(16)
    assert client.send("takeoff", "Takeoff", two, altitude=6.0)
    assert not client.send("takeoff", "Takeoff", two, altitude=9.0), "a goal is sent once"
    status, result = client.result("takeoff", "Takeoff", two)
    assert (status, result.success) == (SUCCEEDED, True)
    heights = [each.feedback.altitude for each in feedback if bytes(each.goal_id.uuid) == two]
    assert heights, "no feedback"

    north, east, down = fleet.z.vehicle("quad1").local
    far = os.urandom(16)
    assert client.send("goto", "GoTo", far, position=point((north + 60.0, east, down)))
    wait_until(lambda: fleet.z.vehicle("quad1").local[0] > north + 3.0)
    cancelled = client.cancel("goto", far)
    assert cancelled.return_code == 0
    assert [bytes(info.goal_id.uuid) for info in cancelled.goals_canceling] == [far]
    assert client.result("goto", "GoTo", far)[0] == CANCELED
    wait_until(lambda: abs(speed(fleet)) < 0.3)
    assert fleet.z.vehicle("quad1").local[0] < north + 50.0
    assert client.cancel("goto", far).return_code == TERMINATED
    assert client.cancel("goto", os.urandom(16)).return_code == UNKNOWN_GOAL
    again = os.urandom(16)
    assert client.send("goto", "GoTo", again, position=point((north + 60.0, east, down)))
    cancelled = client.cancel("goto", bytes(16), stamp=client.accepted)
    assert [bytes(info.goal_id.uuid) for info in cancelled.goals_canceling] == [again], "accepted by then"
    assert cancelled.goals_canceling[0].stamp == client.accepted
    assert client.result("goto", "GoTo", again)[0] == CANCELED

    theirs = os.urandom(16)
    assert client.send("goto", "GoTo", theirs, position=point((north + 60.0, east, down)))
    info = known().make("action_msgs/msg/GoalInfo", goal_id=uuid(theirs))
    cancelled = peer.client("/quad1/goto/_action/cancel_goal", CANCEL).call(goal_info=info)
    assert [bytes(each.goal_id.uuid) for each in cancelled.goals_canceling] == [theirs], "asked by others' client"
    assert client.result("goto", "GoTo", theirs)[0] == CANCELED

    down_ = os.urandom(16)
    assert client.send("land", "Land", down_, return_first=False)
    assert client.result("land", "Land", down_)[0] == SUCCEEDED
    assert state(fleet).armed is False


def speed(fleet: Fleet) -> float:
    velocity = state(fleet).velocity
    assert velocity is not None
    return float(np.linalg.norm(velocity))


def test_a_cancel_holds_however_soon_it_comes(fleet: Fleet, client: Client) -> None:
    """It overtook the order now and then, which ended the hold: the vehicle flew on, its goal no longer cancelled."""
    arm(fleet)
    up = os.urandom(16)
    assert client.send("takeoff", "Takeoff", up, altitude=6.0)
    assert client.result("takeoff", "Takeoff", up)[0] == SUCCEEDED
    north, east, down = fleet.z.vehicle("quad1").local
    for turn in range(30):
        name, way = os.urandom(16), 60.0 if turn % 2 else -60.0
        assert client.send("goto", "GoTo", name, position=point((north + way, east, down)))
        cancelled = client.cancel("goto", bytes(16), stamp=client.accepted)
        assert [bytes(info.goal_id.uuid) for info in cancelled.goals_canceling] == [name], cancelled
        assert client.result("goto", "GoTo", name)[0] == CANCELED
    wait_until(lambda: abs(speed(fleet)) < 0.3)
    land = os.urandom(16)
    assert client.send("land", "Land", land, return_first=False)
    assert client.result("land", "Land", land)[0] == SUCCEEDED


def test_a_goal_that_is_nonsense_is_not_accepted(fleet: Fleet, client: Client) -> None:
    assert not client.send("goto", "GoTo", os.urandom(16), position=point((float("nan"), 0.0, 0.0)))
    assert not client.send("takeoff", "Takeoff", os.urandom(16), altitude=float("inf"))


def test_a_goal_that_nobody_sent_has_no_result(fleet: Fleet, client: Client) -> None:
    assert client.result("goto", "GoTo", os.urandom(16))[0] == 0


class Node:
    """As much of a node as an action needs; it tells nobody."""

    def __init__(self) -> None:
        self.ros = SimpleNamespace(types=known())
        self.served: dict[str, Callable[[Any, bytes], Awaitable[Any]]] = {}

    def serve(self, name: str, kind: str, answer: Callable[[Any, bytes], Awaitable[Any]]) -> None:
        self.served[name.rpartition("/")[2]] = answer

    def publish(self, *_: Any) -> Callable[[Any], None]:
        return lambda message: None


class Done:
    """Work that is done when it is said to be."""

    def __init__(self) -> None:
        self.done: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()

    async def run(self, feedback: Any) -> dict[str, Any]:
        return await self.done

    async def stop(self, gid: bytes) -> None:
        raise AssertionError("it has ended")


async def test_a_cancel_that_comes_as_the_goal_ends_leaves_it_as_it_ended() -> None:
    """It was being cancelled for ever, and took one of the action's places."""
    node, work, types = Node(), Done(), known()
    action = Action(cast("Any", node), "land", "zmav_msgs/action/Land", lambda goal, gid: work, lambda text: None)
    sent = types.make("zmav_msgs/action/Land_SendGoal_Request", goal_id=uuid(bytes(range(16))))
    assert (await node.served["send_goal"](sent, b"")).accepted
    await asyncio.sleep(0)
    work.done.set_result({})
    answer = await node.served["cancel_goal"](types.make(f"{CANCEL}_Request"), b"")
    assert list(answer.goals_canceling) == []
    asked = types.make("zmav_msgs/action/Land_GetResult_Request", goal_id=uuid(bytes(range(16))))
    assert (await node.served["get_result"](asked, b"")).status == SUCCEEDED
    await action.close()


def test_a_later_order_aborts_a_goal(fleet: Fleet, client: Client) -> None:
    arm(fleet)
    up = os.urandom(16)
    assert client.send("takeoff", "Takeoff", up, altitude=20.0)
    wait_until(lambda: (p := state(fleet).position) is not None and p.alt_rel > 1.0)

    async def land() -> None:
        await fleet.z.vehicle("quad1").land()

    landing = asyncio.run_coroutine_threadsafe(land(), fleet.loop)
    status, result = client.result("takeoff", "Takeoff", up)
    assert status == ABORTED
    assert result.message
    landing.result(60.0)


def test_status_is_latched_and_old_goals_give_way(fleet: Fleet, client: Client) -> None:
    """As rmw_zenoh subscribes to what is transient local: the SDK finds no publisher of a topic in a namespace."""
    for _ in range(20):
        client.send("takeoff", "Takeoff", os.urandom(16), altitude=5.0)
        time.sleep(0.02)
    kind = "action_msgs/msg/GoalStatusArray"
    key = f"0/quad1/takeoff/_action/status/{graph.dds_of(kind)}/{known().hash(kind)}"
    with open_session(SessionSettings(connect=[f"tcp/127.0.0.1:{fleet.port}"])) as late:
        came: list[zenoh.Sample] = []
        history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
        zenoh.ext.declare_advanced_subscriber(late, key, came.append, history=history)
        wait_until(lambda: came)
        assert 1 <= len(known().decode(came[-1].payload.to_bytes(), kind).status_list) <= 16
