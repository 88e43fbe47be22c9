"""The loops above a controller: what it is handed, what is refused, and that all of it can be tuned and watched."""

from __future__ import annotations

import copy
import math

import numpy as np
import pytest

from agents.controllers import (
    AttitudeThrust,
    Controller,
    Level,
    Output,
    RatesThrust,
    Reference,
    State,
    TorqueThrust,
    Trim,
    Velocity,
    parameter,
)
from agents.controllers.ev1 import Ev1, Ev1Attitude, Ev1Rates, Ev1Velocity
from agents.controllers.stack import Stack
from agents.controllers.types import LEVELS
from zmav.errors import BadInput

LEAN = np.array([math.cos(0.1), math.sin(0.1), 0.0, 0.0])


class Seen(Controller):
    """Remembers what it was handed."""

    gain = parameter(1.0, 0.0, 2.0, "1/s", "of nothing")

    def __init__(self) -> None:
        super().__init__()
        self.resets: list[Reference] = []
        self.updates: list[Reference] = []

    def reset(self, state: State, reference: Reference, trim: Trim) -> None:
        self.resets.append(reference)

    def update(self, state: State, reference: Reference) -> Output:
        self.updates.append(reference)
        self.signal(mine=1.0)
        return TorqueThrust(np.zeros(3), reference.thrust)


class SeesPosition(Seen):
    level = "position"


class SeesVelocity(Seen):
    level = "velocity"


class SeesAltitude(Seen):
    level = "altitude"


class SeesAttitude(Seen):
    level = "attitude"


class SeesRates(Seen):
    level = "rates"


KINDS: dict[Level, type[Seen]] = {
    "position": SeesPosition,
    "velocity": SeesVelocity,
    "altitude": SeesAltitude,
    "attitude": SeesAttitude,
    "rates": SeesRates,
}


def full(level: Level) -> Reference:
    return Reference(
        level,
        pos=np.array([1.0, 2.0, -4.0]),
        vel=np.array([0.3, 0.2, -0.1]),
        acc=np.array([0.5, 0.0, 0.0]),
        yaw=0.4,
        yaw_rate=0.2,
        attitude=LEAN,
        rates=np.array([0.1, 0.2, 0.3]),
        thrust=0.45,
    )


def run(controller: Level, reference: Level) -> tuple[Seen, Stack]:
    mine = KINDS[controller]()
    stack = Stack(mine)
    stack.reset(State(), full(reference), Trim(0.6, LEAN, np.array([0.4, 0.5, 0.6])))
    stack.update(State(t=0.004), full(reference))
    return mine, stack


@pytest.mark.parametrize("own", LEVELS)
@pytest.mark.parametrize("given", LEVELS)
def test_every_outer_level_ends_in_the_controllers_own_and_the_inner_ones_are_refused(own: Level, given: Level) -> None:
    if LEVELS.index(given) > LEVELS.index(own):
        for call in (lambda: run(own, given), lambda: Stack(KINDS[own]()).update(State(), full(given))):
            with pytest.raises(BadInput, match=f"{own} on, a reference of {given} is inside") as caught:
                call()
            assert caught.value.detail["field"] == "level"
        return
    mine, _ = run(own, given)
    (reset,), (update,) = mine.resets, mine.updates
    assert reset.level == update.level == own


def test_at_its_own_level_it_gets_the_reference_as_it_is() -> None:
    for level in LEVELS:
        mine, stack = run(level, level)
        for name, value in vars(full(level)).items():
            assert np.array_equal(getattr(mine.updates[0], name), value)
        assert list(stack.signals) == ["mine"]


def test_each_loop_fills_in_what_the_next_one_follows() -> None:
    velocity = run("velocity", "position")[0].updates[0]
    assert velocity.vel == pytest.approx([0.3 + 0.95, 0.2 + 2 * 0.95, -3.0]), "the climb is limited"
    assert velocity.acc[0] == 0.5 and velocity.yaw == 0.4
    _, stack = run("attitude", "position")
    for k in range(2, 600):  # until what the autopilot asked for has faded out
        stack.update(State(t=0.004 * k), full("position"))
    attitude = stack.controller.updates[-1]  # type: ignore[attr-defined]
    assert State(q=attitude.attitude).yaw == pytest.approx(0.4, abs=0.01)
    assert attitude.attitude @ attitude.attitude == pytest.approx(1.0)
    assert State(q=attitude.attitude).rotation[0, 2] < -0.1 and attitude.yaw_rate == 0.2, "it leans to the north"
    mine = SeesRates()
    Stack(mine).update(State(), full("attitude"))
    rates = mine.updates[0]
    assert rates.thrust == 0.45 and rates.rates[0] == pytest.approx(6.5 * 2.0 * math.sin(0.1))


def test_an_altitudes_controller_gets_the_height_as_it_was_asked_for() -> None:
    """Its own P is on the height: the position loop's must not be in the climb already."""
    mine = run("altitude", "position")[0].updates[0]
    assert mine.pos.tolist() == [1.0, 2.0, -4.0] and mine.vel.tolist() == [0.3, 0.2, -0.1]
    assert np.allclose(mine.attitude, run("attitude", "position")[0].updates[0].attitude)
    without = run("altitude", "velocity")[0].updates[0]
    assert without.pos.tolist() == [0.0, 0.0, 0.0], "of velocities there is no height to hold"
    given = run("altitude", "altitude")[0].updates[0]
    assert np.array_equal(given.attitude, LEAN) and given.pos[2] == -4.0


