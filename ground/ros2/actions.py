"""Orders that last as actions of ROS: accepted at once, with feedback on the way, a result, and a cancel.

An action is three services and two topics below ``{name}/_action``: send_goal, get_result and cancel_goal; feedback and
status. A goal that is cancelled has the vehicle hold: what it does must not go on behind the back of who cancelled. (A
landing that is cancelled ends in a hold, too.) A goal whose asker has gone is seen through by the vehicle.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from ground.ros2 import convert
from ground.ros2.node import RosNode
from ground.ros2.orders import finite, place
from ground.ros2.qos import LATCHED
from ground.ros2.steering import Log, Steering
from zmav import wire
from zmav.errors import Refused, ZmavError
from zmav.vehicle import Vehicle

logger = logging.getLogger(__name__)
ACCEPTED, EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = 1, 2, 3, 4, 5, 6
"""of action_msgs/GoalStatus"""
REJECTED, UNKNOWN_GOAL, TERMINATED = 1, 2, 3
"""of action_msgs/srv/CancelGoal"""
ENDED = (SUCCEEDED, CANCELED, ABORTED)
SECOND = 1_000_000_000
"""ns"""
KEPT = 60.0
"""s for which the result of a goal is kept"""
MOST = 16
"""goals of one action that are known at a time"""
Order = Callable[[Any], tuple[str, wire.Order]]
"""verb and arguments of a goal; raises :class:`~zmav.errors.BadInput`"""


class Goal:
    """A goal that was accepted."""

    def __init__(self, name: bytes) -> None:
        self.name = name
        self.at = time.time_ns()
        self.status = ACCEPTED
        self.message = ""
        self.ended = asyncio.Event()
        self.ended_at = 0.0
        self.task: asyncio.Task[None] | None = None


class Action:
    """One action of one vehicle. Lives on the event loop. ``order`` says what a goal means; ``feedback`` names the
    vehicle's progress, and the field of the feedback that shows it.
    """

    def __init__(
        self,
        node: RosNode,
        vehicle: Vehicle,
        steering: Steering,
        log: Log,
        name: str,
        kind: str,
        order: Order,
        feedback: tuple[str, str],
    ) -> None:
        self._node, self._vehicle, self._steering, self._log = node, vehicle, steering, log
        self._name, self._kind, self._order, self._shown = name, kind, order, feedback
        self._make = node.ros.types.make
        self._goals: dict[bytes, Goal] = {}
        node.serve(f"{name}/_action/send_goal", f"{kind}_SendGoal", self._send)
        node.serve(f"{name}/_action/get_result", f"{kind}_GetResult", self._result)
        node.serve(f"{name}/_action/cancel_goal", "action_msgs/srv/CancelGoal", self._cancel)
        self._feedback = node.publish(f"{name}/_action/feedback", f"{kind}_FeedbackMessage")
        self._status = node.publish(f"{name}/_action/status", "action_msgs/msg/GoalStatusArray", LATCHED)

    async def close(self) -> None:
        """The vehicle sees through what it was told."""
        tasks = [goal.task for goal in self._goals.values() if goal.task is not None]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _send(self, request: Any, gid: bytes) -> Any:
        """Accepted where it may be given at all; what the vehicle says of it is the goal's end."""
        name, goal = bytes(request.goal_id.uuid), None
        self._forget()
        try:
            self._steering.check()
            verb, args = self._order(request.goal)
            if name in self._goals or len(self._goals) >= MOST:
                why = "this goal was sent before" if name in self._goals else f"{MOST} goals are known already"
                raise Refused(f"{self._name}: {why}", vehicle=self._vehicle.name)
            args.lease = self._steering.token(gid)
            goal = self._goals[name] = Goal(name)
            goal.task = asyncio.create_task(self._see_through(goal, verb, args))
        except ZmavError as e:
            self._log(f"{self._name} refused: {e}")
        stamp = self._stamp(goal) if goal is not None else convert.now(self._node.ros.types)
        return self._make(f"{self._kind}_SendGoal_Response", accepted=goal is not None, stamp=stamp)

    async def _see_through(self, goal: Goal, verb: str, args: wire.Order) -> None:
        self._enter(goal, EXECUTING)

        def on_progress(news: dict[str, Any]) -> None:
            theirs, ours = self._shown
            if theirs in news and goal.status not in ENDED:
                shown = self._make(f"{self._kind}_Feedback", **{ours: float(news[theirs])})
                self._feedback(self._make(f"{self._kind}_FeedbackMessage", goal_id=self._uuid(goal), feedback=shown))

        try:
            await self._vehicle.order(verb, args, on_progress)
        except ZmavError as e:
            goal.message = str(e)
            self._enter(goal, CANCELED if goal.status == CANCELING else ABORTED)
            self._log(f"{self._name}: {e}")
        except Exception as e:
            logger.exception("%s of %s", self._name, self._vehicle.name)
            goal.message = str(e)
            self._enter(goal, ABORTED)
        else:
            self._enter(goal, SUCCEEDED)

    async def _result(self, request: Any, gid: bytes) -> Any:
        """Once the goal has ended; of one that is not known, that its status is unknown (0)."""
        answer = f"{self._kind}_GetResult_Response"
        goal = self._goals.get(bytes(request.goal_id.uuid))
        if goal is None:
            return self._make(answer)
        await goal.ended.wait()
        done = goal.status == SUCCEEDED
        result = self._make(f"{self._kind}_Result", success=done, message=goal.message or ("done" if done else ""))
        return self._make(answer, status=goal.status, result=result)

    async def _cancel(self, request: Any, gid: bytes) -> Any:
        """One goal, all that were accepted until a time, or (both zero) all: the vehicle holds."""
        name, stamp = bytes(request.goal_info.goal_id.uuid), request.goal_info.stamp
        until = stamp.sec * SECOND + stamp.nanosec
        every = not any(name)
        meant = [goal for goal in self._goals.values() if goal.name == name or (goal.at <= until if until else every)]
        active = [goal for goal in meant if goal.status not in ENDED]
        code = 0
        if not active:
            code = 0 if every else TERMINATED if meant else UNKNOWN_GOAL
        else:
            before = [goal.status for goal in active]
            for goal in active:
                self._enter(goal, CANCELING)
            try:
                await self._vehicle.order("hold", wire.Order(lease=self._steering.token(gid)))
            except ZmavError as e:
                self._log(f"{self._name}: not cancelled: {e}")
                code = REJECTED
                for goal, status in zip(active, before, strict=True):
                    if goal.status == CANCELING:
                        self._enter(goal, status)
                active = []
        infos = [self._info(goal) for goal in active]
        return self._make("action_msgs/srv/CancelGoal_Response", return_code=code, goals_canceling=infos)

    def _enter(self, goal: Goal, status: int) -> None:
        goal.status = status
        if status in ENDED:
            goal.ended_at = time.monotonic()
            goal.ended.set()
        found = [
            self._make("action_msgs/msg/GoalStatus", goal_info=self._info(each), status=each.status)
            for each in self._goals.values()
        ]
        self._status(self._make("action_msgs/msg/GoalStatusArray", status_list=found))

    def _forget(self) -> None:
        old = time.monotonic() - KEPT
        ended = sorted((goal for goal in self._goals.values() if goal.status in ENDED), key=lambda goal: goal.ended_at)
        for goal in ended:
            if goal.ended_at < old or len(self._goals) >= MOST:
                del self._goals[goal.name]

    def _uuid(self, goal: Goal) -> Any:
        return self._make("unique_identifier_msgs/msg/UUID", uuid=np.frombuffer(goal.name, dtype=np.uint8))

    def _info(self, goal: Goal) -> Any:
        return self._make("action_msgs/msg/GoalInfo", goal_id=self._uuid(goal), stamp=self._stamp(goal))

    def _stamp(self, goal: Goal) -> Any:
        """When it was accepted; exact, for a cancel names it."""
        return self._make("builtin_interfaces/msg/Time", sec=goal.at // SECOND, nanosec=goal.at % SECOND)


def actions(node: RosNode, vehicle: Vehicle, steering: Steering, log: Log) -> list[Action]:
    """Those of one vehicle."""
    table: tuple[tuple[str, str, Order, tuple[str, str]], ...] = (
        ("takeoff", "Takeoff", _takeoff, ("alt_rel", "altitude")),
        ("goto", "GoTo", lambda goal: ("goto", place(goal)), ("away", "distance")),
        ("land", "Land", _land, ("alt_rel", "altitude")),
    )
    return [
        Action(node, vehicle, steering, log, name, f"zmav_msgs/action/{kind}", order, feedback)
        for name, kind, order, feedback in table
    ]


def _takeoff(goal: Any) -> tuple[str, wire.Order]:
    return "takeoff", wire.Takeoff(alt_rel=finite("altitude", goal.altitude))


def _land(goal: Any) -> tuple[str, wire.Order]:
    return "rtl" if goal.return_first else "land", wire.Order()
