"""Which stream is sent, and that a budget does not fall for the time that sending takes."""

from __future__ import annotations

from agents.camera.budget import Budget
from agents.camera.rungs import FIRST_WAIT, LONGEST_WAIT, SHORT_S, Rungs
from agents.camera.settings import CameraSettings
from zmav.wire import FrameReport


class TestRungs:
    """Which stream is sent."""

    def test_the_richest_that_fits(self) -> None:
        rungs = Rungs(2, 0.0)
        assert not rungs.choose(1e5, 1e5, 0.0)
        assert not rungs.choose(5e4, 1e5, 1.0), "a moment is no reason"
        assert rungs.choose(5e4, 1e5, 1.0 + SHORT_S)
        assert (rungs.at, rungs.key_only) == (1, False)
        assert not rungs.choose(5e4, 4e4, 5.0)

    def test_key_frames_at_the_end_and_the_way_back(self) -> None:
        rungs, now = Rungs(1, 0.0), 0.0
        while not rungs.choose(1e4, 1e5, now):
            now += 1.0
        assert rungs.key_only
        since, waits = now, list[float]()
        for _ in range(6):
            while not rungs.choose(1e4, 1e5, now):
                now += 1.0
            waits.append(now - since)
            while not rungs.choose(1e4, 1e5, now):
                now += 1.0
            since = now
        assert waits[0] >= FIRST_WAIT
        assert waits == sorted(waits), "what did not last is tried less and less often"
        assert waits[-1] <= LONGEST_WAIT + 2.0
        while not rungs.choose(2e5, 1e5, now):
            now += 1.0
        assert not rungs.key_only
        assert not any(rungs.choose(2e5, 1e5, now + s) for s in range(60))


def test_key_frames_that_take_long_to_send_are_no_sign_of_a_full_link() -> None:
    """After many small units only key frames are sent, each of which takes nearly a second by its own size."""
    budget, now = Budget(CameraSettings(vehicle="quad1", budget=20e3), reported=60), 0.0
    for seq in range(60):
        small = seq < 40
        took = 0.02 if small else 0.9
        now += 1.0 / 30.0 if small else 1.0
        budget.sent.add(seq, 700 if small else 18_000, 0.1, now)
        budget.sent.took(seq, took)
        if not small or seq % 15 == 14:
            whole = 15 if small else 1
            report = FrameReport(t=now, seq=seq, whole=whole, torn=0, delay=took + 0.05, rate_bytes=18e3)
            budget.report("page-1", report, now)
    assert budget.bytes >= 20e3
