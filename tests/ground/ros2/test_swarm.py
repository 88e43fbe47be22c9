"""The swarm's goals as actions and services, its book, plans and obstacles as topics: asked as ROS asks, planned by the
planner, flown by two simulated copters.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import threading
import time
from collections.abc import AsyncIterator, Iterator
from typing import Any

import pytest
import zenoh

import zmav
from agents.planner.live.agent import Agent
from agents.planner.live.settings import PlannerSettings
from ground.ros2 import goals, obstacles
from ground.ros2.actions import ABORTED, CANCELED, SUCCEEDED
from ground.ros2.goals import KINDS
from ground.ros2.types import INTERFACES, known
from tests.ground.ros2.conftest import PATIENCE_S, Fleet, Peer
from tests.ground.ros2.test_actions import LINE, Client
from tests.waiting import wait_until
from zmav import keys, wire
from zmav.errors import BadInput, BadKey
from zmav.session import SessionSettings, open_session
from zmav.sim import VehicleSpec
from zmav.wire import swarm

BASE, SET = "demo/swarm", "zmav_msgs/srv/SetObstacles"
BOTH = ["quad_1", "quad2"]
LATCHED = ":1:,1:,:,:,,"
FEEDBACK = LINE.join(
    (
        "unique_identifier_msgs/UUID goal_id\nzmav_msgs/SwarmGoTo_Feedback feedback",
        "unique_identifier_msgs/UUID\nuint8[16] uuid",
        "zmav_msgs/SwarmGoTo_Feedback\nstring state\nfloat32 progress\nstring text\n"
        "float32 makespan\nfloat32 clearance",
    )
)


@contextlib.asynccontextmanager
async def planner(endpoint: str) -> AsyncIterator[None]:
    async with zmav.open(connect=[endpoint]) as z, Agent(z, PlannerSettings(name="ground", patience=1.0)) as agent:
        await agent.context.solver.until_ready(PATIENCE_S)
        yield


@pytest.fixture(scope="module")
def fleet() -> Iterator[Fleet]:
    quick = {"DISARM_DELAY": 0.0, "LAND_SPEED": 150.0}  # cm/s
    specs = [VehicleSpec(params=quick, start_ned_m=(8.0 * n, 0.0, 0.0), sysid=n + 1) for n in range(2)]
    with Fleet(["quad-1", "quad2"], specs, speed=1.0, may_order=True, beside=planner) as fleet:
        yield fleet


@pytest.fixture(scope="module")
def client(fleet: Fleet) -> Iterator[Client]:
    with open_session(SessionSettings(connect=[f"tcp/127.0.0.1:{fleet.port}"])) as session:
        yield Client(session, BASE)


@pytest.fixture
def up(fleet: Fleet, client: Client) -> None:
    """Both are in the air, brought there by the swarm's own goal."""
    states = [fleet.z.vehicle(name).last_state for name in fleet.names]
    if not all(s is not None and s.armed for s in states):
        name = os.urandom(16)
        assert client.send("takeoff", "SwarmTakeoff", name, vehicles=BOTH, height=6.0)
        status, result = client.result("takeoff", "SwarmTakeoff", name)
        assert (status, result.success) == (SUCCEEDED, True), result
        assert re.fullmatch(r"g\d+-\d+", result.goal)


def point(x: float, y: float, z: float = 0.0) -> Any:
    """East, north, up."""
    return known().make("geometry_msgs/msg/Point", x=x, y=y, z=z)


def ask(client: Client, name: str, kind: str, **fields: Any) -> Any:
    return client.call(name, f"zmav_msgs/srv/{kind}", **fields)


def together(client: Client, name: str) -> Any:
    return client.call(name, "std_srvs/srv/Trigger")


def still(fleet: Fleet) -> bool:
    states = [fleet.z.vehicle(name).last_state for name in fleet.names]
    return all(s is not None and s.velocity is not None and math.hypot(*s.velocity) < 0.3 for s in states)


