"""How long each vehicle of a goal is in the air for it, and how far it flies: step by step, from a plan where there is
one, else from straight lines.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from agents.planner.goals import slots
from agents.planner.goals.curves import lengths_of
from agents.planner.goals.steps import FleetView, Fly, Loiter, Orders, PlanTo, Step, VehicleOrder, VehicleView
from agents.planner.live.frames import enu
from agents.planner.model.problem import Floats, Motion

DETOUR = 1.15
"""times the straight line that a way is taken to be, before there is a plan for it"""
AROUND_S = 4.0
"""s about a plan in which vehicles wait in the air: it is made, all are told, and all say that they are there"""
SPOOL_S = 7.0
"""s of arming and spinning up before a takeoff, and of its end"""
SLOW_M, SLOW = 10.0, 0.5
"""m above the ground from which on a landing is slow, and m/s then: ArduCopter's own figures, and near PX4's"""
TOUCH_S = 5.0
"""s until a landed vehicle has found that out"""


@dataclass
class Part:
    """One vehicle's."""

    place: Floats
    """(3,) ENU, where it is by then"""
    flies: bool
    seconds: float = 0.0
    """in the air"""
    metres: float = 0.0


class Tally:
    """Of one goal. ``view``: the fleet as it begins."""

    def __init__(self, names: tuple[str, ...] | list[str], view: FleetView) -> None:
        self._view = view
        self.parts = {
            name: Part(np.array(enu(view.vehicles[name].pos_ned)), view.vehicles[name].airborne) for name in names
        }
        self.seconds = 0.0
        """that the whole goal takes"""

    def add(self, step: Step, planned: Mapping[str, Motion] | None = None) -> float:
        """One more step, by its plan where there is one; gives the s that it takes."""
        if planned is None and isinstance(step, Fly):
            planned = step.motions
        if planned is not None:
            seconds = AROUND_S + max((float(motion[-1, 0]) for motion in planned.values()), default=0.0)
            self._stay(seconds)
            for name, motion in planned.items():
                self.parts[name].metres += float(lengths_of(motion[:, 1:4])[-1])
                self.parts[name].place = motion[-1, 1:4]
        elif isinstance(step, PlanTo):
            seconds = self._straight(step)
        elif isinstance(step, Orders):
            seconds = self._orders(step)
        elif isinstance(step, Loiter):
            ends = {circle.vehicle: np.array(enu(circle.centre_ned)) for circle in step.circles}
            seconds = self._to(ends)
        else:
            seconds = 0.0
        self.seconds += seconds
        return seconds

    def home(self, name: str) -> tuple[float, float]:
        """s in the air and m from where the goal leaves it to its home, and down; nothing for who is down."""
        part, view = self.parts[name], self._view.vehicles[name]
        if not part.flies or not view.flies:
            return 0.0, 0.0
        home = part.place if view.home_ned is None else np.array(enu(view.home_ned))
        way = float(np.linalg.norm(home[:2] - part.place[:2]))
        down = max(0.0, float(part.place[2]) + view.floor)
        return way / view.body.speed + view.body.speed / view.accel + landing(down, view), way + down

    def _stay(self, seconds: float) -> None:
        for part in self.parts.values():
            part.seconds += seconds if part.flies else 0.0

    def _straight(self, step: PlanTo) -> float:
        """To its places, each by whom it would be given to."""
        views = [self._view.vehicles[name] for name in step.vehicles]
        order = list(range(len(views))) if step.labelled else slots.choose(views, step.places)
        return self._to({view.name: step.places[k] for view, k in zip(views, order, strict=True)})

    def _to(self, ends: Mapping[str, Floats]) -> float:
        """All the way there, one clock for all."""
        took = 0.0
        for name, end in ends.items():
            part, body = self.parts[name], self._view.vehicles[name].body
            move = end - part.place
            way, rise = DETOUR * float(np.linalg.norm(move[:2])), float(move[2])
            upward = abs(rise) / (body.climb if rise > 0.0 else body.descend)
            took = max(took, max(way / body.speed, upward) + body.speed / self._view.vehicles[name].accel)
            part.metres += math.hypot(way, rise)
            part.place = end
        self._stay(AROUND_S + took)
        return AROUND_S + took

    def _orders(self, step: Orders) -> float:
        """Each begins once those before it are done; who is in the air meanwhile waits there."""
        begins, ends = list[float](), list[float]()
        for order in step.orders:
            if order.vehicle not in self.parts:  # somebody who is lost, and whose landing is an order all the same
                begins.append(0.0)
                ends.append(0.0)
                continue
            view, part = self._view.vehicles[order.vehicle], self.parts[order.vehicle]
            begins.append(max((ends[before] for before in order.after), default=0.0))
            ends.append(begins[-1] + order_seconds(order, view, part))
        whole = max(ends, default=0.0)
        last = {order.vehicle: i for i, order in enumerate(step.orders)}
        for name, part in self.parts.items():
            if name not in last:
                part.seconds += whole if part.flies else 0.0
                continue
            order, view = step.orders[last[name]], self._view.vehicles[name]
            ground = -view.floor
            if order.verb == "takeoff":
                top = ground + float(order.args.get("alt_rel", 0.0))
                part.seconds += whole - begins[last[name]]
                part.metres += abs(top - float(part.place[2]))
                part.place, part.flies = np.array([*part.place[:2], top]), True
            elif order.verb == "land":
                part.seconds += ends[last[name]] if part.flies else 0.0
                part.metres += max(0.0, float(part.place[2]) - ground) if part.flies else 0.0
                part.place, part.flies = np.array([*part.place[:2], ground]), False
        return whole


def order_seconds(order: VehicleOrder, view: VehicleView, part: Part) -> float:
    """s from its being given to its end."""
    if order.verb == "takeoff":
        return SPOOL_S + float(order.args.get("alt_rel", 0.0)) / view.body.climb
    if order.verb == "land" and part.flies:
        return landing(max(0.0, float(part.place[2]) + view.floor), view)
    return TOUCH_S


def landing(height: float, view: VehicleView) -> float:
    """s from a hover so many m above the ground until it says that it stands there."""
    slow = min(height, SLOW_M)
    return slow / SLOW + (height - slow) / view.body.descend + TOUCH_S
