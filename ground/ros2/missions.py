"""Missions, fences and rally points with MAVROS's names and types. Waypoints of a mission count as on the autopilot:
ArduPilot's first one is home.

The plan is what the vehicle's companion knows, which reads it again where it has changed; it is fetched over the radio
once when somebody begins to subscribe, and again when the vehicle says that there is another.
"""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable
from functools import partial
from typing import Any

import zenoh

from ground.ros2 import convert
from ground.ros2.node import RosNode
from ground.ros2.orders import serve_order
from ground.ros2.qos import LATCHED, RELIABLE
from ground.ros2.steering import Log, Steering
from ground.ros2.watch import Watch, WhileWanted
from zmav import keys, wire
from zmav.client import Client
from zmav.direct import direct
from zmav.errors import BadInput, Refused, ZmavError
from zmav.formats.items import command_name, command_number
from zmav.mavlink import decode, parse_frame
from zmav.vehicle import Vehicle
from zmav.waiting import on_loop

logger = logging.getLogger(__name__)
CURRENT, REACHED = "MISSION_CURRENT", "MISSION_ITEM_REACHED"
SELDOM, LATER = 1.0, 10.0
"""s between two times that the plan is fetched, and at most where it could not be: each costs the radio something"""
INT_FRAMES = {5: 0, 6: 3, 11: 10}
"""of MAV_FRAME, which mean the same as others"""
DO_JUMP = "MAV_CMD_DO_JUMP"
"""whose first parameter is an item's index"""
NAMES: dict[wire.MissionKind, tuple[str, str]] = {
    "mission": ("mission", "waypoints"),
    "fence": ("geofence", "fences"),
    "rally": ("rallypoint", "rallypoints"),
}
"""MAVROS's for each kind of plan: of its services, and of its topic"""


class Missions:
    """All plans of one vehicle. Lives on the event loop."""

    def __init__(self, z: Client, node: RosNode, watch: Watch, vehicle: Vehicle, steering: Steering, log: Log) -> None:
        self._z, self._node, self._watch, self._vehicle = z, node, watch, vehicle
        self._reached = node.publish("mission/reached", "mavros_msgs/msg/WaypointReached", RELIABLE)
        self._heard: dict[str, zenoh.Subscriber[Any]] = {}
        self._known: tuple[int, int, int] | None = None
        """what MISSION_CURRENT last said: item, how many, which plan"""
        self.plans = {
            kind: StoredPlan(z, node, watch, vehicle, steering, log, kind, partial(self._want_more_of, kind))
            for kind in NAMES
        }
        mission = self.plans["mission"]
        serve_order(node, "mission/set_current", "mavros_msgs/srv/WaypointSetCurrent", mission.set_current, log)
        watch.offer(self._reached.endpoint, partial(self._want, REACHED))

    async def close(self) -> None:
        self._watch.withdraw(self._reached.endpoint)
        for plan in self.plans.values():
            await plan.close()
        self._want(CURRENT, False)
        self._want(REACHED, False)

    def on_event(self, event: wire.Event) -> None:
        """The vehicle says that something is new of its plans."""
        if event.kind == "mission":
            for plan in self.plans.values():
                plan.changed.set()

    def _want_more_of(self, kind: wire.MissionKind, wanted: bool) -> None:
        if kind == "mission":
            self._want(CURRENT, wanted)

    def _want(self, message: str, wanted: bool) -> None:
        if wanted and message not in self._heard:
            key = keys.RX.key(self._vehicle.fleet, self._vehicle.name, sys="*", comp="*", msg=message)
            handler = direct(on_loop(self._node.ros.loop, self._on_frame))
            self._heard[message] = self._z.session.declare_subscriber(key, handler)
        elif not wanted and message in self._heard:
            self._heard.pop(message).undeclare()

    def _on_frame(self, sample: zenoh.Sample) -> None:
        state = self._vehicle.last_state
        try:
            frame = parse_frame(sample.payload.to_bytes(), self._z.dialect)
            fields = decode(frame, self._z.dialect)
        except BadInput:
            return
        if state is None or not self._vehicle.is_autopilot(frame.sysid, frame.compid):
            return  # of something else behind the same link
        types = self._node.ros.types
        if str(sample.key_expr).endswith(f"/{REACHED}"):
            header = convert.header(types, "", state.t)
            self._reached(types.make("mavros_msgs/msg/WaypointReached", header=header, wp_seq=fields["seq"]))
            return
        known = fields["seq"], fields.get("total", 0), fields.get("mission_id", 0)
        if known != self._known:
            self._known = known
            self.plans["mission"].changed.set()


