"""An action of ROS: goals accepted at once, with feedback on the way, a result, and a cancel. What a goal comes down to
is its :class:`Work`.

An action is three services and two topics below ``{name}/_action``: send_goal, get_result and cancel_goal; feedback and
status. A goal whose asker has gone is seen through.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from ground.ros2 import convert
from ground.ros2.node import RosNode
from ground.ros2.qos import LATCHED
from zmav.errors import Refused, ZmavError
from zmav.waiting import cancelled

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
Log = Callable[[str], None]
Feedback = Callable[..., None]
"""``feedback(**fields)`` of the feedback's type"""


class Work(Protocol):
    """What one goal comes down to."""

    async def run(self, feedback: Feedback) -> dict[str, Any]:
        """See it through: what its result says besides that it is done. Raises why it failed."""

    async def stop(self, gid: bytes) -> None:
        """Have it end, for the node of ``gid``, and return once it was told to. Raises why it goes on."""


Begin = Callable[[Any, bytes], Work]
"""``begin(goal, gid)``: raises :class:`ZmavError` where it is not accepted"""


class Goal:
    """A goal that was accepted."""

    def __init__(self, name: bytes, work: Work) -> None:
        self.name, self.work = name, work
        self.at = time.time_ns()
        self.status = ACCEPTED
        self.message = ""
        self.more: dict[str, Any] = {}
        """of its result"""
        self.ended = asyncio.Event()
        self.ended_at = 0.0
        self.task: asyncio.Task[None] | None = None


class Action:
    """One action of a node. Lives on the event loop. ``kind``: its type, ``zmav_msgs/action/GoTo``."""

    def __init__(self, node: RosNode, name: str, kind: str, begin: Begin, log: Log) -> None:
        self._node, self._name, self._kind, self._begin, self._log = node, name, kind, begin, log
        self._make = node.ros.types.make
        self._goals: dict[bytes, Goal] = {}
        node.serve(f"{name}/_action/send_goal", f"{kind}_SendGoal", self._send)
        node.serve(f"{name}/_action/get_result", f"{kind}_GetResult", self._result)
        node.serve(f"{name}/_action/cancel_goal", "action_msgs/srv/CancelGoal", self._cancel)
        self._feedback = node.publish(f"{name}/_action/feedback", f"{kind}_FeedbackMessage")
        self._status = node.publish(f"{name}/_action/status", "action_msgs/msg/GoalStatusArray", LATCHED)

    async def close(self) -> None:
        """What was begun goes on without us."""
        await cancelled(*(goal.task for goal in self._goals.values()))

    async def _send(self, request: Any, gid: bytes) -> Any:
        """Accepted where it may be given at all; what becomes of it is the goal's end."""
        name, goal = bytes(request.goal_id.uuid), None
        self._forget()
        try:
            if name in self._goals or len(self._goals) >= MOST:
                why = "this goal was sent before" if name in self._goals else f"{MOST} goals are known already"
                raise Refused(f"{self._name}: {why}")
            goal = self._goals[name] = Goal(name, self._begin(request.goal, gid))
            goal.task = asyncio.create_task(self._see_through(goal))
        except ZmavError as e:
            self._log(f"{self._name} refused: {e}")
        stamp = self._stamp(goal) if goal is not None else convert.now(self._node.ros.types)
        return self._make(f"{self._kind}_SendGoal_Response", accepted=goal is not None, stamp=stamp)

    async def _see_through(self, goal: Goal) -> None:
        self._enter(goal, EXECUTING)

        def tell(**fields: Any) -> None:
            if goal.status not in ENDED:
                shown = self._make(f"{self._kind}_Feedback", **fields)
                self._feedback(self._make(f"{self._kind}_FeedbackMessage", goal_id=self._uuid(goal), feedback=shown))

        try:
            goal.more = await goal.work.run(tell)
        except ZmavError as e:
            goal.message = str(e)
            self._enter(goal, CANCELED if goal.status == CANCELING else ABORTED)
            self._log(f"{self._name}: {e}")
        except Exception as e:
            logger.exception("%s of %s", self._name, self._node.node.path)
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
        message = goal.message or ("done" if done else "")
        result = self._make(f"{self._kind}_Result", **{"success": done, "message": message, **goal.more})
        return self._make(answer, status=goal.status, result=result)

    async def _cancel(self, request: Any, gid: bytes) -> Any:
        """One goal, all that were accepted until a time, or (both zero) all."""
        name, stamp = bytes(request.goal_info.goal_id.uuid), request.goal_info.stamp
        until = stamp.sec * SECOND + stamp.nanosec
        every = not any(name)
        meant = [goal for goal in self._goals.values() if goal.name == name or (goal.at <= until if until else every)]
        active = [goal for goal in meant if goal.status not in ENDED]
        stopped = await asyncio.gather(*(self._stop(goal, gid) for goal in active))
        ending = [goal for goal, ends in zip(active, stopped, strict=True) if ends]
        known = TERMINATED if meant else UNKNOWN_GOAL
        code = 0 if ending or (every and not active) else REJECTED if active else known
        infos = [self._info(goal) for goal in ending]
        return self._make("action_msgs/srv/CancelGoal_Response", return_code=code, goals_canceling=infos)

    async def _stop(self, goal: Goal, gid: bytes) -> bool:
        """Whether it ends."""
        if goal.status in ENDED:
            return False  # meanwhile: what has ended stays as it ended
        before = goal.status
        self._enter(goal, CANCELING)
        try:
            await goal.work.stop(gid)
        except ZmavError as e:
            self._log(f"{self._name}: not cancelled: {e}")
            if goal.status == CANCELING:
                self._enter(goal, before)
            return False
        return True

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