def test_an_altitude_reference_goes_past_the_velocity_to_the_inner_loops() -> None:
    mine, stack = run("rates", "altitude")
    ran = {name.split(".")[0] for name in stack.signals if "." in name}
    assert ran == {"altitude", "attitude"}
    assert mine.updates[0].thrust == pytest.approx(0.6, abs=0.05)


def test_a_reset_hands_on_what_the_autopilot_asks_for() -> None:
    assert np.array_equal(run("attitude", "position")[0].resets[0].attitude, LEAN)
    inner = run("rates", "position")[0].resets[0]
    assert inner.rates.tolist() == [0.4, 0.5, 0.6] and inner.thrust == 0.6


def test_the_first_output_is_what_the_autopilot_asked_for() -> None:
    trim = Trim(0.6, LEAN, np.array([0.4, 0.5, 0.6]))
    state = State(t=1.0, q=LEAN, vel=np.array([1.0, -2.0, 0.5]))
    velocity, attitude = Stack(Ev1Velocity()), Stack(Ev1Attitude())
    for k in range(100):
        now = State(**{**vars(state), "t": 1.0 + 0.004 * k})
        velocity.reset(now, full("position"), trim)
        attitude.reset(now, full("position"), trim)
    now = State(**{**vars(state), "t": 1.4})
    lean = velocity.update(now, full("position"))
    assert isinstance(lean, AttitudeThrust) and lean.thrust == pytest.approx(0.6, abs=1e-3)
    assert lean.attitude == pytest.approx(LEAN, abs=1e-3)
    turn = attitude.update(now, full("position"))
    assert isinstance(turn, RatesThrust) and turn.rates == pytest.approx([0.4, 0.5, 0.6], abs=0.01)


class TestTuning:
    def test_the_loops_above_are_tuned_by_their_names(self) -> None:
        mine = SeesRates()
        stack = Stack(mine)
        assert {"gain", "position.kp", "velocity.kp_z", "altitude.kp", "attitude.yaw_weight"} <= set(stack.tunables)
        stack.tune("position.kp", 2.0)
        stack.tune("gain", 0.5)
        assert mine.gain == 0.5
        moved = Stack(Ev1Velocity())
        assert "velocity.kp" not in moved.tunables and "kp" in moved.tunables
        stack.update(State(), full("position"))
        assert stack.signals["position.vel.x"] == pytest.approx(0.3 + 2.0)

    @pytest.mark.parametrize(
        "name, value",
        [("nothing", 1.0), ("position.nothing", 1.0), ("altitude.kp", 99.0), ("gain", -1.0), ("gain", math.nan)],
    )
    def test_what_is_unknown_or_out_of_bounds_is_refused_and_changes_nothing(self, name: str, value: float) -> None:
        stack = Stack(SeesRates())
        with pytest.raises(BadInput):
            stack.tune(name, value)
        assert stack.controller.gain == 1.0  # type: ignore[attr-defined]

    def test_ev1_whole_has_all_loops_under_their_names(self) -> None:
        stack = Stack(Ev1())
        assert {"position.kp", "velocity.ki", "attitude.kp_yaw", "kd_roll"} <= set(stack.tunables)
        stack.reset(State(), full("position"), Trim())
        stack.tune("position.kp", 0.0)
        stack.update(State(), full("position"))
        assert stack.signals["position.vel.x"] == 0.3
        assert {"velocity.integral.z", "attitude.error.x", "integral.x"} <= set(stack.signals)
        with pytest.raises(BadInput):
            stack.tune("thrust.kp", 1.0)
        with pytest.raises(BadInput):
            Ev1({"kp_roll": 9.0})
        slack, whole = Stack(Ev1({f"{gain}_yaw": 0.0 for gain in ("kp", "ki")})), Stack(Ev1())
        state = State(rates=np.array([0.1, 0.2, 0.3]))
        torques = []
        for each in (slack, whole):
            each.reset(State(), full("position"), Trim())
            output = each.update(state, full("position"))
            assert isinstance(output, TorqueThrust)
            torques.append(output.torque)
        assert torques[0][2] == 0.0 and torques[1][2] < -0.05 and torques[0][:2].tolist() == torques[1][:2].tolist()


def test_a_copy_flies_on_by_itself() -> None:
    stack = Stack(Ev1Rates())
    stack.reset(State(), full("position"), Trim())
    twin = copy.deepcopy(stack)
    for k in range(50):
        twin.update(State(t=k * 0.004), full("position"))
    alone = Stack(Ev1Rates())
    alone.reset(State(), full("position"), Trim())
    ours, theirs = stack.update(State(), full("position")), alone.update(State(), full("position"))
    assert isinstance(ours, TorqueThrust) and isinstance(theirs, TorqueThrust)
    assert np.array_equal(ours.torque, theirs.torque)


def test_a_velocity_is_no_end_of_a_stack() -> None:
    """What a class gives is not followed by loops of ours: those below stay with the autopilot."""

    class Steers(Controller):
        level = "position"

        def update(self, state: State, reference: Reference) -> Output:
            return Velocity(reference.vel)

    output = Stack(Steers()).update(State(), full("position"))
    assert isinstance(output, Velocity) and output.vel.tolist() == [0.3, 0.2, -0.1]
