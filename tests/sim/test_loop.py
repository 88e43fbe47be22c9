"""Calls into a world from other threads, and who waits for its steps."""

from __future__ import annotations

import selectors
import statistics
import threading
import time
from collections.abc import Callable
from itertools import pairwise

import pytest

from zmav.errors import TimedOut
from zmav.sim import World
from zmav.sim.clock import Pacer
from zmav.sim.external import Externals
from zmav.sim.loop import Loop
from zmav.sim.status import WorldStatus

PATIENCE_S = 20.0


def test_a_call_that_was_given_up_is_not_done_later() -> None:
    world = World(copters=1, endpoint="tcp:0")
    done: list[str] = []
    with pytest.raises(TimedOut, match="does not run"):
        world.call(lambda: done.append("late"), timeout=0.05)
    with world:
        world.call(lambda: done.append("now"))
    assert done == ["now"]


def test_a_failure_is_told_to_who_waits_for_steps() -> None:
    world = World(copters=1, endpoint="tcp:0", speed=1.0)

    def fail(now: float) -> None:
        raise RuntimeError("a defect")

    world.start()
    waiting = world.advance(1e5)
    world.externals.grant = fail  # type: ignore[method-assign]
    with pytest.raises(TimedOut, match="a defect"):
        waiting.result(PATIENCE_S)
    with pytest.raises(RuntimeError, match="a defect"):
        world.close()


def test_a_world_that_is_started_twice_runs_in_one_thread() -> None:
    others = set(threading.enumerate())
    with World(copters=1, endpoint="tcp:0") as world:
        world.start()
        assert [each.name for each in set(threading.enumerate()) - others] == ["zmav-sim"]
        world.call(lambda: None)


def test_who_runs_a_world_that_runs_waits_for_its_end() -> None:
    with World(copters=1, endpoint="tcp:0") as world:
        by: set[str] = set()

        def grant(now: float) -> None:
            by.add(threading.current_thread().name)
            world.stop()

        world.externals.grant = grant  # type: ignore[method-assign]
        world.run()
        assert by == {"zmav-sim"}


def test_a_world_that_another_thread_runs_gets_none_of_its_own() -> None:
    world = World(copters=1, endpoint="tcp:0")
    others = {*threading.enumerate(), running := threading.Thread(target=world.run, daemon=True)}
    running.start()
    world.wait_for(lambda: world.ticks > 0)
    world.start()
    assert set(threading.enumerate()) <= others
    world.stop()
    running.join()
    world.close()


class Patient:
    """A loop whose ticks may wait for four others, on a wall clock that the test may turn."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.ticks = 0

        def status() -> WorldStatus:
            raise NotImplementedError

        pacer = Pacer(0.01, 1.0, clock)
        self.loop = Loop(self._tick, lambda: self.ticks * 0.01, status, pacer, Externals(), None, lambda: 4)

    def _tick(self) -> None:
        self.ticks += 1

    def reach(self, ticks: int) -> None:
        with self.loop.ticked:
            assert self.loop.ticked.wait_for(lambda: self.ticks >= ticks, PATIENCE_S)

    def end(self) -> None:
        self.loop.stop()
        self.loop.join()
        self.loop.close()


def test_where_nobody_notices_one_wake_up_makes_several_ticks() -> None:
    patient, looks = Patient(), list[float | None]()

    def select(timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        looks.append(timeout)
        return before(timeout)

    before, patient.loop.selector.select = patient.loop.selector.select, select  # type: ignore[method-assign]
    patient.loop.start()
    patient.reach(100)
    patient.end()
    assert len(looks) < 50


def test_who_speaks_is_heard_after_the_ticks_that_were_due() -> None:
    now = 0.0
    patient = Patient(lambda: now)
    patient.loop.start()
    now = 0.035
    patient.reach(4)  # at the beginning nothing is late
    now = 0.075
    assert patient.loop.calls.call(lambda: patient.ticks) == 8
    patient.end()


def test_in_a_slow_world_no_tick_waits_for_another() -> None:
    """Its clients count by a real clock, and hear it each real second."""
    times = list[float]()
    world = World(copters=1, endpoint="tcp:0", speed=0.1)
    world.externals.grant = lambda now: times.append(time.monotonic())  # type: ignore[method-assign]
    with world:
        world.wait_for(lambda: len(times) > 15)
    assert statistics.quantiles([b - a for a, b in pairwise(times)], n=4)[2] < 0.3
