"""Orders as services of ROS: MAVROS's names and types, and services whose answer has room for the reason.

A service is answered when the order is done, or is under way as the vehicle's own progress shows; what becomes of it
then is on /rosout. So is why an order was refused, where the type of the answer (MAVROS's) has no room for it.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from typing import Any

from ground.ros2 import frames
from ground.ros2.convert import PX4_MODES
from ground.ros2.node import RosNode
from ground.ros2.steering import Log, Steering
from zmav import wire
from zmav.errors import BadInput, Forbidden, NotHolder, Refused, Unsupported, ZmavError
from zmav.mavlink.results import CommandResult
from zmav.vehicle import Vehicle
from zmav.verbs import VERBS
from zmav.waiting import alongside, cancelled

UNDER_WAY = {"alt_rel", "away", "progress"}
"""what a vehicle tells of an order that it has begun to carry out"""
MODES = {theirs: ours for ours, theirs in PX4_MODES.items()}
RESULTS: tuple[tuple[type[ZmavError], CommandResult], ...] = (
    (NotHolder, CommandResult.TEMPORARILY_REJECTED),
    (Unsupported, CommandResult.UNSUPPORTED),
    (Forbidden, CommandResult.DENIED),
    (BadInput, CommandResult.DENIED),
    (ZmavError, CommandResult.FAILED),
)
Give = Callable[[Any, bytes], Awaitable["dict[str, Any] | None"]]
"""``await give(request, gid)``: what its answer says besides that it is done; raises why not"""


def serve_order(node: RosNode, name: str, kind: str, give: Give, log: Log) -> None:
    """Have a service give an order: its outcome is in whatever fields the type of the answer has, and on /rosout why
    not.
    """
    fitting, answer = node.ros.types.fitting, f"{kind}_Response"

    async def answered(request: Any, gid: bytes) -> Any:
        try:
            more = await give(request, gid) or {}
        except ZmavError as e:
            log(f"{name} refused: {e}")
            return fitting(answer, success=False, result=int(result_of(e)), message=str(e))
        return fitting(answer, **{"success": True, "mode_sent": True, **more})

    node.serve(name, kind, answered)


class Orders:
    """The services of one vehicle. Lives on the event loop."""

    def __init__(self, node: RosNode, vehicle: Vehicle, steering: Steering, log: Log) -> None:
        self._vehicle, self._steering, self._log = vehicle, steering, log
        self._tasks: set[asyncio.Task[Any]] = set()
        services: tuple[tuple[str, str, Give], ...] = (
            ("cmd/arming", "mavros_msgs/srv/CommandBool", self._arm),
            ("cmd/takeoff", "mavros_msgs/srv/CommandTOL", self._takeoff),
            ("cmd/land", "mavros_msgs/srv/CommandTOL", self._land),
            ("set_mode", "mavros_msgs/srv/SetMode", self._set_mode),
            ("hold", "std_srvs/srv/Trigger", self._plain("hold")),
            ("land", "std_srvs/srv/Trigger", self._plain("land")),
            ("rtl", "std_srvs/srv/Trigger", self._plain("rtl")),
            ("goto", "zmav_msgs/srv/GoTo", self._goto),
            ("lease", "zmav_msgs/srv/Lease", self._lease),
        )
        for name, kind, give in services:
            serve_order(node, name, kind, give, log)

    async def close(self) -> None:
        """The vehicle sees through what it was told."""
        await cancelled(*self._tasks)

    async def begin(self, verb: str, args: wire.Order, gid: bytes) -> None:
        """Give an order; returns when it is done or under way. Raises what the vehicle says."""
        self._steering.check()
        under_way = asyncio.Event()

        def on_progress(news: dict[str, Any]) -> None:
            if UNDER_WAY & news.keys():
                under_way.set()

        args.lease = self._steering.token(gid)
        task = asyncio.create_task(self._vehicle.order(verb, args, on_progress))
        self._tasks.add(task)
        async with alongside(under_way.wait()) as (waiting,):
            await asyncio.wait({task, waiting}, return_when=asyncio.FIRST_COMPLETED)
        if task.done():
            self._tasks.discard(task)
            task.result()
            return
        task.add_done_callback(lambda ended: self._end(verb, ended))

    def _end(self, verb: str, task: asyncio.Task[Any]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            self._log(f"{verb}: {error}")

    def _plain(self, verb: str) -> Give:
        async def give(request: Any, gid: bytes) -> None:
            await self.begin(verb, VERBS[verb].args(), gid)

        return give

    async def _arm(self, request: Any, gid: bytes) -> None:
        await self.begin(*(("arm", wire.Arm(ready_timeout=0.0)) if request.value else ("disarm", wire.Order())), gid)

    async def _takeoff(self, request: Any, gid: bytes) -> None:
        if request.latitude or request.longitude:
            raise BadInput.wrong("latitude", request.latitude, "0: it takes off where it is")
        altitude, state = finite("altitude", request.altitude), self._vehicle.state
        if state.autopilot == "px4":  # whose altitude of a takeoff is above the sea: so have MAVROS's scripts for it
            if state.position is None:
                raise Refused(f"{self._vehicle.name} has no position yet", vehicle=self._vehicle.name)
            altitude -= state.position.alt_amsl - state.position.alt_rel
        await self.begin("takeoff", wire.Takeoff(alt_rel=altitude), gid)

    async def _land(self, request: Any, gid: bytes) -> None:
        if request.latitude or request.longitude:
            raise BadInput.wrong("latitude", request.latitude, "0: it lands where it is")
        await self.begin("land", wire.Order(), gid)

    async def _set_mode(self, request: Any, gid: bytes) -> None:
        if not request.custom_mode:
            raise BadInput.wrong("custom_mode", request.custom_mode, "a mode's name: base modes are not taken")
        mode = request.custom_mode
        state = self._vehicle.last_state
        if state is not None and state.autopilot == "px4":
            mode = MODES.get(mode.upper(), mode)
        await self.begin("set_mode", wire.SetMode(mode=mode), gid)

    async def _goto(self, request: Any, gid: bytes) -> None:
        await self.begin("goto", place(request), gid)

    async def _lease(self, request: Any, gid: bytes) -> None:
        if request.take:
            await self._steering.take(gid, request.priority)
        else:
            await self._steering.give_back(gid)


def place(request: Any) -> wire.GoTo:
    """Where a GoTo of ours leads; raises :class:`BadInput`."""
    speed = finite("speed", request.speed) or None
    if request.global_frame:
        return wire.GoTo(
            frame="global",
            lat_deg=finite("latitude", request.latitude),
            lon_deg=finite("longitude", request.longitude),
            alt_rel=finite("altitude", request.altitude),
            speed=speed,
        )
    return wire.GoTo(pos=vector("position", request.position), speed=speed)


def vector(field: str, given: Any) -> wire.Vector:
    """North, east, down of ROS's east, north, up; raises :class:`BadInput` where a part is no number."""
    x, y, z = (finite(f"{field}.{axis}", getattr(given, axis)) for axis in "xyz")
    return frames.enu((x, y, z))


def finite(field: str, value: float) -> float:
    """Raises :class:`BadInput` for NaN and infinities."""
    if not math.isfinite(value):
        raise BadInput.wrong(field, value, "a number")
    return float(value)


def result_of(error: ZmavError) -> CommandResult:
    return next(result for kind, result in RESULTS if isinstance(error, kind))
