"""The swarm in ROS, ``/{fleet}/swarm``: the planner's goals as actions and services, its book, plans and obstacles as
topics, and orders to every vehicle at once, which need no planner.
"""

from __future__ import annotations

import asyncio
import math
import time
import uuid
from collections.abc import Callable
from functools import partial
from typing import Any

from ground.ros2 import convert, obstacles
from ground.ros2.actions import Action, Feedback, Work
from ground.ros2.goals import KINDS, Make
from ground.ros2.node import Publisher, Ros
from ground.ros2.orders import UNDER_WAY, Give, serve_order
from ground.ros2.plans import path
from ground.ros2.qos import LATCHED, RosQos
from ground.ros2.rosout import Rosout
from ground.ros2.steering import READ_ONLY, SAY_EVERY, SAY_MOST
from ground.ros2.watch import W, Watch, WhileWanted, hear
from zmav import keys, wire
from zmav.client import Client
from zmav.errors import Refused, TimedOut, ZmavError
from zmav.ratelimit import RateLimit
from zmav.subscription import document
from zmav.swarm import FleetOrder, order_chief
from zmav.vehicle import Vehicle
from zmav.verbs import VERBS
from zmav.waiting import cancelled, within
from zmav.wire import swarm

NODE = "swarm"
"""/{fleet}/swarm"""
TOGETHER = {"hold_all": "hold", "land_all": "land", "return_all": "rtl"}
"""orders to every vehicle"""
BOOKLESS = 10.0
"""s without a book of the planner, or without the goal in it, after which it is asked for no longer"""
LOOK = 0.1
"""s between two looks at how far an order to all is"""
ENDED = ("done", "failed", "cancelled")
LOST = "it may have taken the goal all the same; 'swarm/goals' shows it, and 'swarm/cancel' or 'swarm/abort' drops it"


