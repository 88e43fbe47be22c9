"""EV2 by its equations, on a rigid body: what backstepping proves, what the integrators are for, the hand-over."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from agents.controllers import Array, Reference, State, TorqueThrust, Trim
from agents.controllers.backstepping import Backstepping, Inner, Vec, angle_rates, rates_of
from agents.controllers.ev2 import Ev2
from tests.agents.controllers.rigid import CYCLE, GRAVITY, HOVER, Body, fly, quaternion, spin
from zmav.sim.control.allocation import Allocator
from zmav.sim.dynamics.airframe import AIR_DENSITY, airframe

HUGE = (1e9, 1e9, 1e9)
INNER = Inner((5.0, 5.0, 2.5), (0.8, 0.8, 0.5), (20.0, 20.0, 10.0), (0.043, 0.040, 0.069), HUGE, HUGE)


def three(row: Array) -> Vec:
    x, y, z = row.tolist()
    return x, y, z


def moving(t: float) -> tuple[Vec, Vec]:
    """Angles to follow, and their derivatives."""
    angles = (0.5 * math.sin(2.0 * t), 0.4 * math.sin(1.7 * t), 0.8 * t)
    return angles, (math.cos(2.0 * t), 0.68 * math.cos(1.7 * t), 0.8)


def attitude_slope(y: Array, torque: Array) -> Array:
    rates = three(y[3:])
    return np.array([*angle_rates(three(y[:3]), rates), *spin(rates, torque.tolist(), INNER.inertia)])


# ---- the inner loop


def test_rates_and_angles_turn_into_each_other() -> None:
    for angles in ((0.3, -0.7, 2.0), (-1.2, 1.3, -3.0), (2.5, 0.1, 0.0)):
        assert angle_rates(angles, rates_of(angles, (0.4, -0.9, 1.1))) == pytest.approx((0.4, -0.9, 1.1))


def test_lyapunovs_function_falls_as_the_equations_say() -> None:
    loop, dt = Backstepping(), 1e-4
    y = np.array([-0.7, 0.5, 2.0, 1.5, -2.0, 1.0])
    loop.reset((0.3, 0.2, -0.4))
    values, falls = [], []
    for i in range(round(2.0 / dt)):
        wanted, slopes = moving(i * dt)
        torque = np.array(loop.step(INNER, three(y[:3]), three(y[3:]), wanted, slopes, dt))
        values.append(loop.lyapunov)
        error, rate = np.array(loop.z1_bar), np.array(loop.z2)
        falls.append(error @ (INNER.gamma1 * error) + rate @ (np.array(INNER.gamma2) / INNER.inertia * rate))
        a = attitude_slope(y, torque)
        b = attitude_slope(y + 0.5 * dt * a, torque)
        y = y + dt * b
    v, w = np.array(values), np.array(falls)
    big = v[:-1] > 1e-6 * v[0]
    assert (np.diff(v)[big] < 0.0).all()
    early = slice(0, round(0.3 / dt))
    assert -np.diff(v)[early] / dt == pytest.approx(0.5 * (w[1:] + w[:-1])[early], rel=0.002)
    assert v[-1] < 1e-5 * v[0]
    wanted, _ = moving(2.0)
    assert y[:3] == pytest.approx(wanted, abs=0.02)


def test_the_filters_lag_is_kept_from_the_compensated_error() -> None:
    """With a slow filter the angles' errors swing, and ε takes them all: the rest falls as before."""
    slow = Inner(INNER.gamma1, INNER.gamma2, (4.0, 4.0, 4.0), INNER.inertia, HUGE, HUGE)
    loop, y, dt = Backstepping(), np.zeros(6), 1e-3
    lags, rests = [], []
    for i in range(6000):
        wanted, slopes = moving(i * dt)
        torque = np.array(loop.step(slow, three(y[:3]), three(y[3:]), wanted, slopes, dt))
        lags.append(np.abs(loop.z1).max())
        rests.append(np.abs(loop.z1_bar).max())
        y = y + dt * attitude_slope(y + 0.5 * dt * attitude_slope(y, torque), torque)
    assert max(lags[-2000:]) > 0.05
    assert max(rests[-2000:]) < 0.1 * max(lags[-2000:])


# ---- the whole, as long as nothing is known to be wrong


def begun(body: Body, reference: Reference = HOVER, tuned: dict[str, float] | None = None) -> Ev2:
    ev2 = Ev2(tuned)
    ev2.reset(body.state(), reference, body.trim())
    return ev2


