"""The fleet in ROS 2: a node for each vehicle, as long as it is there."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Coroutine, Mapping
from typing import Any

from ground.ros2 import convert, graph
from ground.ros2.cameras import Cameras
from ground.ros2.long_orders import long_orders
from ground.ros2.missions import Missions
from ground.ros2.node import Ros, RosNode
from ground.ros2.orders import Orders
from ground.ros2.params import Parameters
from ground.ros2.plans import Plans
from ground.ros2.qos import RELIABLE, SENSOR
from ground.ros2.rosout import Rosout
from ground.ros2.setpoints import setpoint_topics
from ground.ros2.steering import Steering
from ground.ros2.swarm import NODE as SWARM
from ground.ros2.swarm import Swarm
from ground.ros2.telemetry import Telemetry, fleet_frame
from ground.ros2.watch import Watch
from zmav.client import Client
from zmav.doctor.facts import facts_of
from zmav.doctor.rules import reasons
from zmav.tokens import find_tokens
from zmav.vehicle import Vehicle
from zmav.waiting import cancelled, in_thread

logger = logging.getLogger(__name__)
NODE = "zmav"
"""each vehicle's node: /quad1/zmav"""
MOST = 200
"""vehicles at once"""
MOST_NAMES = 2000
"""vehicles in all"""
LOOK = 0.1
"""s between two looks at who is there and what is new of each"""
DIAGNOSE = 1.0
"""s between two diagnostics of one vehicle"""
LEVELS = {"ok": 0, "note": 0, "warn": 1, "bad": 2}
STALE = 3
"""of diagnostic_msgs/DiagnosticStatus"""
KNOWN_WITHIN = 3.0
"""s in which the graph is found, before anything is added to it"""


class VehicleNode:
    """One vehicle as a node of ROS. Lives on the event loop. ``takes_over``: another has shown it until now."""

    def __init__(
        self,
        z: Client,
        ros: Ros,
        watch: Watch,
        vehicle: Vehicle,
        hz: Mapping[str, float],
        *,
        may_order: bool,
        takes_over: bool,
    ) -> None:
        self.z, self.vehicle, self.watch = z, vehicle, watch
        self.name = graph.ros_name(vehicle.name)
        self.node: RosNode = ros.node(f"/{self.name}", NODE)
        self.telemetry = Telemetry(z, self.node, watch, vehicle, self.name, hz)
        self.log = Rosout(self.node)
        self._diagnostics = self.node.publish("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", RELIABLE)
        self._text = self.node.publish("statustext/recv", "mavros_msgs/msg/StatusText", SENSOR)
        self.steering = Steering(vehicle, watch, self.log, may_order=may_order, takes_over=takes_over)
        self.orders = Orders(self.node, z.vehicle(vehicle.name), self.steering, self.log)
        self.actions = long_orders(self.node, z.vehicle(vehicle.name), self.steering, self.log)
        self.missions = Missions(z, self.node, watch, z.vehicle(vehicle.name), self.steering, self.log)
        self.plans = Plans(z, self.node, watch, vehicle.fleet, vehicle.name, fleet_frame(vehicle.fleet))
        setpoint_topics(self.node, fleet_frame(vehicle.fleet), self.steering)
        self.cameras = Cameras(z, ros, watch, vehicle, self.name)
        self._params_node = ros.node(f"/{self.name}", "param")
        Parameters(self._params_node, z.vehicle(vehicle.name), self.steering, self.log)
        self._heard = [
            endpoint
            for node in (self.node, self._params_node)
            for endpoint in node.endpoints
            if endpoint.kind != graph.PUBLISHER
        ]
        for endpoint in self._heard:
            watch.offer(endpoint, lambda wanted: None)
        self._diagnosed = 0.0
        self._events = asyncio.create_task(self._hear())

    async def close(self) -> None:
        await cancelled(self._events)
        self.telemetry.close()
        await self.cameras.close()
        await self.missions.close()
        await self.plans.close()
        for endpoint in self._heard:
            self.watch.withdraw(endpoint)
        await self.orders.close()
        for action in self.actions:
            await action.close()
        await self.steering.close()
        self._params_node.close()
        self.node.close()

    def look(self, now: float) -> None:
        """Say what is new of its state."""
        self.telemetry.publish_state()
        if now - self._diagnosed >= DIAGNOSE:
            self._diagnosed = now
            self._diagnostics(self._diagnosis())

    def _diagnosis(self) -> Any:
        types, facts = self.node.ros.types, facts_of(self.vehicle)
        found, state = reasons(facts), facts.state
        level = STALE if facts.presence != "ok" else max((LEVELS[each.level] for each in found), default=0)
        told = {"mode": state.mode, "link": state.link, "mover": state.mover} if state else {}
        values = [
            types.make("diagnostic_msgs/msg/KeyValue", key=key, value=str(value))
            for key, value in (*told.items(), *((each.rule, each.text) for each in found))
        ]
        status = types.make(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=level,
            name=f"{self.name}: vehicle",
            message="; ".join(each.text for each in found) or "ok",
            hardware_id=(state.uid or "") if state else "",
            values=values,
        )
        header = convert.header(types, "", self.vehicle.last_state.t if self.vehicle.last_state else 0.0)
        return types.make("diagnostic_msgs/msg/DiagnosticArray", header=header, status=[status])

    async def _hear(self) -> None:
        async with self.vehicle.events() as events:
            async for event in events:
                try:
                    self.missions.on_event(event)
                    self._text(convert.status_text(self.node.ros.types, event))
                    self.log(event.text, event.severity)
                except Exception:
                    logger.exception("an event of %s was not published", self.vehicle.name)


