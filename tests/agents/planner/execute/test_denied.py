"""A lease that ended is asked for again: for ever where the network is silent, not where the vehicle denies it."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator
from types import SimpleNamespace
from typing import cast

import pytest

import zmav
from agents.planner.execute.offset import Offset
from agents.planner.execute.vehicle_command import DENIED_FOR, Clock, VehicleCommand
from tests.waiting import until
from zmav.errors import Forbidden, NotHolder, Refused, TimedOut, ZmavError


class Denying(Clock):
    """A client and its vehicle, whose first lease has expired; it is ten seconds later each time one is asked for."""

    fleet = fleet_name = "demo"
    last_state = None

    def __init__(self, error: ZmavError) -> None:
        self._error, self.asked = error, 0

    def now(self) -> float:
        return 10.0 * self.asked

    def vehicle(self, name: str) -> Denying:
        return self

    def heard(self, name: str, fleet: str) -> None:
        return None

    async def ask(self, *what: object, **more: object) -> list[object]:
        return []

    @contextlib.asynccontextmanager
    async def lease(self, holder: str, ttl: float) -> AsyncIterator[SimpleNamespace]:
        self.asked += 1
        if self.asked > 1:
            raise self._error
        yield SimpleNamespace(number=1, lost=NotHolder("it was not renewed", reason="expired"))


@pytest.mark.parametrize(
    ("error", "taken"),
    [
        (Forbidden("a lease is a planner's", reason="role"), "a lease is a planner's"),
        (Refused("the pilot's switch says that he has it"), "the pilot's switch says that he has it"),
        (TimedOut("no answer"), ""),
    ],
)
async def test_a_vehicle_that_denies_its_lease_is_given_up_and_one_that_is_silent_is_not(
    error: ZmavError, taken: str
) -> None:
    denying, offset = Denying(error), Offset()
    offset.answered(0.0, 0.0, 0.0)
    async with VehicleCommand(cast("zmav.Client", denying), "quad1", denying, "planner", offset) as command:
        await until(lambda: command.taken or denying.now() > 2.0 * DENIED_FOR)
        assert command.taken == taken
