"""The lock-step harness itself: exact, repeatable, and honest about whose output flies."""

from __future__ import annotations

import numpy as np

from agents.controllers import Output, RatesThrust, Reference, State, TorqueThrust, Trim
from tests.agents.controllers.flying import CYCLE, Flight, Log, circle, hover


class Fixed:
    """Gives one output always."""

    def __init__(self, output: Output) -> None:
        self.output = output

    def reset(self, state: State, reference: Reference, trim: Trim) -> None:
        self.trim = trim

    def update(self, state: State, reference: Reference) -> Output:
        return self.output


def flown(seed: int) -> Log:
    weather = {"wind": (4.0, 0.0, 0.0), "gusts": "light", "noise": "typical"}
    with Flight(**weather, seed=seed, height=1.0, coarse=True) as flight:  # type: ignore[arg-type]
        return flight.fly_autopilot(circle(2.0, 2.5, height=1.0), 0.5)


def test_the_same_seed_gives_the_same_flight() -> None:
    first, again, other = flown(3), flown(3), flown(4)
    assert (first.pos == again.pos).all() and (first.motors == again.motors).all()
    assert not np.allclose(first.pos, other.pos)


def test_the_circle_is_one_smooth_motion() -> None:
    at = circle(2.0, 2.5)
    times = np.arange(0.0, 8.0, 1e-3)
    points = [at(float(t)) for t in times]
    for value, rate in (("pos", "vel"), ("vel", "acc")):
        rows = np.array([getattr(each, value) for each in points])
        slope = np.array([getattr(each, rate) for each in points])
        assert np.allclose(np.diff(rows, axis=0) * 1e3, 0.5 * (slope[1:] + slope[:-1]), atol=1e-3)


def test_an_output_flies_after_its_delay() -> None:
    turn = Fixed(RatesThrust(np.array([0.0, 0.0, 1.0]), 0.55))
    with Flight(ways=2, delay=0) as flight:
        flight[1].delay = 5
        logs = flight.together([flight[way].fly(turn, hover(), 0.2) for way in range(2)])
    at_once, late = (float(log.t[np.abs(log.asked_rates[:, 2] - 1.0) < 1e-9][0] - log.t[0]) for log in logs)
    assert abs(late - at_once - 5 * CYCLE) <= 0.02 + 1e-9, "PX4's outer loops look every 20 ms"


def test_torque_turns_and_trim_hovers() -> None:
    with Flight() as flight:
        level = flight.fly_autopilot(hover(), 2.0)
        hold = flight.trim().thrust
        log = flight.fly(Fixed(TorqueThrust(np.array([0.0, 0.0, 0.05]), hold)), hover(), 1.0)
    assert np.abs(level.wrench[-1] - [9.81 * 3.2, 0.0, 0.0, 0.0]).max() < 1.0
    assert log.rates[-1, 2] > 0.3 and abs(log.vel[-1, 2]) < 0.5
