"""Nobody flies without a request that still counts: requests that meet, end early or come too late."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING

import pytest

from zmav import wire
from zmav.errors import Refused

if TYPE_CHECKING:
    from agents.controllers.supervisor import Supervisor
    from tests.agents.controllers.conftest import Field

pytestmark = pytest.mark.asyncio(loop_scope="module")


class Gate:
    """Where requests to take over wait, in place of the autopilot's parameters being read."""

    def __init__(self, supervisor: Supervisor, monkeypatch: pytest.MonkeyPatch) -> None:
        self.waiting, self.open = 0, asyncio.Event()
        monkeypatch.setattr(supervisor, "_check_parameters", self)

    async def __call__(self) -> None:
        self.waiting += 1
        await self.open.wait()


async def test_a_request_that_was_released_before_it_took_over_counts_no_more(
    field: Field, monkeypatch: pytest.MonkeyPatch
) -> None:
    supervisor = await field.supervise("ev1-attitude")
    gate = Gate(supervisor, monkeypatch)
    asked = asyncio.create_task(field.vehicle.tell("ev1-attitude", "engage"))
    await field.until(lambda: gate.waiting == 1, "it does not ask for parameters")
    await field.vehicle.tell("ev1-attitude", "release")
    gate.open.set()
    with pytest.raises(Refused, match="ask again"):
        await asked
    assert supervisor.cycles.phase == 0
    assert supervisor.idle
    # Nor does what the pilot's switch has come between.
    gate.open.clear()
    asked = asyncio.create_task(field.vehicle.tell("ev1-attitude", "engage"))
    await field.until(lambda: gate.waiting == 2, "it does not ask for parameters")
    pilot = field.world.vehicles[0].px4.pilot
    pilot.flip(7, 1900)
    await field.vehicle.wait_until(lambda s: s.pilot is not None, 30.0)
    await field.until(lambda: supervisor.pilot_at != "", "it does not hear of the switch")
    pilot.flip(7, 1000)
    await field.vehicle.wait_until(lambda s: s.pilot is None, 30.0)
    gate.open.set()
    with pytest.raises(Refused, match="ask again"):
        await asked
    assert supervisor.idle


async def test_of_two_requests_at_once_one_flies_and_can_be_released(
    field: Field, monkeypatch: pytest.MonkeyPatch
) -> None:
    supervisor = await field.supervise("ev1-attitude")
    gate = Gate(supervisor, monkeypatch)
    asked = [asyncio.create_task(field.vehicle.tell("ev1-attitude", "engage")) for _ in range(2)]
    await field.until(lambda: gate.waiting == 2, "they do not ask for parameters")
    gate.open.set()
    first, second = await asyncio.gather(*asked, return_exceptions=True)
    assert {isinstance(first, Refused), isinstance(second, Refused)} == {True, False}, (first, second)
    assert supervisor.cycles.phase == 1
    assert field.mode == "OFFBOARD"
    await field.vehicle.tell("ev1-attitude", "release")
    assert field.mode == "HOLD"
    await field.vehicle.wait_until(lambda s: s.lease is None, 30.0)
    await field.vehicle.tell("ev1-attitude", "engage")
    assert field.mode == "OFFBOARD"


async def test_a_request_while_it_hands_back_or_ends_is_refused(field: Field, monkeypatch: pytest.MonkeyPatch) -> None:
    supervisor = await field.supervise("ev1-attitude")
    await field.vehicle.tell("ev1-attitude", "engage")
    held, asked = asyncio.Event(), asyncio.Event()

    async def slowly() -> None:
        asked.set()
        await held.wait()

    monkeypatch.setattr(supervisor.vehicle, "hold", slowly)
    releasing = asyncio.create_task(field.vehicle.tell("ev1-attitude", "release"))
    await asked.wait()
    with pytest.raises(Refused, match="handing back"):
        await field.vehicle.tell("ev1-attitude", "engage")
    held.set()
    await releasing
    supervisor._ending = True
    with pytest.raises(Refused, match="ends"):
        await field.vehicle.tell("ev1-attitude", "engage")


async def test_a_vehicles_agent_that_begins_again_turns_no_switch(field: Field) -> None:
    supervisor = await field.supervise("ev1-attitude")
    state = wire.VehicleState(t=0.0, fleet="demo", name="hex1", instance="one", pilot="his switch")
    away = wire.VehicleState(t=0.0, fleet="demo", name="hex1", instance="one")
    again = wire.VehicleState(t=0.0, fleet="demo", name="hex1", instance="two")
    assert [supervisor.turned_away(each) for each in (away, state, away, away)] == [False, False, True, False]
    assert [supervisor.turned_away(each) for each in (state, again, away)] == [False, False, False]


async def test_a_process_that_was_replaced_for_a_request_is_not_replaced_in_flight(field: Field) -> None:
    supervisor = await field.supervise("ev1-attitude")
    assert supervisor.reloader.worker is not None
    supervisor.reloader.worker.kill()
    assert not supervisor.reloader.worker.alive  # though it may take a moment to be gone: nobody is to fly by it
    supervisor.reloader.worker.process.wait()
    await field.vehicle.tell("ev1-attitude", "engage")
    flies = supervisor.reloader.worker
    assert supervisor._replacing is not None
    await supervisor._replacing
    assert supervisor.reloader.worker is flies
    assert supervisor.cycles.phase == 1


async def test_a_take_over_that_came_to_nothing_says_how_long_the_way_back_took(
    field: Field, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From when it was given up, and not from some engagement before."""
    supervisor = await field.supervise("ev1-attitude")

    async def refused(lease: object) -> bool:
        supervisor.why = "OFFBOARD did not come"
        return False

    monkeypatch.setattr(supervisor, "_take_over", refused)
    begun = time.monotonic()
    with pytest.raises(Refused, match="OFFBOARD did not come"):
        await field.vehicle.tell("ev1-attitude", "engage")
    await field.until(lambda: supervisor.handed_back_ms is not None, "no word of it")
    assert supervisor.handed_back_ms is not None
    assert 0.0 <= supervisor.handed_back_ms / 1e3 <= time.monotonic() - begun
