"""EV1 beside the autopilot's own loops: the same aggressive flight, wind, noise and seed, each loop alone and all of
them, with one cycle between a state and what comes of it.

The first seconds the autopilot flies, with the controller looking on; then that takes over at full speed in the turn.
"""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest

from agents.controllers import Array, Controller, Reference, State
from agents.controllers.ev1 import Ev1, Ev1Altitude, Ev1Attitude, Ev1Position, Ev1Velocity
from agents.controllers.stack import Stack
from tests.agents.controllers.flying import CYCLE, Cycles, Flight, Hexarotor, Log, circle, steps

KINDS: tuple[type[Controller], ...] = (Ev1, Ev1Attitude, Ev1Altitude, Ev1Velocity, Ev1Position)
TAKEN_OVER, TURNED, JUMP, END = 4.0, 9.0, 10.0, 16.5
HAND_OVER = round(0.1 / CYCLE)
"""cycles in which a jump would show: PX4's outer loops look at a setpoint every 20 ms"""


@functools.lru_cache(maxsize=1)  # all ways ask for the same moment
def reference(t: float) -> Reference:
    """A circle of 2 m at 2.5 m/s, and jumps of 2 m to the north, the east and up."""
    return circle(2.0, 2.5)(t) if t < TURNED else steps(every=2.5)(t - TURNED)


@pytest.fixture(scope="module")
def flights() -> dict[str, list[Log]]:
    """All flights, at once: the autopilot's own and each controller's after it has taken over, by the controller's
    name; ``jump``: taken over in the midst of a jump; ``back``: given back, and taken over again.
    """

    def own(craft: Hexarotor) -> Cycles[list[Log]]:
        return [(yield from craft.fly_autopilot(reference, END))]

    def taken_over(craft: Hexarotor, kind: type[Controller], moment: float, seconds: float) -> Cycles[list[Log]]:
        stack = Stack(kind())
        yield from craft.fly_autopilot(reference, moment, stack)
        return [(yield from craft.fly(stack, reference, seconds))]

    def back(craft: Hexarotor) -> Cycles[list[Log]]:
        stack = Stack(Ev1())
        yield from craft.fly_autopilot(reference, 3.0, stack)
        yield from craft.fly(stack, reference, 2.0)
        given_back = yield from craft.fly_autopilot(reference, 2.0, stack)
        return [given_back, (yield from craft.fly(stack, reference, 1.0))]

    names = ["autopilot", "jump", "back", *(kind.__name__ for kind in KINDS)]
    with Flight(wind=(4.0, 0.0, 0.0), gusts="light", noise="typical", seed=3, slow=10, ways=len(names)) as flight:
        ways = [own(flight[0]), taken_over(flight[1], Ev1, JUMP, 3.0), back(flight[2])]
        ways += [taken_over(flight[3 + k], kind, TAKEN_OVER, END - TAKEN_OVER) for k, kind in enumerate(KINDS)]
        return dict(zip(names, flight.together(ways), strict=True))


@pytest.fixture
def autopilot(flights: dict[str, list[Log]]) -> Log:
    """Its own flight."""
    return flights["autopilot"][0]


@pytest.fixture(params=KINDS, ids=lambda kind: kind.__name__)
def flown(request: pytest.FixtureRequest, flights: dict[str, list[Log]]) -> Log:
    return flights[request.param.__name__][0]


def rms(log: Log, begin: float, end: float) -> float:
    part = log.distance()[(log.t >= begin) & (log.t < end)]
    return math.sqrt(float((part**2).mean()))


def apart(one: Array, other: Array) -> Array:
    """(K,) rad between attitudes (K, 4)."""
    angle: Array = 2.0 * np.arccos(np.clip(np.abs((one * other).sum(axis=1)), 0.0, 1.0))
    return angle


def test_the_flight_is_an_aggressive_one(autopilot: Log) -> None:
    assert autopilot.lean().max() > math.radians(25.0) and np.abs(autopilot.ref_acc).max() > 3.0
    assert autopilot.motors.min() < 0.15 and autopilot.motors.max() > 0.95


def test_it_tracks_within_a_tenth_of_the_autopilots_own_error(flown: Log, autopilot: Log) -> None:
    for begin, end in ((TAKEN_OVER, TURNED), (TURNED, END)):
        assert rms(flown, begin, end) < 1.1 * rms(autopilot, begin, end)


def test_the_hand_over_is_no_jump(flown: Log, autopilot: Log) -> None:
    """Thrust and torques change from cycle to cycle hardly more than while the autopilot flies the turn; the attitude
    stays by that of its own flight.
    """
    turn = (autopilot.t > 2.0) & (autopilot.t < TAKEN_OVER)
    usual = np.abs(np.diff(autopilot.wrench[turn], axis=0)).max(axis=0)
    at_once = np.abs(np.diff(flown.wrench[:HAND_OVER], axis=0)).max(axis=0)
    assert (at_once < 1.5 * usual + [0.0, 0.0, 0.0, 0.005]).all()
    begin, second = round(TAKEN_OVER / CYCLE), round(1.0 / CYCLE)
    theirs = slice(begin, begin + second)
    assert apart(flown.q[:second], autopilot.q[theirs]).max() < math.radians(2.0)
    assert np.linalg.norm(flown.pos[:second] - autopilot.pos[theirs], axis=1).max() < 0.1


def test_the_outputs_are_those_of_the_level_that_it_says(flown: Log) -> None:
    kinds = {type(output).__name__ for output in flown.outputs}
    assert len(kinds) == 1
    assert kinds <= {"TorqueThrust", "RatesThrust", "AttitudeThrust", "Velocity"}
    assert all(np.isfinite(list(signals.values())).all() for signals in flown.signals)


def test_it_takes_over_in_the_midst_of_a_jump(flights: dict[str, list[Log]], autopilot: Log) -> None:
    """It leans and turns as the autopilot itself would."""
    (ours,) = flights["jump"]
    part = (autopilot.t >= JUMP) & (autopilot.t < JUMP + 3.0)
    assert ours.lean().max() < autopilot.lean()[part].max() + math.radians(3.0)
    assert np.abs(ours.rates).max() < 1.2 * np.abs(autopilot.rates[part]).max()
    assert np.abs(np.diff(ours.thrust[:HAND_OVER])).max() < 0.25
    assert ours.distance()[-1] < 2.0


def test_back_with_the_autopilot_it_flies_on(flights: dict[str, list[Log]]) -> None:
    back, again = flights["back"]
    assert back.lean().max() < math.radians(35.0) and again.lean().max() < math.radians(35.0)
    assert back.distance().max() < 1.5 and again.distance().max() < 1.5


def test_a_turning_nose_is_followed_closer_with_the_turn_fed_forward() -> None:
    """A heading that turns at 1 rad/s: the autopilot is told only the heading."""

    def turning(t: float) -> Reference:
        return Reference(pos=np.array([0.0, 0.0, -5.0]), yaw=math.remainder(t, math.tau), yaw_rate=1.0)

    def miss(log: Log) -> float:
        late = [
            math.remainder(State(q=q).yaw - each.yaw, math.tau)
            for t, q, each in zip(log.t, log.q, log.reference, strict=True)
            if t > 2.0
        ]
        return float(np.abs(late).mean())

    with Flight(ways=2, coarse=True) as flight:
        ways = [flight[0].fly_autopilot(turning, 4.0), flight[1].fly(Stack(Ev1()), turning, 4.0)]
        theirs, ours = flight.together(ways)
    assert miss(ours) < 0.5 * miss(theirs)
