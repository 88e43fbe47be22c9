"""Leases are given back when all rest, however often whoever flies is told to end."""

from __future__ import annotations

import asyncio
from typing import cast

import pytest

import zmav
from agents.planner.execute.conductor import Conductor, Phase
from agents.planner.execute.executor import TICK, Executor


class Moving:
    """One of no vehicle, of which nobody is at rest until that is said."""

    parts, said = (), []  # type: ignore[var-annotated]
    halting = ""
    now: Phase = "flying"

    def decide(self, now: float, most: int) -> list[object]:
        return []

    def phase(self, now: float) -> Phase:
        return self.now

    def halt(self, why: str) -> None:
        self.halting = why


async def test_who_is_cancelled_twice_still_waits_until_all_rest() -> None:
    executor, moving = Executor(cast("zmav.Client", None), ()), Moving()
    flying = asyncio.create_task(executor.follow(cast("Conductor", moving), lambda: True))
    await asyncio.sleep(TICK)
    for _ in range(3):
        flying.cancel()
        await asyncio.sleep(TICK)
        assert not flying.done(), "it gives leases back of vehicles that move"
    assert moving.halting
    moving.now = "halted"
    with pytest.raises(asyncio.CancelledError):
        await flying


@pytest.mark.parametrize("cancelled", [False, True])
async def test_a_fault_while_all_come_to_rest_is_raised_and_nothing_is_flown_any_more(cancelled: bool) -> None:
    class Broken(Moving):
        def decide(self, now: float, most: int) -> list[object]:
            if self.halting:
                if cancelled:
                    flying.cancel()
                raise RuntimeError("a fault of its own")
            return []

    executor = Executor(cast("zmav.Client", None), ())
    flying = asyncio.create_task(executor.follow(cast("Conductor", Broken()), lambda: False))
    with pytest.raises(RuntimeError, match="a fault of its own"):
        await flying
    assert executor.phase is None
