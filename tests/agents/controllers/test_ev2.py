"""EV2 in the air beside EV1 and the autopilot itself: the same gusts, noise and aggressive references."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numpy as np
import pytest

from agents.controllers import Controller, Reference
from agents.controllers.ev1 import Ev1
from agents.controllers.ev2 import Ev2
from tests.agents.controllers.flying import CYCLE, Cycles, Flight, Hexarotor, Log, ReferenceAt, circle, hover

BEGUN, SETTLED, END = 1.0, 5.0, 14.0  # s since the takeoff


def lemniscate(size: float = 4.0, speed: float = 3.5, height: float = 5.0, build_up: float = 2.0) -> ReferenceAt:
    """Gerono's figure of eight, ``size`` m to each side, that passes its middle at ``speed`` (m/s): x = a sin s,
    y = a sin s cos s. Velocity and acceleration are fed forward.
    """
    full = speed / (size * math.sqrt(2.0))

    def at(t: float) -> Reference:
        share = min(max(t / build_up, 0.0), 1.0)
        rate, spin = full * share * share * (3.0 - 2.0 * share), full * 6.0 * share * (1.0 - share) / build_up
        s = full * build_up * (share**3 - 0.5 * share**4) + full * max(t - build_up, 0.0)
        point = np.array([math.sin(s), 0.5 * math.sin(2.0 * s), 0.0])
        slope = np.array([math.cos(s), math.cos(2.0 * s), 0.0])
        bend = np.array([-math.sin(s), -2.0 * math.sin(2.0 * s), 0.0])
        pos = size * point - (0.0, 0.0, height)
        return Reference(pos=pos, vel=size * rate * slope, acc=size * (rate * rate * bend + spin * slope))

    return at


REFERENCES = {
    name: functools.lru_cache(maxsize=1)(at)  # all ways ask for the same moment
    for name, at in {"circle": circle(2.0, 3.0), "lemniscate": lemniscate()}.items()
}


def wrong(error: float) -> Ev2:
    """With an inertia that is off by that factor."""
    known = Ev2()
    return Ev2({f"inertia_{axis}": error * getattr(known, f"inertia_{axis}") for axis in "xyz"})


MAKE: dict[str, Callable[[], Controller] | None] = {
    "autopilot": None,
    "ev1": Ev1,
    "ev2": Ev2,
    "late 0.9": lambda: wrong(0.9),
    "late 1.1": lambda: wrong(1.1),
}
"""What flies, from a second after the takeoff on; ``late``: with three cycles of delay"""


@pytest.fixture(scope="module")
def flights() -> dict[str, dict[str, Log]]:
    """By the reference and by what flew, all at once."""

    def way(craft: Hexarotor, make: Callable[[], Controller] | None, reference: ReferenceAt) -> Cycles[Log]:
        controller = make() if make else None
        yield from craft.fly_autopilot(reference, BEGUN, controller)
        if controller is None:
            return (yield from craft.fly_autopilot(reference, END - BEGUN))
        return (yield from craft.fly(controller, reference, END - BEGUN))

    pairs = [(name, who) for name in REFERENCES for who in MAKE if name == "circle" or not who.startswith("late")]
    with Flight(wind=(4.0, 0.0, 0.0), gusts="light", noise="typical", seed=3, slow=10, ways=len(pairs)) as flight:
        for number, (_, who) in enumerate(pairs):
            flight[number].delay = 3 if who.startswith("late") else 1
        ways = [way(flight[number], MAKE[who], REFERENCES[name]) for number, (name, who) in enumerate(pairs)]
        logs = dict(zip(pairs, flight.together(ways), strict=True))
    return {name: {who: log for (of, who), log in logs.items() if of == name} for name in REFERENCES}


@pytest.mark.parametrize("name", list(REFERENCES))
def test_follows_closer_than_ev1_and_the_autopilot(flights: dict[str, dict[str, Log]], name: str) -> None:
    autopilot, ev1 = (flights[name][who].rms_position(SETTLED) for who in ("autopilot", "ev1"))
    log = flights[name]["ev2"]
    assert np.linalg.norm(log.ref_vel, axis=1).max() > 2.9, "the reference is the aggressive one"
    assert log.rms_position(SETTLED) < 0.7 * min(ev1, autopilot)


@pytest.mark.parametrize("error", [0.9, 1.1])
def test_bears_more_delay_and_a_wrong_inertia(flights: dict[str, dict[str, Log]], error: float) -> None:
    usual, late = flights["circle"]["ev2"], flights["circle"][f"late {error}"]
    assert late.rms_position(SETTLED) < 1.1 * usual.rms_position(SETTLED)
    # Close to the end of what a loop bears it shakes, long before its position tells.
    assert shaking(late) < 1.3 * shaking(usual)


def shaking(log: Log) -> float:
    """rad/s rms of what is quick in the rates: beside their mean over a tenth of a second."""
    window = round(0.1 / CYCLE)
    rows = log.rates[log.t >= SETTLED]
    slow = np.array([np.convolve(row, np.full(window, 1.0 / window), mode="same") for row in rows.T]).T
    return float(np.sqrt(((rows - slow)[window:-window] ** 2).sum(axis=1).mean()))


def test_takes_over_on_the_circle_without_a_jump() -> None:
    reference = REFERENCES["circle"]
    with Flight(wind=(4.0, 0.0, 0.0), gusts="light", noise="typical", seed=5, slow=10) as flight:
        for _ in range(6):
            ev2 = Ev2()
            before = flight.fly_autopilot(reference, 0.7, shadow=ev2)
            after = flight.fly(ev2, reference, 0.3)
            jump = np.abs(after.wrench[1:12] - before.wrench[-1]).max(axis=0)
            assert jump[0] < 0.1 * ev2.full, "N"
            assert jump[1:3].max() < 1.0 and jump[3] < 0.6, "N m"


def test_the_battery_is_found_out_at_hand_over() -> None:
    with Flight(noise="typical", coarse=True) as flight:
        ev2 = Ev2()
        flight.fly_autopilot(hover(), 3.0, shadow=ev2)
        log = flight.fly(ev2, hover(), 3.0)
        lift = float(flight.fleet.dynamics.thrust.sum())
    assert ev2.full * log.thrust[-1] == pytest.approx(lift, rel=0.04)
    assert np.abs(log.pos[:, 2] + 5.0).max() < 0.5
