"""Orders that vehicles carry out by themselves: what a moment's silence of an autopilot means."""

from __future__ import annotations

from typing import Any, cast

import pytest

import zmav
from agents.planner.live.orders import land
from zmav import wire
from zmav.errors import Refused, Stale, ZmavError


class Lander:
    """A vehicle that answers each order by the next of these errors, and does it once there are no more."""

    def __init__(self, *errors: ZmavError) -> None:
        self.errors, self.orders = list(errors), list[tuple[str, wire.Order]]()

    async def order(self, verb: str, args: wire.Order) -> dict[str, Any]:
        self.orders.append((verb, args))
        if self.errors:
            raise self.errors.pop(0)
        return {"armed": False}


async def test_a_landing_goes_on_while_the_autopilot_is_silent_for_a_moment() -> None:
    lander = Lander(Stale("the autopilot is silent"), Stale("the autopilot is silent"))
    await land(cast(zmav.Vehicle, lander), {})
    assert [verb for verb, _ in lander.orders] == ["land"] * 3


async def test_a_landing_fails_where_the_autopilot_stays_silent_or_refuses() -> None:
    lander = Lander(*(Stale("the autopilot is silent") for _ in range(9)))
    with pytest.raises(Stale, match="silent"):
        await land(cast(zmav.Vehicle, lander), {}, again=3)
    assert len(lander.orders) == 4
    lander = Lander(Refused("no"))
    with pytest.raises(Refused):
        await land(cast(zmav.Vehicle, lander), {})
    assert len(lander.orders) == 1
