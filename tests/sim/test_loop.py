"""Calls into a world from other threads, and who waits for its steps."""

from __future__ import annotations

import threading

import pytest

from zmav.errors import TimedOut
from zmav.sim import World

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