def test_goals_of_a_swarm_are_actions_with_feedback_and_cancel(
    fleet: Fleet, client: Client, peer: Peer, up: None
) -> None:
    books, _ = peer.subscribe("/demo/swarm/goals", "zmav_msgs/msg/SwarmGoals", qos=LATCHED)
    plans, _ = peer.subscribe("/demo/swarm/plans", "zmav_msgs/msg/SwarmPlan", qos=LATCHED)
    kind = "zmav_msgs/action/SwarmGoTo_FeedbackMessage"
    told, _ = peer.subscribe("/demo/swarm/goto/_action/feedback", kind, definition=FEEDBACK)
    wait_until(lambda: still(fleet))
    far = os.urandom(16)
    assert client.send("goto", "SwarmGoTo", far, vehicles=BOTH, to=[point(60.0, 0.0, 8.0), point(60.0, 8.0, 8.0)])
    wait_until(lambda: (s := fleet.z.vehicle("quad2").last_state) and s.local and s.local[1] > 3.0)
    wait_until(lambda: any(each.feedback.state == "flying" and each.feedback.makespan > 5.0 for each in told))
    assert all(bytes(each.goal_id.uuid) == far for each in told)
    wait_until(lambda: plans and list(plans[-1].vehicles) == BOTH)
    for path, north in zip(plans[-1].paths, (0.0, 8.0), strict=True):
        end = path.poses[-1].pose.position
        assert (end.x, end.y, end.z) == pytest.approx((60.0, north, 8.0), abs=0.1)
    assert plans[-1].header.frame_id == "demo"
    cancelled = client.cancel("goto", far)
    assert [bytes(info.goal_id.uuid) for info in cancelled.goals_canceling] == [far]
    status, result = client.result("goto", "SwarmGoTo", far)
    assert (status, result.success) == (CANCELED, False)
    assert "cancelled" in result.message
    wait_until(lambda: still(fleet))
    assert fleet.z.vehicle("quad2").local[1] < 50.0
    wait_until(lambda: books and books[-1].goals[-1].state == "cancelled")
    entry = books[-1].goals[-1]
    assert (entry.kind, list(entry.vehicles), books[-1].planner) == ("goto", BOTH, "ground")


def test_a_goal_that_the_planner_refuses_is_aborted_with_its_reason(client: Client) -> None:
    name = os.urandom(16)
    assert client.send("hold", "SwarmHold", name, vehicles=["nobody"])
    status, result = client.result("hold", "SwarmHold", name)
    assert status == ABORTED
    assert "no vehicle nobody is known" in result.message
    assert not client.send("takeoff", "SwarmTakeoff", os.urandom(16), vehicles=BOTH, height=math.nan), "nonsense"


def test_goals_as_services_and_orders_about_them(fleet: Fleet, client: Client, peer: Peer, up: None) -> None:
    books, _ = peer.subscribe("/demo/swarm/goals", "zmav_msgs/msg/SwarmGoals", qos=LATCHED)
    given = ask(client, "formation", "SwarmFormation", vehicles=BOTH, shape="line", at=point(40.0, 4.0, 9.0))
    assert given.success, given.message
    wait_until(lambda: books and books[-1].goals and books[-1].goals[-1].goal == given.goal)
    paused = ask(client, "pause", "SwarmGoal", goal=given.goal)
    assert (paused.success, paused.message) == (True, given.goal)
    wait_until(lambda: books[-1].goals[-1].state == "paused")
    assert ask(client, "resume", "SwarmGoal", goal=given.goal).success
    wait_until(lambda: books[-1].goals[-1].state != "paused")
    nameless = ask(client, "cancel", "SwarmGoal")
    assert not nameless.success
    assert "cancel needs a goal's id" in nameless.message
    assert ask(client, "cancel", "SwarmGoal", goal=given.goal).success
    wait_until(lambda: books[-1].goals[-1].state == "cancelled")
    refused = ask(client, "formation", "SwarmFormation", vehicles=BOTH, shape="blob")
    assert not refused.success
    assert "shape" in refused.message


