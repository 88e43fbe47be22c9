"""The fixed wing's physics against closed forms: Beard and McLain, "Small Unmanned Aircraft", and any textbook."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from tests.sim.physics.closed_forms import energy, glide, stall_speed
from zmav.sim.arrays import Array, quat_from_euler
from zmav.sim.dynamics.airframe import AIR_DENSITY, GRAVITY
from zmav.sim.dynamics.plane import ROLLING, PlaneDynamics
from zmav.sim.dynamics.wing import TRAINER, Wing

DT = 1 / 200


def flying(
    frame: Wing = TRAINER, *, speed: float = 22.0, alpha: float = 0.0, pitch: float = 0.0, n: int = 1
) -> PlaneDynamics:
    """High up, with ``alpha`` between nose and path, the nose at ``pitch`` (rad)."""
    dyn = PlaneDynamics(frame, np.array([[0.0] * n, [0.0] * n, [-1000.0] * n]), np.zeros(n), DT)
    dyn.q[:] = quat_from_euler(np.zeros(n), np.full(n, pitch), np.zeros(n))
    path = pitch - alpha
    dyn.vel[0], dyn.vel[2] = speed * math.cos(path), -speed * math.sin(path)
    dyn.contact[:] = dyn.resting[:] = False
    return dyn


def run(dyn: PlaneDynamics, seconds: float) -> None:
    for _ in range(round(seconds / DT)):
        dyn.step()


def alpha_for(lift: float, frame: Wing = TRAINER) -> float:
    return (lift - frame.lift_0) / frame.lift_alpha


def pressure_area(speed: float, frame: Wing = TRAINER) -> float:
    return 0.5 * AIR_DENSITY * speed**2 * frame.area_m2


def trimmed(speed: float, frame: Wing = TRAINER, climb: float = 0.0) -> tuple[PlaneDynamics, float]:
    """In steady flight along a path at the angle ``climb``, surfaces and throttle set for it; gives the angle of
    attack too.
    """
    alpha = thrust = 0.0
    for _ in range(20):
        # Along the path and across it: the thrust has a part in both.
        lift = frame.weight_n * math.cos(climb) - thrust * math.sin(alpha)
        alpha = alpha_for(lift / pressure_area(speed, frame), frame)
        drag = pressure_area(speed, frame) * float(frame.lift_drag(np.array([alpha]))[1][0])
        thrust = (drag + frame.weight_n * math.sin(climb)) / math.cos(alpha)
    dyn = flying(frame, speed=speed, alpha=alpha, pitch=alpha + climb)
    dyn.throttle[:] = thrust / float(frame.thrust(np.ones(1), np.array([speed * math.cos(alpha)]))[0])
    elevator = -(frame.pitch_0 + frame.pitch_alpha * math.sin(alpha)) / frame.pitch_elevator
    dyn.surface[1] = dyn.deflection[1] = elevator
    return dyn, alpha


@pytest.mark.parametrize("speed", [14.0, 22.0, 27.0])
def test_trimmed_it_flies_on_level_where_lift_is_weight(speed: float) -> None:
    dyn, alpha = trimmed(speed)
    dyn.step()
    assert np.abs(dyn.accel).max() < 0.02
    run(dyn, 6.0)
    assert dyn.airspeed[0] == pytest.approx(speed, rel=0.005)
    assert abs(dyn.vel[2, 0]) < 0.005 * speed
    assert dyn.alpha[0] == pytest.approx(alpha, abs=math.radians(0.1))


def test_lift_is_a_line_below_the_stall_and_a_flat_plate_beyond_it() -> None:
    low = np.radians([-6.0, 0.0, 6.0])
    assert TRAINER.lift_drag(low)[0] == pytest.approx(TRAINER.lift_0 + TRAINER.lift_alpha * low, rel=0.02)
    high = np.radians([-160.0, -90.0, -40.0, 40.0, 90.0, 160.0])
    plate = 2.0 * np.sign(np.sin(high)) * np.sin(high) ** 2 * np.cos(high)
    lift, drag = TRAINER.lift_drag(high)
    assert lift == pytest.approx(plate, abs=1e-6)
    assert drag == pytest.approx(TRAINER.drag_0 + 2.0 * np.sin(high) ** 2, abs=1e-6)
    assert np.argmax(TRAINER.lift_drag(np.radians(np.arange(0.0, 45.0)))[0]) in range(9, 13)


def test_below_the_stall_speed_no_angle_carries_the_weight() -> None:
    stall = stall_speed(TRAINER)
    assert 5.0 < stall < 10.0  # AIRSPEED_MIN keeps off it
    most = max(float(TRAINER.lift_drag(np.array([a]))[0][0]) for a in np.linspace(0, 0.6, 600))
    for speed, carried in ((0.99 * stall, False), (1.01 * stall, True)):
        assert (pressure_area(speed) * most > TRAINER.weight_n) is carried
    assert stall_speed(TRAINER, 2.0) == pytest.approx(math.sqrt(2.0) * stall)
    # Too slow it falls, whatever its nose does.
    dyn = flying(speed=0.6 * stall, alpha=0.19, pitch=0.19)
    run(dyn, 0.3)
    assert dyn.accel[2, 0] > 0.2 * GRAVITY


@pytest.mark.parametrize("speed", [9.0, 14.0])
def test_without_power_it_glides_as_far_as_lift_over_drag(speed: float) -> None:
    slippery = msgspec.structs.replace(TRAINER, drag_0=0.03)
    slope, alpha = 0.0, 0.0
    for _ in range(20):
        alpha = alpha_for(slippery.weight_n * math.cos(slope) / pressure_area(speed, slippery), slippery)
        lift, drag = slippery.lift_drag(np.array([alpha]))
        slope = math.atan(float(drag[0] / lift[0]))
    dyn, _ = trimmed(speed, slippery, climb=-slope)
    assert abs(dyn.throttle[0]) < 1e-3
    dyn.throttle[:] = 0.0
    run(dyn, 6.0)
    assert dyn.vel[0, 0] / dyn.vel[2, 0] == pytest.approx(glide(slippery, speed), rel=0.03)
    assert dyn.airspeed[0] == pytest.approx(speed, rel=0.01)


def test_climb_is_the_excess_power_over_the_weight() -> None:
    speed, climb = 16.0, 0.3
    dyn, alpha = trimmed(speed, climb=climb)
    run(dyn, 5.0)
    drag = pressure_area(speed) * float(TRAINER.lift_drag(np.array([alpha]))[1][0])
    excess = (float(dyn.thrust[0]) * math.cos(alpha) - drag) * speed
    assert -dyn.vel[2, 0] == pytest.approx(excess / TRAINER.weight_n, rel=0.01)
    assert -dyn.vel[2, 0] == pytest.approx(speed * math.sin(climb), rel=0.01)


def test_a_dive_ends_where_drag_is_weight() -> None:
    straight = msgspec.structs.replace(TRAINER, lift_0=0.0, pitch_0=0.0)
    dyn = flying(straight, speed=18.0, pitch=-math.pi / 2)
    run(dyn, 9.0)
    terminal = math.sqrt(2.0 * TRAINER.weight_n / (AIR_DENSITY * TRAINER.area_m2 * TRAINER.drag_0))
    assert dyn.vel[2, 0] == pytest.approx(terminal, rel=0.002)
    assert abs(dyn.alpha[0]) < 1e-6


def test_a_phugoid_has_the_period_of_its_approximation() -> None:
    """Lanchester's sqrt(2) pi V / g, longer by what the damping of pitch takes: W. F. Phillips, "Phugoid Approximation
    for Conventional Airplanes", Journal of Aircraft 37(1), 2000.
    """
    speed = 22.0
    slippery = msgspec.structs.replace(TRAINER, drag_0=0.004, thrust_speed_mps=1e6)
    dyn, _ = trimmed(speed, slippery)
    dyn.vel[0] *= 1.1
    speeds: list[float] = []
    for _ in range(round(31.0 / DT)):
        dyn.step()
        speeds.append(float(dyn.airspeed[0]))
    wave = np.array(speeds[round(2.0 / DT) :])
    peaks = [i for i in range(1, len(wave) - 1) if wave[i - 1] < wave[i] >= wave[i + 1]]
    pressed = pressure_area(speed)
    m_alpha = pressed * slippery.chord_m * -slippery.pitch_alpha
    m_q = pressed * slippery.chord_m**2 * -slippery.pitch_q / (2.0 * speed)
    z_alpha = pressed * slippery.lift_alpha / (slippery.mass_kg * speed)
    longer = math.sqrt(1.0 + m_q * z_alpha / m_alpha)
    period = float(np.diff(peaks).mean()) * DT
    assert period == pytest.approx(math.sqrt(2.0) * math.pi * speed / GRAVITY * longer, rel=0.03)


def test_the_short_period_has_the_derivatives_of_linear_theory() -> None:
    """Z_alpha, M_alpha and M_q of a step, and with them a fast motion that is well damped and stable."""
    speed, frame = 22.0, TRAINER

    def slopes(dalpha: float, rate: float) -> tuple[float, float]:
        dyn, _ = trimmed(speed, frame)
        dyn.vel[0], dyn.vel[2] = speed * math.cos(-dalpha), -speed * math.sin(-dalpha)
        dyn.rate[1] = rate
        dyn.step()
        return float(dyn.accel[2, 0]), float((dyn.rate[1, 0] - rate) / DT)

    h = 1e-4
    z_alpha = (slopes(h, 0.0)[0] - slopes(-h, 0.0)[0]) / (2 * h)
    m_alpha = (slopes(h, 0.0)[1] - slopes(-h, 0.0)[1]) / (2 * h)
    m_q = (slopes(0.0, h)[1] - slopes(0.0, -h)[1]) / (2 * h)
    q_s = pressure_area(speed)
    drag = float(frame.lift_drag(np.array([alpha_for(frame.weight_n / q_s)]))[1][0])
    assert z_alpha == pytest.approx(-q_s * (frame.lift_alpha + drag) / frame.mass_kg, rel=0.02)
    assert m_alpha == pytest.approx(q_s * frame.chord_m * frame.pitch_alpha / frame.inertia_kgm2[1], rel=0.03)
    damping = frame.pitch_q * frame.chord_m / (2.0 * speed) * q_s * frame.chord_m / frame.inertia_kgm2[1]
    assert m_q == pytest.approx(damping / (1.0 - damping * DT), rel=0.01)
    system = np.array([[z_alpha / speed, 1.0], [m_alpha, damping]])
    roots = np.linalg.eigvals(system)
    assert (roots.real < -1.0).all()
    frequency = math.sqrt(float(np.prod(roots).real))
    assert 4.0 < frequency < 15.0
    assert -roots.real.sum() / (2.0 * frequency) > 0.5


def test_ailerons_roll_it_at_the_rate_that_damping_allows() -> None:
    calm = msgspec.structs.replace(TRAINER, roll_beta=0.0, roll_r=0.0, yaw_p=0.0)
    dyn, _ = trimmed(22.0, calm)
    dyn.surface[0] = dyn.deflection[0] = 0.2
    rates: list[float] = []
    for _ in range(80):
        rates.append(float(dyn.rate[0, 0]))
        dyn.step()
    final = 0.2 * calm.roll_aileron / -calm.roll_p * 2.0 * 22.0 / calm.span_m
    assert rates[-1] == pytest.approx(final, rel=0.04)
    tau = calm.inertia_kgm2[0] / (-calm.roll_p * pressure_area(22.0) * calm.span_m**2 / (2.0 * 22.0))
    assert rates[round(tau / DT)] == pytest.approx(final * (1.0 - math.exp(-1.0)), rel=0.06)


def test_it_weathercocks_into_the_wind() -> None:
    dyn = flying(speed=22.0, alpha=-0.06, pitch=-0.06)
    dyn.vel[1] = 4.0  # slips to the right
    dyn.step()
    assert dyn.beta[0] > 0.15
    assert dyn.rate[2, 0] > 0.0  # nose right
    assert dyn.accel[1, 0] < -1.0  # pushed back


@pytest.mark.parametrize(("axis", "sign"), [(0, 1), (1, 1), (2, 1)])
def test_surfaces_turn_it_the_way_they_are_named(axis: int, sign: int) -> None:
    dyn, _ = trimmed(20.0)
    dyn.surface[axis] += 0.3
    run(dyn, 0.2)
    assert dyn.rate[axis, 0] * sign > 0.05


def test_surfaces_move_no_faster_than_their_servos() -> None:
    dyn = flying()
    dyn.surface[0] = 1.0
    dyn.step()
    assert dyn.deflection[0, 0] == pytest.approx(TRAINER.servo_rate * DT)
    run(dyn, 0.2)
    assert dyn.deflection[0, 0] == 1.0


def test_the_propeller_gives_less_the_faster_it_flies() -> None:
    full = TRAINER.thrust(np.ones(4), np.array([0.0, 20.0, 50.0, 90.0]))
    assert full[0] == TRAINER.thrust_max_n
    assert full[1] == pytest.approx(TRAINER.thrust_max_n * (1.0 - 0.16))
    assert list(full[2:]) == [0.0, 0.0]
    assert TRAINER.thrust(np.array([0.5]), np.zeros(1))[0] == 0.5 * full[0]


def test_energy_changes_by_what_thrust_and_drag_do() -> None:
    dyn, _ = trimmed(18.0)
    dyn.throttle[:] = 0.9
    work, before = 0.0, float(energy(dyn)[0])
    for _ in range(600):
        speed = float(np.linalg.norm(dyn.vel[:, 0]))
        dyn.step()
        drag = pressure_area(float(dyn.airspeed[0])) * float(TRAINER.lift_drag(dyn.alpha)[1][0])
        work += (float(dyn.thrust[0]) * math.cos(float(dyn.alpha[0])) - drag) * speed * DT
    assert float(energy(dyn)[0]) - before == pytest.approx(work, rel=0.03)


def test_without_an_engine_no_attitude_gains_energy() -> None:
    rng = np.random.default_rng(7)
    n = 200
    dyn = flying(n=n)
    q = rng.normal(size=(4, n))
    dyn.q[:] = q / np.sqrt((q * q).sum(0))
    dyn.vel[:] = rng.uniform(-30, 30, (3, n))
    dyn.rate[:] = rng.uniform(-4, 4, (3, n))
    for _ in range(10):
        before = energy(dyn)
        run(dyn, 0.5)
        assert (energy(dyn) < before * (1 + 1e-3) + 1.0).all()


def test_nothing_makes_it_lose_its_numbers() -> None:
    """Any attitude, speeds and winds beyond reason, surfaces at their ends, and the ground in the way."""
    rng = np.random.default_rng(3)
    n = 300
    dyn = PlaneDynamics(TRAINER, rng.uniform(-50, 50, (3, n)), np.zeros(n), DT)
    q = rng.normal(size=(4, n))
    dyn.q[:] = q / np.sqrt((q * q).sum(0))
    dyn.vel[:] = rng.normal(0, 60, (3, n)) * rng.choice([0.0, 1.0, 10.0], n)
    dyn.rate[:] = rng.normal(0, 20, (3, n))
    dyn.wind[:] = rng.normal(0, 1, (3, n)) * rng.choice([0.0, 30.0, 1e5], n)
    for _ in range(400):
        dyn.surface[:] = rng.choice([-1.0, 0.0, 1.0], (3, n))
        dyn.throttle[:] = rng.choice([0.0, 1.0], n)
        dyn.step()
    for state in (dyn.pos, dyn.vel, dyn.q, dyn.rate, dyn.accel, dyn.airspeed, dyn.alpha, dyn.beta):
        assert np.isfinite(state).all()
    sane = np.abs(dyn.wind).max(0) < 200.0
    assert np.abs(dyn.rate[:, sane]).max() < 60.0


def test_planes_do_not_feel_each_other() -> None:
    alone, _ = trimmed(22.0)
    together = flying(n=3)
    for name in ("pos", "vel", "q", "rate", "surface", "deflection"):
        getattr(together, name)[:, 0] = getattr(alone, name)[:, 0]
    together.throttle[0] = alone.throttle[0]
    together.rate[:, 1] = 1.0
    for dyn in (alone, together):
        dyn.surface[0, 0] = 0.3
        run(dyn, 3.0)
    assert np.allclose(together.pos[:, 0], alone.pos[:, 0], rtol=0, atol=1e-9)
    assert np.allclose(together.q[:, 0], alone.q[:, 0], rtol=0, atol=1e-12)


# ---- the ground


def standing(n: int = 1) -> PlaneDynamics:
    return PlaneDynamics(TRAINER, np.zeros((3, n)), np.zeros(n), DT)


def test_it_stands_still_whatever_blows_until_its_engine_moves_it() -> None:
    dyn = standing()
    there = dyn.pos.copy()
    dyn.wind[0] = -12.0
    run(dyn, 3.0)
    assert (dyn.pos == there).all()
    assert dyn.contact[0]
    assert dyn.resting[0]
    dyn.throttle[:] = 1.0
    run(dyn, 1.0)
    assert dyn.pos[0, 0] > 3.0


def roll_out(seconds: float, speed: float = 8.0, rudder: float = 0.0) -> PlaneDynamics:
    """On the wheels without air, surfaces still."""
    dyn = standing()
    dyn.density[:] = 0.0
    dyn.resting[:] = False
    dyn.vel[0] = speed
    dyn.surface[2] = dyn.deflection[2] = rudder
    run(dyn, seconds)
    return dyn


def test_wheels_roll_to_a_stop_by_their_friction() -> None:
    dyn = roll_out(8.0)
    assert dyn.pos[0, 0] == pytest.approx(8.0**2 / (2.0 * ROLLING * GRAVITY), rel=0.03)
    assert dyn.resting[0]
    assert abs(dyn.pos[1, 0]) < 0.01
    assert abs(dyn.pos[2, 0]) < 0.03  # a standing plane is where the ground is


def test_the_nose_wheel_steers_and_wheels_do_not_slide() -> None:
    dyn = roll_out(2.0, speed=5.0, rudder=1.0)
    w, _, _, z = dyn.q[:, 0]
    assert 2.0 * math.atan2(z, w) > 0.2  # to the right
    speed = dyn.vel[:2, 0]
    heading = 2.0 * math.atan2(z, w)
    across = -math.sin(heading) * speed[0] + math.cos(heading) * speed[1]
    assert abs(across) < 0.3


def test_with_power_and_elevator_it_leaves_the_ground() -> None:
    dyn = standing()
    dyn.throttle[:] = 1.0
    while dyn.airspeed[0] < 11.0:
        dyn.step()
    assert dyn.pos[0, 0] < 12.0
    dyn.surface[1] = 0.4
    run(dyn, 1.5)
    assert dyn.pos[2, 0] < -1.0
    assert not dyn.contact[0]


def test_a_hard_landing_is_told_once_and_it_ends_on_its_wheels() -> None:
    dyn = PlaneDynamics(TRAINER, np.array([[0.0], [0.0], [-1.0]]), np.zeros(1), DT)
    dyn.density[:] = 0.0
    run(dyn, 3.0)
    assert dyn.impact[0] == pytest.approx(math.sqrt(2.0 * GRAVITY), rel=0.03)
    dyn.impact[:] = 0.0
    run(dyn, 2.0)
    assert dyn.impact[0] < 0.3
    assert dyn.resting[0]
    assert abs(dyn.q[1, 0]) + abs(dyn.q[2, 0]) < 0.05


def test_on_its_back_it_does_not_sink_in() -> None:
    dyn = PlaneDynamics(TRAINER, np.array([[0.0], [0.0], [-2.0]]), np.zeros(1), DT)
    dyn.q[:, 0] = 0.0, 1.0, 0.0, 0.0
    run(dyn, 8.0)
    assert -1.2 < dyn.pos[2, 0] < 0.3
    assert np.linalg.norm(dyn.vel) < 0.5


def test_a_throw_puts_it_in_the_air() -> None:
    dyn = standing(n=2)
    dyn.launch(1, 12.0, 0.3)
    run(dyn, 0.1)
    assert dyn.pos[2, 0] == 0.0
    assert not dyn.contact[1]
    assert dyn.airspeed[1] == pytest.approx(12.0, abs=1.0)
    assert dyn.vel[2, 1] < -2.0


def test_arrays_stay_columns() -> None:
    dyn: PlaneDynamics = flying(n=4)
    run(dyn, 0.1)
    state: Array = dyn.pos
    assert state.shape == (3, 4)
    assert dyn.n == 4
