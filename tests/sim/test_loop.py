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
from zmav.mavlink.codec import Packer
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

    def __init__(self, clock: Callable[[], float] = time.monotonic, tick_s: float = 0.01) -> None:
        self.ticks = 0

        def status() -> WorldStatus:
            raise NotImplementedError

        self.pacer = pacer = Pacer(tick_s, 1.0, clock)
        self.loop = Loop(self._tick, lambda: self.ticks * tick_s, status, pacer, Externals(), None, lambda: 4)

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


def watch(pacer: Pacer, waits: Callable[[int], object]) -> None:
    """Tell ``waits`` how many ticks may come late, whenever the loop asks for how long it may listen."""
    before = pacer.wait_s

    def wait_s(late: int = 0) -> float:
        waits(late)
        return before(late)

    pacer.wait_s = wait_s  # type: ignore[method-assign]


@pytest.mark.parametrize("tick_hz", [100, 300, 1000])
def test_no_tick_of_a_thinking_period_waits_after_somebody_spoke(tick_hz: int) -> None:
    """However often the world ticks: autopilots think each 0.02 s, or more often."""
    patient, late_ones = Patient(tick_s=1.0 / tick_hz), set[int]()
    watch(patient.pacer, lambda late: late_ones.add(patient.ticks) if late else None)
    patient.loop.start()
    patient.reach(tick_hz // 10)

    def speak() -> int:
        late_ones.clear()
        return patient.ticks

    spoke = patient.loop.calls.call(speak)
    patient.reach(spoke + tick_hz // 10)
    patient.end()
    assert not late_ones & set(range(spoke, spoke + tick_hz // 50))
    assert late_ones & set(range(spoke, spoke + tick_hz // 10))


class Listener:
    """Who hears a vehicle, and has room for all it says."""

    def room(self) -> int:
        return 1 << 20

    def put(self, frame: bytes) -> None:
        pass


def test_ticks_that_send_a_list_do_not_wait_for_each_other() -> None:
    world = World(copters=1, endpoint="tcp:0")
    node = world.vehicles[0].node
    channel = node.open_channel(Listener())
    late_ones: dict[bool, list[int]] = {True: [], False: []}
    watch(world.pacer, lambda late: late_ones[channel.params_next is not None].append(late))
    request = Packer(node.dialect, 255, 190).pack("PARAM_REQUEST_LIST", target_system=node.sysid, target_component=1)
    with world:
        world.call(lambda: node.take(channel, request))
        world.wait_for(lambda: channel.params_next is None)
        world.wait_for(lambda: max(late_ones[False]) > 0)
    assert len(late_ones[True]) > 10
    assert max(late_ones[True]) == 0


def test_ticks_wait_for_each_other_beside_a_vehicle_that_hangs() -> None:
    """Nothing that it has to say is due, however long it has been."""
    world = World(copters=1, endpoint="tcp:0")
    node, late_ones = world.vehicles[0].node, list[int]()
    channel = node.open_channel(Listener())
    with world:
        world.fault("all", "frozen")
        world.wait_for(lambda: world.time_s > channel.streams.next_due + 1.0)
        watch(world.pacer, late_ones.append)
        world.wait_for(lambda: any(late_ones), 2.0)


def test_in_a_slow_world_no_tick_waits_for_another() -> None:
    """Its clients count by a real clock, and hear it each real second."""
    times = list[float]()
    world = World(copters=1, endpoint="tcp:0", speed=0.1)
    world.externals.grant = lambda now: times.append(time.monotonic())  # type: ignore[method-assign]
    with world:
        world.wait_for(lambda: len(times) > 15)
    assert statistics.quantiles([b - a for a, b in pairwise(times)], n=4)[2] < 0.3