class Swarm:
    """The fleet's node. Lives on the event loop. ``frame``: the fleet's; ``name_of``: the fleet's name of a vehicle by
    its name in ROS, and ``ros_name`` the other way.
    """

    def __init__(
        self,
        z: Client,
        ros: Ros,
        watch: Watch,
        frame: str,
        name_of: Callable[[str], str],
        ros_name: Callable[[str], str],
        *,
        may_order: bool,
    ) -> None:
        self._z, self._watch, self._frame, self._may_order = z, watch, frame, may_order
        self._name_of, self._ros_name, self._types = name_of, ros_name, ros.types
        self.node = ros.node(f"/{frame}", NODE)
        self.log = Rosout(self.node)
        self._said: RateLimit[str] = RateLimit(SAY_EVERY, SAY_MOST)
        self._tasks: set[asyncio.Task[Any]] = set()
        self._heard = [
            self._telling("goals", "SwarmGoals", "goal", swarm.Book, self._book),
            self._telling("plans", "SwarmPlan", "plan", swarm.PlanReport, self._plan, RosQos(transient_local=True)),
            self._telling(
                "obstacles", "Obstacles", "obstacle", swarm.ObstacleMap, partial(obstacles.told, self._types)
            ),
        ]
        self.node.subscribe("swarm/set_obstacles", "zmav_msgs/msg/Obstacles", self._take_obstacles)
        self._serve("set_obstacles", "SetObstacles", self._set_obstacles)
        for verb in ("pause", "resume", "abort", "cancel"):
            self._serve(verb, "SwarmGoal", self._about(verb))
        for name, verb in TOGETHER.items():
            serve_order(self.node, f"swarm/{name}", "std_srvs/srv/Trigger", self._together(verb), self.log)
        self.actions = []
        for name, (kind, make) in KINDS.items():
            self._serve(name, kind, self._submitting(make))
            begin = partial(self._begin, make)
            self.actions.append(Action(self.node, f"swarm/{name}", f"zmav_msgs/action/{kind}", begin, self.log))

    async def close(self) -> None:
        """What was asked of planner and vehicles goes on."""
        for publisher, telling in self._heard:
            self._watch.withdraw(publisher.endpoint)
            await telling.close()
        await cancelled(*self._tasks)
        await asyncio.gather(*(action.close() for action in self.actions), return_exceptions=True)
        self.node.close()

    # Topics.

    def _telling(
        self, name: str, kind: str, topic: str, payload: type[W], make: Callable[[W], Any], qos: RosQos = LATCHED
    ) -> tuple[Publisher, WhileWanted]:
        """Have a topic of the fleet heard, and told, while somebody subscribes to it."""
        publisher = self.node.publish(f"swarm/{name}", f"zmav_msgs/msg/{kind}", qos)

        def publish(told: W) -> None:
            publisher(make(told))

        telling = WhileWanted(partial(hear, self._z, self._z.fleet_name, topic, payload, publish))
        self._watch.offer(publisher.endpoint, telling)
        return publisher, telling

    def _book(self, book: swarm.Book) -> Any:
        make = self._types.make
        goals = [
            make(
                "zmav_msgs/msg/SwarmGoal",
                goal=entry.id,
                kind=str(entry.goal.__struct_config__.tag),
                vehicles=[self._ros_name(name) for name in entry.goal.vehicles],
                state=entry.state,
                text=entry.text,
                by=entry.by,
                stamp=convert.header(self._types, "", entry.t).stamp,
                **_figures(entry),
            )
            for entry in book.goals
        ]
        stamp = convert.header(self._types, "", book.t).stamp
        fields = {"planner": book.planner, "term": book.term, "paused": book.paused, "goals": goals}
        return make("zmav_msgs/msg/SwarmGoals", stamp=stamp, **fields)

    def _plan(self, plan: swarm.PlanReport) -> Any:
        return self._types.make(
            "zmav_msgs/msg/SwarmPlan",
            header=convert.header(self._types, self._frame, plan.start),
            goal=plan.goal,
            planner=plan.planner,
            makespan=plan.makespan,
            clearance=math.nan if plan.clearance is None else plan.clearance,
            vehicles=[self._ros_name(name) for name in plan.tracks],
            paths=[path(self._types, self._frame, plan.start, track) for track in plan.tracks.values()],
        )

    # Orders.

    def _serve(self, name: str, kind: str, give: Give) -> None:
        serve_order(self.node, f"swarm/{name}", f"zmav_msgs/srv/{kind}", give, self.log)

    def _check(self) -> None:
        if not self._may_order:
            raise Refused(READ_ONLY)

    def _submit_of(self, make: Make, said: Any) -> swarm.Submit:
        self._check()
        return swarm.Submit(goal=make(said, self._name_of), when="queue" if said.queue else "now", id=uuid.uuid4().hex)

    def _begin(self, make: Make, said: Any, gid: bytes) -> Work:
        return SwarmGoal(self._z, self._submit_of(make, said))

    def _submitting(self, make: Make) -> Give:
        async def give(said: Any, gid: bytes) -> dict[str, Any]:
            told = await submitted(self._z, self._submit_of(make, said))
            goal = str(told.get("goal"))
            return {"goal": goal, "message": f"{goal} is in the book of {told.get('planner')}"}

        return give

    def _about(self, verb: str) -> Give:
        """One goal of the planner's, or all."""

        async def give(said: Any, gid: bytes) -> dict[str, Any]:
            self._check()
            told = await order_chief(self._z, verb, swarm.GoalId(goal=said.goal, id=uuid.uuid4().hex))
            return {"message": ", ".join(map(str, told.get("goals", []))) or "nothing"}

        return give

    def _together(self, verb: str) -> Give:
        """Every vehicle: answered when each has done it, or is under way. It asks no planner but for a way home."""

        async def give(said: Any, gid: bytes) -> dict[str, Any]:
            self._check()
            moving = set[str]()

            def progress(vehicle: Vehicle) -> Callable[[dict[str, Any]], None]:
                def tell(news: dict[str, Any]) -> None:
                    if UNDER_WAY & news.keys():
                        moving.add(vehicle.name)

                return tell

            order = FleetOrder(self._z, self._z.fleet(), verb, VERBS[verb].args(), self._told, progress)
            task = asyncio.create_task(order.run())
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
            while any(each.status == "running" and each.vehicle not in moving for each in order.told.values()):
                await asyncio.wait({task}, timeout=LOOK)
                if task.done():
                    task.result()  # or what was not seen through were under way
                    break
            words = "; ".join(f"{each.vehicle}: {each.text or 'under way'}" for each in order.told.values())
            if any(each.status == "failed" for each in order.told.values()):
                raise Refused(words)
            return {"message": words or "no vehicle is there"}

        return give

    def _told(self, news: Any) -> None:
        """Of an order to all: what only comes after its answer is on /rosout."""
        if isinstance(news, str):
            self.log(news, "info")
        elif news.status == "failed":
            self.log(f"{news.vehicle}: {news.text}")

    # Obstacles.

    async def _set_obstacles(self, said: Any, gid: bytes) -> dict[str, Any]:
        self._check()
        known = obstacles.given(said.obstacles)
        orders = [swarm.GiveObstacle(obstacle=each, id=uuid.uuid4().hex) for each in known]
        told = await order_chief(self._z, "obstacle", *orders)
        return {"message": f"{told['obstacles']} obstacles are known" if told else "nothing was said"}

    def _take_obstacles(self, said: Any, gid: Any) -> None:
        """As they come, without an answer: for what sees things move."""
        try:
            self._check()
            for each in obstacles.given(said.obstacles):
                key = keys.OBSTACLE.key(self._z.fleet_name, name=each.name)
                self._z.put(keys.OBSTACLE, key, wire.encode(each))
        except ZmavError as e:
            if self._said.take(e.message) is not None:
                self.log(f"obstacles dropped: {e}")


