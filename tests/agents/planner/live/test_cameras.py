"""Who is asked for its camera before a survey."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from agents.planner.goals.steps import Fly, Pictures, PlanTo
from agents.planner.live.cameras import check_cameras
from agents.planner.live.leased_vehicles import LeasedVehicles


async def test_each_that_is_to_trigger_is_asked_and_nobody_who_was_lost() -> None:
    asked: list[tuple[str, str, float]] = []

    def vehicle(name: str) -> Any:
        async def order(verb: str, args: Any) -> None:
            asked.append((name, verb, args.distance))

        return SimpleNamespace(order=order)

    leased = cast("LeasedVehicles", SimpleNamespace(commands={"quad1": None, "quad3": None}, vehicle=vehicle))
    names, motion = ("quad1", "quad2", "quad3"), np.zeros((2, 4))
    pictures = {"quad1": Pictures(5.0, 0.0), "quad2": Pictures(5.0, 0.0), "quad3": Pictures(0.0, 0.0)}
    fly = Fly(dict.fromkeys(names, motion), pictures=pictures)
    await check_cameras(leased, [PlanTo(names, np.zeros((3, 3)), True), fly])
    assert asked == [("quad1", "camera_trigger", 0.0)]