def test_defaults_are_the_hexarotors() -> None:
    ev2, frame = Ev2(), airframe("hexa").at(AIR_DENSITY)
    assert ev2.mass == frame.mass_kg
    assert (ev2.inertia_x, ev2.inertia_y, ev2.inertia_z) == frame.inertia_kgm2
    assert ev2.thrust_full == pytest.approx(frame.thrust_max_n * 6, rel=0.01)
    torques = [ev2.torque_roll, ev2.torque_pitch, ev2.torque_yaw]
    assert torques == pytest.approx(Allocator(frame).torque_nm.tolist(), rel=0.01)
    assert ev2.rotor_tau == frame.rotor_tau_s


def test_flies_to_a_point_and_stays() -> None:
    body = Body()
    ev2 = begun(body)
    goal = Reference(pos=np.array([2.0, -1.0, -1.5]), yaw=1.0)
    last = fly(ev2, body, goal, 12.0)[-1]
    assert last.pos == pytest.approx(goal.pos, abs=0.002)
    assert last.yaw == pytest.approx(1.0, abs=0.002)


def test_a_steady_wind_leaves_no_error() -> None:
    body = Body(force=np.array([3.0, -2.0, 1.5]))
    ev2 = begun(body)
    states = fly(ev2, body, HOVER, 12.0)
    assert max(np.linalg.norm(each.pos) for each in states) > 0.05, "the wind was felt"
    assert states[-1].pos == pytest.approx(np.zeros(3), abs=0.002)
    assert np.array(ev2.outer.integral) == pytest.approx(-body.force / body.mass, abs=0.01)


@pytest.mark.parametrize("mass", [0.8 * 3.2, 1.2 * 3.2])
def test_a_wrong_mass_is_taken_for_another_thrust(mass: float) -> None:
    body = Body(mass=mass)
    ev2 = begun(body)
    states = fly(ev2, body, Reference(pos=np.array([1.0, 0.0, 0.0])), 12.0)
    assert max(abs(each.pos[2]) for each in states) < 0.15
    assert states[-1].pos == pytest.approx([1.0, 0.0, 0.0], abs=0.002)


@pytest.mark.parametrize("share", [0.8, 1.2])
def test_a_mass_that_changes_in_flight_is_carried(share: float) -> None:
    body = Body()
    ev2 = begun(body)
    fly(ev2, body, HOVER, 1.0)
    body.mass *= share
    states = fly(ev2, body, HOVER, 12.0)
    assert 0.05 < max(abs(each.pos[2]) for each in states) < 0.6
    assert states[-1].pos == pytest.approx(np.zeros(3), abs=0.002)


def test_another_vehicle_flies_by_parameters() -> None:
    body = Body(mass=1.4, inertia=(0.012, 0.012, 0.02), full=30.0, torques=(3.0, 3.0, 0.4), rotor_tau=0.02)
    tuned = {
        "mass": 1.4,
        "inertia_x": 0.012,
        "inertia_y": 0.012,
        "inertia_z": 0.02,
        "thrust_full": 30.0,
        "torque_roll": 3.0,
        "torque_pitch": 3.0,
        "torque_yaw": 0.4,
        "rotor_tau": 0.02,
        "gamma2_tilt": 0.22,
        "gamma2_yaw": 0.16,
    }
    ev2 = begun(body, tuned=tuned)
    goal = Reference(pos=np.array([2.0, -1.0, -1.5]), yaw=1.0)
    assert fly(ev2, body, goal, 12.0)[-1].pos == pytest.approx(goal.pos, abs=0.002)


def test_turning_does_not_push_it_aside() -> None:
    body = Body(force=np.array([4.0, 0.0, 0.0]))
    ev2 = begun(body)
    fly(ev2, body, HOVER, 10.0)
    states = fly(ev2, body, Reference(pos=np.zeros(3), yaw=3.0), 5.0)
    assert max(np.linalg.norm(each.pos) for each in states) < 0.15
    assert states[-1].yaw == pytest.approx(3.0, abs=0.01)


# ---- hand-over


def random_hand_over(rng: np.random.Generator) -> tuple[State, Reference, Trim]:
    roll, pitch, yaw = rng.uniform((-0.5, -0.5, -3.1), (0.5, 0.5, 3.1))
    state = State(
        1.0, CYCLE, rng.normal(0, 2, 3), rng.normal(0, 2, 3), quaternion(roll, pitch, yaw), rng.normal(0, 1, 3)
    )
    reference = Reference(pos=rng.normal(0, 5, 3), vel=rng.normal(0, 2, 3), acc=rng.normal(0, 2, 3), yaw=yaw + 0.3)
    asked = quaternion(roll + rng.normal(0, 0.05), pitch + rng.normal(0, 0.05), yaw + 0.1)
    return state, reference, Trim(rng.uniform(0.4, 0.7), asked, rng.normal(0, 1, 3))