class StoredPlan:
    """The plan of one kind that the autopilot has. Lives on the event loop. ``on_wanted`` is told whether anybody
    subscribes to its topic.
    """

    def __init__(
        self,
        z: Client,
        node: RosNode,
        watch: Watch,
        vehicle: Vehicle,
        steering: Steering,
        log: Log,
        kind: wire.MissionKind,
        on_wanted: Callable[[bool], None],
    ) -> None:
        self._z, self._watch, self._vehicle, self._kind = z, watch, vehicle, kind
        self._steering, self._make = steering, node.ros.types.make
        base, topic = NAMES[kind]
        for name, give in (("Pull", self._pull), ("Push", self._push), ("Clear", self._clear)):
            serve_order(node, f"{base}/{name.lower()}", f"mavros_msgs/srv/Waypoint{name}", give, log)
        self._waypoints = node.publish(f"{base}/{topic}", "mavros_msgs/msg/WaypointList", LATCHED)
        self.changed = asyncio.Event()
        self._on_wanted = on_wanted
        self._telling = WhileWanted(self._tell)
        watch.offer(self._waypoints.endpoint, self._want)

    async def close(self) -> None:
        self._watch.withdraw(self._waypoints.endpoint)
        await self._telling.close()

    def _want(self, wanted: bool) -> None:
        self._on_wanted(wanted)
        if wanted and not self._telling:
            self.changed.set()
        self._telling(wanted)

    async def _tell(self) -> None:
        pause = SELDOM
        while True:
            await self.changed.wait()
            self.changed.clear()
            pause, before = SELDOM, pause
            try:
                await self._publish()
            except ZmavError as e:
                logger.debug("the %s of %s: %s", self._kind, self._vehicle.name, e)
                self.changed.set()
                pause = min(2.0 * before, LATER)
            except Exception:
                logger.exception("the %s of %s was not published", self._kind, self._vehicle.name)
            await asyncio.sleep(pause)

    async def _publish(self) -> int:
        """How many there are."""
        plan, first = await self._vehicle.missions.get(self._kind), self._first()
        found = [self.waypoint_of(item, first) for item in plan.items]
        if found and first:
            home = plan.home or (0.0, 0.0, 0.0)
            place = wire.MissionItem(
                command="MAV_CMD_NAV_WAYPOINT", frame="MAV_FRAME_GLOBAL", x=home[0], y=home[1], z=home[2]
            )
            found.insert(0, self.waypoint_of(place, first))
        current = 0 if plan.current is None else plan.current + first
        for index, waypoint in enumerate(found):
            waypoint.is_current = self._kind == "mission" and index == current
        self._waypoints(self._make("mavros_msgs/msg/WaypointList", current_seq=max(current, 0), waypoints=found))
        return len(found)

    # Services.

    async def _pull(self, request: Any, gid: bytes) -> dict[str, Any]:
        return {"wp_received": await self._publish()}

    async def _push(self, request: Any, gid: bytes) -> dict[str, Any]:
        if request.start_index:
            raise BadInput.wrong("start_index", request.start_index, "0: plans are replaced as a whole")
        first = self._first()
        items = [self.item_of(index, each, first) for index, each in enumerate(request.waypoints)][first:]
        await self._order("mission_upload", wire.MissionUpload(kind=self._kind, items=items), gid)
        return {"wp_transfered": len(request.waypoints)}

    async def _clear(self, request: Any, gid: bytes) -> None:
        await self._order("mission_clear", wire.MissionClear(kind=self._kind), gid)

    async def set_current(self, request: Any, gid: bytes) -> None:
        await self._order("mission_current", wire.MissionJump(index=max(request.wp_seq - self._first(), 0)), gid)

    async def _order(self, verb: str, args: wire.Order, gid: bytes) -> None:
        self._steering.check()
        args.lease = self._steering.token(gid)
        await self._vehicle.order(verb, args)
        self.changed.set()

    # Items.

    def _first(self) -> int:
        """The autopilot's index of our first item: 1 where home stands before it."""
        if self._kind != "mission":
            return 0
        autopilot = self._vehicle.state.autopilot
        if autopilot is None:
            text = f"{self._vehicle.name} has not said yet which autopilot it has"
            raise Refused(text, vehicle=self._vehicle.name)
        return int(autopilot == "ardupilot")

    def waypoint_of(self, item: wire.MissionItem, first: int) -> Any:
        enums = self._z.dialect.enums
        params = [math.nan if value is None else float(value) for value in item.params]
        params += [0.0] * (4 - len(params))
        if item.command == DO_JUMP:
            params[0] += first
        return self._make(
            "mavros_msgs/msg/Waypoint",
            frame=enums["MAV_FRAME"].get(item.frame, 0),
            command=command_number(item.command, enums),
            autocontinue=item.autocontinue,
            **{f"param{number}": value for number, value in enumerate(params[:4], 1)},
            x_lat=item.x,
            y_long=item.y,
            z_alt=item.z,
        )

    def item_of(self, index: int, waypoint: Any, first: int) -> wire.MissionItem:
        """Raises :class:`BadInput`; what the autopilot takes of it the vehicle judges."""
        enums, field = self._z.dialect.enums, f"waypoints[{index}]"
        number = INT_FRAMES.get(waypoint.frame, waypoint.frame)
        frame = next((name for name, value in enums["MAV_FRAME"].items() if value == number), None)
        if frame is None:
            raise BadInput.wrong(f"{field}.frame", number, "one of MAV_FRAME")
        for axis in ("x_lat", "y_long", "z_alt"):
            if not math.isfinite(getattr(waypoint, axis)):
                raise BadInput.wrong(f"{field}.{axis}", getattr(waypoint, axis), "a number")
        command = command_name(waypoint.command, enums)
        params = [float(getattr(waypoint, f"param{number}")) for number in (1, 2, 3, 4)]
        if command == DO_JUMP:
            params[0] -= first
        return wire.MissionItem(
            command=command,
            frame=frame,
            params=[None if math.isnan(value) else value for value in params],
            x=waypoint.x_lat,
            y=waypoint.y_long,
            z=waypoint.z_alt,
            autocontinue=bool(waypoint.autocontinue),
        )