class SwarmGoal:
    """One goal of the planner's, from its submission to its end in the book."""

    def __init__(self, z: Client, submit: swarm.Submit) -> None:
        self._z, self._submit = z, submit
        self._goal = ""
        """the planner's name of it"""
        self._known = asyncio.Event()
        """the planner has answered, or did not in time"""
        self._silent = False
        """it did not: it may have the goal all the same"""

    async def run(self, feedback: Feedback) -> dict[str, Any]:
        try:
            async with self._z.subscribe(
                keys.FLEET.key(self._z.fleet_name, topic="goal"), document(swarm.Book)
            ) as books:
                self._goal = await self._give()
                self._known.set()
                await self._watch(books.get, feedback)
        finally:
            self._known.set()
        return {"goal": self._goal}

    async def _give(self) -> str:
        """The planner's name of it."""
        try:
            return str((await submitted(self._z, self._submit)).get("goal"))
        except TimedOut:
            self._silent = True
            raise

    async def _watch(self, next_book: Callable[[], Any], feedback: Feedback) -> None:
        """Raises how it ended where it is not done. A planner that takes over goes on with the same goals."""
        term, last, seen = 0, "", time.monotonic()
        while True:
            try:
                book: swarm.Book = (await within(seen + BOOKLESS - time.monotonic(), next_book()))[1]
            except asyncio.TimeoutError:
                silent = f"the planner is silent of {self._goal}, which was {last}: its vehicles come to rest"
                raise TimedOut(silent if last else f"{self._goal} is in no book", goal=self._goal) from None
            if book.term < term:
                continue
            term = book.term
            entry = next((each for each in book.goals if each.id == self._goal), None)
            if entry is None:
                if last:
                    raise Refused(f"{self._goal} is in the book of {book.planner} no longer", goal=self._goal)
                continue
            last, seen = entry.state, time.monotonic()
            if entry.state == "done":
                return
            if entry.state in ENDED:
                raise Refused(f"{self._goal} {entry.state}: {entry.text}", goal=self._goal)
            feedback(state=entry.state, text=entry.text, **_figures(entry))

    async def stop(self, gid: bytes) -> None:
        """Its vehicles come to rest. A planner that does not answer flies nothing for long either."""
        await self._known.wait()
        if self._silent:
            raise Refused(LOST)
        if self._goal:
            await order_chief(self._z, "cancel", swarm.GoalId(goal=self._goal, id=uuid.uuid4().hex))


async def submitted(z: Client, submit: swarm.Submit) -> dict[str, Any]:
    """What the planner in charge says that came of it."""
    try:
        return await order_chief(z, "submit", submit)
    except TimedOut as e:
        raise TimedOut(f"{e.message}: {LOST}") from e


def _figures(entry: swarm.GoalEntry) -> dict[str, float]:
    numbers = {"makespan": entry.makespan, "clearance": entry.clearance}
    return {"progress": entry.progress, **{name: math.nan if v is None else v for name, v in numbers.items()}}