def test_the_first_output_is_the_trim() -> None:
    rng = np.random.default_rng(1)
    for _ in range(200):
        state, reference, trim = random_hand_over(rng)
        ev2 = Ev2()
        ev2.reset(state, reference, trim)
        output = ev2.update(state, reference)
        assert isinstance(output, TorqueThrust)
        assert output.thrust == pytest.approx(trim.thrust, abs=1e-9)
        told = ev2.signals
        aimed = quaternion(told["angle_ref.x"], told["angle_ref.y"], state.yaw)
        assert State(q=aimed).rotation[:, 2] == pytest.approx(State(q=trim.attitude).rotation[:, 2], abs=1e-9)
        assert [told["z2.x"], told["z2.y"], told["z2.z"]] == [0.0, 0.0, 0.0]


def test_hovering_it_begins_without_a_torque() -> None:
    body = Body()
    output = begun(body).update(body.state(), HOVER)
    assert isinstance(output, TorqueThrust)
    assert np.abs(output.torque).max() < 1e-9


def test_full_thrust_is_what_the_autopilot_hovers_with() -> None:
    weak = Body(full=50.0)  # an old battery
    assert begun(weak).full == pytest.approx(50.0)
    climbing = Body(full=50.0)
    ev2 = Ev2()
    for _ in range(1000):  # three seconds in which it gets quicker upwards by 1 m/s²
        climbing.t += CYCLE
        climbing.row[5] -= CYCLE
        climbing.row[13] = climbing.mass * (GRAVITY + 1.0)
        ev2.reset(climbing.state(), HOVER, climbing.trim())
    assert ev2.full == pytest.approx(50.0, rel=0.02)
    grounded = Body()
    grounded.row[13] = 0.0
    assert begun(grounded).full == Ev2().thrust_full


# ---- limits


def test_finite_and_recovering_from_any_tilt() -> None:
    degrees = (-180.0, -90.0, -85.0, 0.0, 85.0, 90.0)
    for roll, pitch in itertools.product(degrees, (-90.0, -85.0, 0.0, 85.0, 90.0)):
        body = Body()
        body.turn(math.radians(roll), math.radians(pitch), 0.5)
        body.row[10:13] = 3.0, -3.0, 2.0
        ev2 = begun(body)
        for state in fly(ev2, body, HOVER, 0.02):
            assert np.isfinite(state.q).all()
        assert np.isfinite(list(ev2.signals.values())).all()
        assert np.isfinite(body.row).all()


@pytest.mark.parametrize(("roll", "pitch"), [(85.0, 0.0), (0.0, 85.0), (0.0, -85.0), (-60.0, 60.0)])
def test_comes_back_from_lying_on_its_side(roll: float, pitch: float) -> None:
    body = Body()
    ev2 = begun(body)
    fly(ev2, body, HOVER, 0.1)
    body.turn(math.radians(roll), math.radians(pitch), 0.0)
    states = fly(ev2, body, HOVER, 10.0)
    upright = State(q=states[250].q).rotation[2, 2]
    assert upright > math.cos(math.radians(50.0)), "within a second no further than it may lean by itself"
    assert states[-1].pos == pytest.approx(np.zeros(3), abs=0.01)


def test_what_cannot_be_had_is_not_integrated() -> None:
    body = Body()
    ev2 = begun(body)
    states = fly(ev2, body, Reference(pos=np.array([60.0, 0.0, -60.0])), 8.0)
    assert np.abs(ev2.outer.integral).max() < 0.5
    assert max(np.linalg.norm(each.vel) for each in states) < 1.5 * ev2.speed_max
    lean = max(math.acos(each.rotation[2, 2]) for each in states)
    assert lean < math.radians(ev2.lean_max + 10.0)


def test_a_vehicle_that_is_held_winds_up_to_the_limit_only() -> None:
    body = Body()
    ev2 = begun(body)
    held = body.state()
    for _ in range(5000):
        output = ev2.update(held, Reference(pos=np.array([0.5, 0.0, 0.0])))
    assert isinstance(output, TorqueThrust) and np.isfinite(output.torque).all()
    assert ev2.outer.integral[0] == pytest.approx(ev2.integral_max, abs=0.05)
    assert output.thrust <= ev2.thrust_high


def test_a_gain_changed_in_flight_does_not_jump() -> None:
    body = Body(force=np.array([3.0, 0.0, 2.0]))
    ev2 = begun(body)
    fly(ev2, body, HOVER, 12.0)
    before = ev2.update(body.state(), HOVER)
    ev2.tune("ki_xy", 0.0)
    ev2.tune("ki_z", 1.0)
    after = ev2.update(body.state(), HOVER)
    assert isinstance(before, TorqueThrust) and isinstance(after, TorqueThrust)
    assert after.thrust == pytest.approx(before.thrust, abs=1e-3)
    assert after.torque == pytest.approx(before.torque, abs=0.01)
