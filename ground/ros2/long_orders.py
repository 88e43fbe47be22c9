"""A vehicle's long orders as actions: takeoff, goto, land.

A goal that is cancelled has the vehicle hold: what it does must not go on behind the back of who cancelled. (A landing
that is cancelled ends in a hold, too.)
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from ground.ros2.actions import Action, Feedback, Log
from ground.ros2.node import RosNode
from ground.ros2.orders import finite, place
from ground.ros2.steering import Steering
from zmav import wire
from zmav.errors import ZmavError
from zmav.vehicle import Vehicle
from zmav.waiting import within

HOLDS, OVERTAKEN = 5, 1.0
"""times that a vehicle is told to hold, and s between two, while the order that is cancelled has not ended"""
Order = Callable[[Any], tuple[str, wire.Order]]
"""verb and arguments of a goal; raises :class:`~zmav.errors.BadInput`"""


class LongOrder:
    """An order to a vehicle as a goal. ``shown``: what the vehicle calls its progress, and the field of the feedback
    that shows it.
    """

    def __init__(
        self, vehicle: Vehicle, steering: Steering, verb: str, args: wire.Order, shown: tuple[str, str]
    ) -> None:
        self._vehicle, self._steering, self._verb, self._args, self._shown = vehicle, steering, verb, args, shown
        self._over = asyncio.Event()

    async def run(self, feedback: Feedback) -> dict[str, Any]:
        theirs, ours = self._shown

        def on_progress(news: dict[str, Any]) -> None:
            if theirs in news:
                feedback(**{ours: float(news[theirs])})

        try:
            await self._vehicle.order(self._verb, self._args, on_progress)
        finally:
            self._over.set()
        return {}

    async def stop(self, gid: bytes) -> None:
        """Hold, at once. A cancel may overtake the order itself, which would then end the hold: it is told to hold
        again until the order has ended.
        """
        refused: ZmavError | None = None
        for _ in range(HOLDS):
            try:
                await self._vehicle.order("hold", wire.Order(lease=self._steering.token(gid)))
                refused = None
            except ZmavError as e:
                refused = e
            try:
                await within(OVERTAKEN, self._over.wait())
            except asyncio.TimeoutError:
                continue
            break
        if refused is not None and not self._over.is_set():
            raise refused


def long_orders(node: RosNode, vehicle: Vehicle, steering: Steering, log: Log) -> list[Action]:
    """Those of one vehicle."""
    table: tuple[tuple[str, str, Order, tuple[str, str]], ...] = (
        ("takeoff", "Takeoff", _takeoff, ("alt_rel", "altitude")),
        ("goto", "GoTo", lambda goal: ("goto", place(goal)), ("away", "distance")),
        ("land", "Land", _land, ("alt_rel", "altitude")),
    )

    def beginning(order: Order, shown: tuple[str, str]) -> Callable[[Any, bytes], LongOrder]:
        def begin(goal: Any, gid: bytes) -> LongOrder:
            steering.check()
            verb, args = order(goal)
            args.lease = steering.token(gid)
            return LongOrder(vehicle, steering, verb, args, shown)

        return begin

    return [
        Action(node, name, f"zmav_msgs/action/{kind}", beginning(order, shown), log)
        for name, kind, order, shown in table
    ]


def _takeoff(goal: Any) -> tuple[str, wire.Order]:
    return "takeoff", wire.Takeoff(alt_rel=finite("altitude", goal.altitude))


def _land(goal: Any) -> tuple[str, wire.Order]:
    return "rtl" if goal.return_first else "land", wire.Order()