class Face:
    """Use it with ``async with``, on an open client of one fleet. ``hz``: rates of topics by name; ``may_order``: what
    ROS says may reach the vehicles; ``only``: one vehicle's name, where others are shown by others; None: all, and the
    swarm.

    Each node of a name is one's in a domain: who has shown it first. Another stands by, and shows it once that one is
    gone; of two that came at a time (a network that was torn) the one whose session has the lower id goes on.
    """

    def __init__(
        self,
        z: Client,
        domain: int,
        hz: Mapping[str, float],
        say: Callable[[str], None],
        *,
        may_order: bool,
        only: str | None = None,
    ) -> None:
        self._z, self._domain, self._hz, self._say, self._may_order = z, domain, hz, say, may_order
        self._only, self._frame = only, fleet_frame(z.fleet_name)
        self.swarm: Swarm | None = None
        self.vehicles: dict[str, VehicleNode] = {}
        """by their names in ROS"""
        self._named: dict[str, str] = {}
        """which vehicle has a name in ROS, and keeps it: who commands that name there means no other"""
        self._left_out: set[str] = set()
        self._others: set[str] = set()
        """nodes that are shown by others"""
        self._closing: dict[str, asyncio.Task[None]] = {}

    async def __aenter__(self) -> Face:
        self.ros = Ros(self._z.session, self._domain)
        self.watch = Watch(self.ros, self._say)
        self._running = asyncio.create_task(self._run())
        return self

    async def __aexit__(self, *_: object) -> None:
        await cancelled(self._running)
        self.watch.close()
        for name in list(self.vehicles):
            self._close(name)
        self._show_swarm(False)
        await asyncio.gather(*self._closing.values(), return_exceptions=True)

    async def serve(self) -> None:
        """Until cancelled; raises what ended the looks at the fleet: nothing is shown any more."""
        await asyncio.shield(self._running)

    async def _run(self) -> None:
        loop = asyncio.get_running_loop()
        await in_thread(find_tokens, self._z.session, f"{graph.SPACE}/{self._domain}/**", KNOWN_WITHIN)
        while True:
            try:
                path = f"/{self._frame}/{SWARM}"
                self._show_swarm(self._only is None and not self._shown_by_another(path, self.swarm is not None))
                self._meet()
            except Exception:
                logger.exception("a look at the fleet failed; the next is soon")
            for node in self.vehicles.values():
                try:
                    node.look(loop.time())
                except Exception:
                    logger.exception("a look at %s failed; the next is soon", node.vehicle.name)
            await asyncio.sleep(LOOK)

    def _shown_by_another(self, path: str, ours: bool) -> bool:
        """That node, which we show or do not, is not to be ours: said when it begins, and when it ends."""
        others = self.watch.sessions_of(path)
        theirs = any(not ours or zid < self.ros.zid for zid in others)
        if theirs and path not in self._others and len(self._others) < MOST_NAMES:
            self._others.add(path)
            self._say(f"another 'zmav ros2' shows {path}: this one stands by, and shows it once that one is gone")
        elif not theirs and path in self._others:
            self._others.discard(path)
            self._say(f"{path} is shown here")
        return theirs

    def _show_swarm(self, shown: bool) -> None:
        if shown and self.swarm is None and f"/{SWARM}" not in self._closing:
            names = self._named
            self.swarm = Swarm(
                self._z,
                self.ros,
                self.watch,
                self._frame,
                lambda name: names.get(name, name),
                graph.ros_name,
                may_order=self._may_order,
            )
        elif not shown and self.swarm is not None:
            swarm, self.swarm = self.swarm, None
            self._end(f"/{SWARM}", swarm.close())

    def _close(self, name: str) -> None:
        self._end(name, self.vehicles.pop(name).close())

    def _end(self, name: str, close: Coroutine[Any, Any, None]) -> None:
        """Have a node end, however long its vehicle, which may be gone, takes to answer."""

        def closed(task: asyncio.Task[None]) -> None:
            del self._closing[name]
            if not task.cancelled() and task.exception() is not None:
                logger.error("the node of %s did not end well", name, exc_info=task.exception())

        self._closing[name] = asyncio.create_task(close)
        self._closing[name].add_done_callback(closed)

    def _meet(self) -> None:
        """A node for who has come, none for who is gone: neither its token nor its state is there any more."""
        there = {
            vehicle.name: vehicle
            for vehicle in self._z.fleet()
            if vehicle.last_state is not None and self._only in (None, vehicle.name)
        }
        for name, node in list(self.vehicles.items()):
            if node.vehicle.name not in there or self._shown_by_another(f"/{name}/{NODE}", True):
                self._close(name)
        for vehicle in there.values():
            name = graph.ros_name(vehicle.name)
            path = f"/{name}/{NODE}"
            takes_over, known = path in self._others, name in self.vehicles or name in self._closing
            full = len(self.vehicles) >= MOST or (name not in self._named and len(self._named) >= MOST_NAMES)
            if full and not known:
                self._leave_out(vehicle.name, "there are too many vehicles")
            elif (named := self._named.setdefault(name, vehicle.name)) != vehicle.name:
                self._leave_out(vehicle.name, f"in ROS it would be /{name}, as {named} is")
            elif not known and not self._shown_by_another(path, False):
                may = {"may_order": self._may_order, "takes_over": takes_over}
                self.vehicles[name] = VehicleNode(self._z, self.ros, self.watch, vehicle, self._hz, **may)

    def _leave_out(self, name: str, why: str) -> None:
        if name not in self._left_out and len(self._left_out) < MOST_NAMES:
            self._left_out.add(name)
            self._say(f"{name} is left out: {why}")