def test_obstacles_are_seen_and_added(client: Client, peer: Peer) -> None:
    seen, _ = peer.subscribe("/demo/swarm/obstacles", "zmav_msgs/msg/Obstacles", qos=LATCHED)
    kind = "zmav_msgs/msg/Obstacle"
    tower = known().make(
        kind, name="tower", shape=obstacles.CYLINDER, center=point(40.0, -30.0), radius=3.0, floor=-5.0, ceiling=60.0
    )
    given = ask(client, "set_obstacles", "SetObstacles", obstacles=[tower])
    assert given.success, given.message
    wait_until(lambda: seen and [each.name for each in seen[-1].obstacles] == ["tower"])
    shown = seen[-1].obstacles[0]
    assert (shown.shape, shown.center.x, shown.center.y, shown.radius) == (obstacles.CYLINDER, 40.0, -30.0, 3.0)
    assert (shown.floor, shown.ceiling, shown.ttl) == (-5.0, 60.0, 0.0)
    moving = known().make(kind, name="bird", shape=obstacles.BALL, center=point(1.0, 2.0, 30.0), radius=1.0, ttl=30.0)
    publisher = peer.publish("/demo/swarm/set_obstacles", "zmav_msgs/msg/Obstacles")
    stamp = known().make("builtin_interfaces/msg/Time")

    def two() -> bool:
        publisher.publish(stamp=stamp, obstacles=[moving])
        return {each.name for each in seen[-1].obstacles} == {"tower", "bird"}

    wait_until(two)
    gone = [known().make(kind, name=name, shape=obstacles.GONE) for name in ("tower", "bird")]
    assert ask(client, "set_obstacles", "SetObstacles", obstacles=gone).success
    wait_until(lambda: not seen[-1].obstacles)
    unnamed = ask(client, "set_obstacles", "SetObstacles", obstacles=[known().make(kind, name="Tower", shape=1)])
    assert not unnamed.success
    assert "cannot stand in a key" in unnamed.message


def test_orders_to_all_need_no_planner(fleet: Fleet, client: Client, up: None) -> None:
    held = together(client, "hold_all")
    assert held.success, held.message
    assert "quad2" in held.message
    landing = together(client, "land_all")
    assert landing.success, landing.message
    for name in fleet.names:
        fleet.run(fleet.z.vehicle(name).wait_until(lambda state: state.armed is False, 60.0))
    assert "disarmed" in together(client, "return_all").message


@contextlib.contextmanager
def alone(*, may_order: bool) -> Iterator[Client]:
    """One vehicle, and no planner."""
    with contextlib.ExitStack() as stack:
        fleet = stack.enter_context(Fleet(["quad1"], [VehicleSpec()], speed=1.0, may_order=may_order))
        where = SessionSettings(connect=[f"tcp/127.0.0.1:{fleet.port}"])
        yield Client(stack.enter_context(open_session(where)), BASE)


@pytest.fixture(scope="module")
def lone() -> Iterator[Client]:
    """It takes orders."""
    with alone(may_order=True) as client:
        yield client


def test_nothing_is_changed_without_orders() -> None:
    with alone(may_order=False) as client:
        assert not client.send("hold", "SwarmHold", os.urandom(16), vehicles=["quad1"])
        for answer in (
            ask(client, "hold", "SwarmHold", vehicles=["quad1"]),
            ask(client, "abort", "SwarmGoal"),
            ask(client, "set_obstacles", "SetObstacles"),
            together(client, "hold_all"),
        ):
            assert not answer.success
            assert "without --orders" in answer.message


def test_where_no_planner_is_in_charge_it_is_said(lone: Client) -> None:
    name = os.urandom(16)
    absent = ask(lone, "hold", "SwarmHold", vehicles=["quad1"])
    assert not absent.success
    assert "no planner is in charge of fleet demo: start one" in absent.message
    assert lone.send("hold", "SwarmHold", name, vehicles=["quad1"])
    status, result = lone.result("hold", "SwarmHold", name)
    assert (status, result.message) == (ABORTED, absent.message)
    assert together(lone, "hold_all").success, "that needs none"


