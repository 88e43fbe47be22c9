"""The physics against closed forms."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from tests.sim.physics.closed_forms import energy
from zmav.errors import BadConfig
from zmav.sim.dynamics.airframe import GRAVITY, Airframe, airframe
from zmav.sim.dynamics.copter import CopterDynamics

DT = 1 / 200
NO_DRAG = {"drag_area_m2": 0.0, "rotor_drag_kgps": 0.0, "inflow_mps": 0.0}


def dynamics(frame: Airframe, height: float = 1000.0, n: int = 1) -> CopterDynamics:
    start = np.zeros((3, n))
    start[2] = -height
    return CopterDynamics(frame, start, np.zeros(n), DT)


def run(dyn: CopterDynamics, seconds: float) -> None:
    for _ in range(round(seconds / DT)):
        dyn.step()


@pytest.fixture(params=["quad", "hexa"])
def frame(request: pytest.FixtureRequest) -> Airframe:
    return airframe(request.param)


def test_free_fall_without_air(frame: Airframe) -> None:
    dyn = dynamics(msgspec.structs.replace(frame, **NO_DRAG))
    run(dyn, 3.0)
    assert dyn.vel[2, 0] == pytest.approx(GRAVITY * 3.0, rel=1e-9)
    assert dyn.pos[2, 0] == pytest.approx(-1000.0 + 0.5 * GRAVITY * 9.0, rel=1e-9)


def test_energy_is_kept_without_air(frame: Airframe) -> None:
    dyn = dynamics(msgspec.structs.replace(frame, **NO_DRAG))
    dyn.vel[:, 0] = (7.0, -3.0, -20.0)
    before = energy(dyn)[0]
    run(dyn, 5.0)
    assert energy(dyn)[0] == pytest.approx(before, rel=1e-9)


def test_fall_in_air_follows_tanh_to_terminal_speed(frame: Airframe) -> None:
    dyn = dynamics(frame)
    terminal = math.sqrt(2.0 * frame.mass_kg * GRAVITY / (frame.air_density * frame.drag_area_m2))
    for _ in range(3):
        run(dyn, 1.0)
    assert dyn.vel[2, 0] == pytest.approx(terminal * math.tanh(GRAVITY * 3.0 / terminal), rel=0.005)
    run(dyn, 17.0)
    assert dyn.vel[2, 0] == pytest.approx(terminal, rel=0.001)


def test_hover_throttle_carries_the_weight(frame: Airframe) -> None:
    dyn = dynamics(msgspec.structs.replace(frame, inflow_mps=0.0))
    dyn.throttle[:] = frame.hover_throttle
    # The rotors must spin up first; after that nothing accelerates it any more.
    run(dyn, 1.0)
    assert dyn.thrust.sum() == pytest.approx(frame.weight_n, rel=1e-6)
    dyn.vel[:] = 0.0
    run(dyn, 4.0)
    assert abs(dyn.vel[2, 0]) < 1e-3


def test_the_quad_hovers_at_the_recorded_throttle() -> None:
    assert airframe("quad").hover_throttle == pytest.approx(0.39, abs=1e-3)  # MOT_THST_HOVER


def test_rotors_follow_with_a_first_order_lag(frame: Airframe) -> None:
    dyn = dynamics(frame)
    dyn.throttle[:] = 1.0
    run(dyn, math.ceil(frame.rotor_tau_s / DT) * DT)
    steps = math.ceil(frame.rotor_tau_s / DT)
    assert dyn.rotor[0, 0] == pytest.approx(1.0 - math.exp(-steps * DT / frame.rotor_tau_s), rel=1e-9)


def test_a_lean_accelerates_with_g_tan(frame: Airframe) -> None:
    dyn = dynamics(msgspec.structs.replace(frame, **NO_DRAG))
    lean = math.radians(20.0)
    dyn.q[:, 0] = (math.cos(lean / 2), 0.0, -math.sin(lean / 2), 0.0)  # nose down: forward
    share = frame.hover_thrust_n / math.cos(lean) / frame.thrust_max_n
    linear, square = 1.0 - frame.thrust_expo, frame.thrust_expo
    dyn.rotor[:] = math.sqrt(share)
    dyn.throttle[:] = (math.sqrt(linear**2 + 4 * square * share) - linear) / (2 * square)
    run(dyn, 1.0)
    assert dyn.vel[0, 0] == pytest.approx(GRAVITY * math.tan(lean), rel=1e-6)
    assert dyn.vel[2, 0] == pytest.approx(0.0, abs=1e-6)


def test_it_drifts_with_the_wind(frame: Airframe) -> None:
    dyn = dynamics(frame)
    dyn.rotor[:] = math.sqrt(frame.hover_thrust_n / frame.thrust_max_n)
    dyn.throttle[:] = frame.hover_throttle
    dyn.wind[:, 0] = (3.0, -4.0, 0.0)
    run(dyn, 40.0)
    assert dyn.vel[0, 0] == pytest.approx(3.0, rel=0.08)
    assert dyn.vel[1, 0] == pytest.approx(-4.0, rel=0.08)


@pytest.mark.parametrize(("axis", "sign"), [("right", -1.0), ("left", 1.0)])
def test_more_thrust_on_one_side_rolls_to_the_other(frame: Airframe, axis: str, sign: float) -> None:
    dyn = dynamics(frame)
    side = np.array([r.right_m for r in frame.rotors])
    chosen = side > 0.01 if axis == "right" else side < -0.01
    dyn.throttle[chosen] = 0.6
    dyn.throttle[~chosen] = 0.4
    run(dyn, 0.1)
    assert sign * dyn.rate[0, 0] > 0.1
    assert abs(dyn.rate[1, 0]) < 0.02 * abs(dyn.rate[0, 0])


def test_rotors_turning_left_push_the_nose_right(frame: Airframe) -> None:
    dyn = dynamics(frame)
    left_turning = np.array([r.spin > 0 for r in frame.rotors])
    dyn.throttle[left_turning] = 0.6
    dyn.throttle[~left_turning] = 0.4
    run(dyn, 0.1)
    assert dyn.rate[2, 0] > 0.01
    assert np.abs(dyn.rate[:2, 0]).max() < 1e-6


def test_spinning_without_torque_keeps_angular_momentum_and_energy(frame: Airframe) -> None:
    """Euler's equations: the body's rates wander, the momentum seen from the world does not."""
    dyn = dynamics(msgspec.structs.replace(frame, **NO_DRAG))
    dyn.rate[:, 0] = (1.0, 0.3, 2.0)
    inertia = np.array(frame.inertia_kgm2)

    def momentum() -> np.ndarray:
        w, x, y, z = dyn.q[:, 0]
        rotation = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        return rotation @ (inertia * dyn.rate[:, 0])

    before, energy = momentum(), (inertia * dyn.rate[:, 0] ** 2).sum()
    first = dyn.rate[:, 0].copy()
    run(dyn, 2.0)
    assert np.linalg.norm(momentum() - before) < 0.02 * np.linalg.norm(before)
    assert (inertia * dyn.rate[:, 0] ** 2).sum() == pytest.approx(energy, rel=0.01)
    assert np.linalg.norm(dyn.rate[:, 0] - first) > 0.3


def test_it_falls_on_its_feet_and_stays_there(frame: Airframe) -> None:
    dyn = dynamics(frame, height=1.0)
    dyn.vel[0] = 1.0
    run(dyn, 0.2)
    assert not dyn.contact[0]
    run(dyn, 4.0)
    assert dyn.resting[0]
    assert dyn.impact[0] == pytest.approx(math.sqrt(2 * GRAVITY), rel=0.05)
    assert abs(dyn.pos[2, 0]) < 0.02
    assert np.abs(dyn.q[1:3, 0]).max() < 0.02  # upright
    there = dyn.pos.copy()
    dyn.wind[0] = 8.0
    run(dyn, 5.0)
    assert (dyn.pos == there).all()


def test_it_stands_until_its_rotors_carry_it(frame: Airframe) -> None:
    dyn = dynamics(frame, height=0.0)
    dyn.throttle[:] = 0.7 * frame.hover_throttle
    run(dyn, 3.0)
    assert dyn.pos[2, 0] == 0.0
    dyn.throttle[:] = 1.1 * frame.hover_throttle
    run(dyn, 2.0)
    assert dyn.pos[2, 0] < -1.0
    assert not dyn.contact[0]


def test_vehicles_do_not_feel_each_other(frame: Airframe) -> None:
    together, alone = dynamics(frame, n=3), dynamics(frame)
    together.throttle[:, 0] = alone.throttle[:, 0] = 0.5
    together.throttle[:, 1] = np.linspace(0.2, 0.9, len(frame.rotors))
    for dyn in (together, alone):
        dyn.rate[:, 0] = (0.1, 0.2, 0.3)
        run(dyn, 2.0)
    assert np.allclose(together.pos[:, 0], alone.pos[:, 0], rtol=0, atol=1e-9)
    assert np.allclose(together.q[:, 0], alone.q[:, 0], rtol=0, atol=1e-12)


def test_an_unknown_airframe_is_refused_by_name() -> None:
    with pytest.raises(BadConfig, match="quad, hexa") as caught:
        airframe("octo")
    assert caught.value.detail["value"] == "octo"