class Chief:
    """A planner that takes any goal, says so in one book, and falls silent."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session, self._over, self.mute = session, threading.Event(), False
        self.goal = swarm.GoalEntry(id="g1-1", goal=swarm.Hold(vehicles=["quad1"]), state="flying", t=1.0, progress=0.5)
        key = keys.SWARM.key("demo", "fake", verb="submit")
        self._queryable = session.declare_queryable(key, self._answer)
        self._beating = threading.Thread(target=self._beat)
        self._beating.start()

    def _beat(self) -> None:
        charge = swarm.Charge(t=1.0, planner="fake", instance="f", term=1)
        while not self._over.wait(0.2):
            self._session.put(keys.FLEET.key("demo", topic="charge"), wire.encode(charge))

    def _answer(self, query: zenoh.Query) -> None:
        if self.mute:
            return
        outcome = wire.Outcome(verb="submit", status="done", took=0.0, result={"goal": "g1-1", "planner": "fake"})
        query.reply(query.key_expr, wire.encode(outcome))
        self.say(self.goal)

    def say(self, *goals: swarm.GoalEntry) -> None:
        book = swarm.Book(t=1.0, planner="fake", instance="f", term=1, goals=list(goals))
        self._session.put(keys.FLEET.key("demo", topic="goal"), wire.encode(book))

    def close(self) -> None:
        self._over.set()
        self._beating.join()
        self._queryable.undeclare()


def test_a_planner_that_falls_silent_or_forgets_a_goal_aborts_it(lone: Client) -> None:
    with contextlib.closing(Chief(lone.session)) as chief:
        silent, forgotten = os.urandom(16), os.urandom(16)
        assert lone.send("hold", "SwarmHold", silent, vehicles=["quad1"])
        status, result = lone.result("hold", "SwarmHold", silent)
        assert (status, result.success) == (ABORTED, False)
        assert "the planner is silent of g1-1, which was flying" in result.message
        assert lone.send("hold", "SwarmHold", forgotten, vehicles=["quad1"])
        given = threading.Timer(1.0, chief.say)
        given.start()
        status, result = lone.result("hold", "SwarmHold", forgotten)
        assert status == ABORTED
        assert "is in the book of fake no longer" in result.message
        given.join()


def test_a_goal_whose_answer_is_lost_is_not_said_to_be_cancelled(lone: Client) -> None:
    """The planner may have it, and fly it."""
    with contextlib.closing(Chief(lone.session)) as chief:
        name, chief.mute = os.urandom(16), True
        assert lone.send("hold", "SwarmHold", name, vehicles=["quad1"])
        assert not lone.cancel("hold", name).goals_canceling
        _, result = lone.result("hold", "SwarmHold", name)
        assert not result.success
        assert "it may have taken the goal all the same" in result.message


def test_a_goal_is_the_same_as_an_action_and_as_a_service() -> None:
    for kind, _ in KINDS.values():
        texts = [(INTERFACES / "zmav_msgs" / what / f"{kind}.{what}").read_text() for what in ("action", "srv")]
        (as_action, result, _), (as_service, answer) = [text.split("---\n") for text in texts]
        assert as_action.split("\n", 1)[1] == as_service.split("\n", 1)[1]
        assert result == answer


NAMES = {"quad_1": "quad-1"}


def said(kind: str, **fields: Any) -> Any:
    made = known().make(f"zmav_msgs/action/{kind}_Goal", vehicles=["quad_1", "quad2"], **fields)
    return next(make for each, make in KINDS.values() if each == kind)(made, lambda name: NAMES.get(name, name))


VEHICLES = ["quad-1", "quad2"]
SQUARE = [point(0.0, 0.0), point(10.0, 0.0), point(10.0, 20.0)]
CORNERS = [(0.0, 0.0), (0.0, 10.0), (20.0, 10.0)]


@pytest.mark.parametrize(
    ("made", "want"),
    [
        (lambda: said("SwarmHold"), swarm.Hold(vehicles=VEHICLES)),
        (lambda: said("SwarmReturn"), swarm.Return(vehicles=VEHICLES)),
        (lambda: said("SwarmLand", at=SQUARE), swarm.Land(vehicles=VEHICLES, at=CORNERS)),
        (
            lambda: said("SwarmGoTo", to=[point(1.0, 2.0, 3.0)], assign=True),
            swarm.GoTo(vehicles=VEHICLES, to=[(2.0, 1.0, -3.0)], labelled=False),
        ),
        (
            lambda: said("SwarmFormation", at=point(1.0, 2.0, 3.0), points=[point(1.0, 2.0, 3.0)]),
            swarm.Formation(
                vehicles=VEHICLES, shape="line", at=(2.0, 1.0, -3.0), heading=math.pi / 2, points=[(1.0, -2.0, -3.0)]
            ),
        ),
        (
            lambda: said("SwarmFollow", leader="quad_1", offsets=[point(-5.0, 0.0, 2.0)]),
            swarm.Follow(vehicles=VEHICLES, leader="quad-1", offsets=[(0.0, -5.0, -2.0)]),
        ),
        (
            lambda: said("SwarmSearch", polygon=SQUARE, height=25.0),
            swarm.Search(vehicles=VEHICLES, polygon=CORNERS, height=25.0),
        ),
        (
            lambda: said("SwarmSearch", polygon=SQUARE, height=25.0, aligned=True, overlap=0.3),
            swarm.Search(vehicles=VEHICLES, polygon=CORNERS, height=25.0, angle=math.pi / 2, overlap=0.3),
        ),
        (
            lambda: said("SwarmSurvey", polygon=SQUARE, height=25.0, across=0.8, along=0.6, pixels=4000, trigger=True),
            swarm.Survey(vehicles=VEHICLES, polygon=CORNERS, height=25.0, camera=(0.8, 0.6), pixels=4000, trigger=True),
        ),
        (lambda: said("SwarmTakeoff", height=12.0), swarm.TakeOff(vehicles=VEHICLES, height=12.0)),
    ],
)
def test_a_goal_in_the_planners_words(made: Any, want: swarm.Goal) -> None:
    assert made() == want
    assert wire.decode(wire.encode(swarm.Submit(goal=made())), swarm.Submit, "submit").goal == want


SHAPES = (
    swarm.Box(low=(1.0, 2.0, -3.0), high=(4.0, 5.0, -6.0)),
    swarm.Cylinder(center=(1.0, 2.0), radius=3.0, floor=0.0, ceiling=9.0),
    swarm.NoFly(polygon=CORNERS, floor=0.0, ceiling=9.0),
    swarm.Geofence(polygon=CORNERS, floor=0.0, ceiling=9.0),
    swarm.Ball(center=(1.0, 2.0, -3.0), radius=0.5, velocity=(4.0, 5.0, -6.0)),
    None,
)


@pytest.mark.parametrize("shape", SHAPES)
def test_an_obstacle_there_and_back(shape: Any) -> None:
    one = swarm.Obstacle(name="a", t=math.floor(time.time()) + 0.25, what=shape, ttl=2.5)
    message = obstacles.told(known(), swarm.ObstacleMap(t=1.0, planner="p", instance="i", obstacles=[one]))
    data = known().encode(message, "zmav_msgs/msg/Obstacles")
    assert obstacles.given(known().decode(data, "zmav_msgs/msg/Obstacles").obstacles) == [one]


def stamp(t: float) -> Any:
    return known().make("builtin_interfaces/msg/Time", sec=int(t), nanosec=0)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"shape": 0}, "shape is 0"),
        ({"shape": obstacles.BOX}, "corners is 0"),
        ({"shape": obstacles.BALL, "radius": math.inf}, "radius is inf"),
        ({"shape": obstacles.BALL, "stamp": stamp(1000.0)}, "the stamp of a is 1000.000; expected UTC"),
        ({"shape": obstacles.GONE, "stamp": stamp(time.time() + 3600.0)}, "zeros for now"),
        ({"shape": obstacles.BALL, "name": "Q"}, "cannot stand in a key"),
        ({"shape": obstacles.BALL, "velocity": known().make("geometry_msgs/msg/Vector3", x=math.nan)}, "velocity.x"),
    ],
)
def test_an_obstacle_that_is_none_is_refused(fields: dict[str, Any], words: str) -> None:
    with pytest.raises((BadInput, BadKey), match=words):
        obstacles.given([known().make("zmav_msgs/msg/Obstacle", **({"name": "a"} | fields))])


def test_too_many_of_anything_are_refused() -> None:
    with pytest.raises(BadInput, match="at most"):
        goals.places("to", [point(0.0, 0.0)] * (goals.MOST + 1))
    with pytest.raises(BadInput, match="at most"):
        obstacles.given([None] * (obstacles.MOST + 1))
