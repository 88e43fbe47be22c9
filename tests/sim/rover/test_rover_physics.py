"""The rovers' physics against closed forms."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from zmav.sim.dynamics.airframe import AIR_DENSITY, GRAVITY
from zmav.sim.dynamics.rover import RoverDynamics
from zmav.sim.dynamics.roverframe import CAR, RoverFrame

DT = 0.005


def rovers(frame: RoverFrame, yaws: tuple[float, ...] = (0.0,)) -> RoverDynamics:
    return RoverDynamics(frame, np.zeros((3, len(yaws))), np.array(yaws), DT)


def drive(dyn: RoverDynamics, seconds: float, throttle: float = 0.0, steering: float = 0.0) -> None:
    dyn.throttle[:], dyn.steering[:] = throttle, steering
    for _ in range(round(seconds / DT)):
        dyn.step()


@pytest.fixture
def frame() -> RoverFrame:
    return CAR


@pytest.mark.parametrize("throttle", [1.0, 0.4, -0.5])
def test_top_speed(frame: RoverFrame, throttle: float) -> None:
    """Where the motors' force equals rolling resistance and drag: a quadratic in the speed."""
    dyn = rovers(frame)
    dyn.speed[:] = math.copysign(0.9 * frame.free_speed * abs(throttle), throttle)
    drive(dyn, 15.0, throttle)
    drag = 0.5 * AIR_DENSITY * frame.drag_area_m2 / frame.mass_kg
    linear = frame.stall_accel / frame.free_speed
    rest = frame.stall_accel * abs(throttle) - frame.rolling * GRAVITY
    speed = (-linear + math.sqrt(linear**2 + 4.0 * drag * rest)) / (2.0 * drag)
    assert dyn.speed[0] == pytest.approx(math.copysign(speed, throttle), rel=1e-3)


def test_acceleration_from_rest(frame: RoverFrame) -> None:
    """Without air and lag, an exponential whose time constant is free speed over stall acceleration."""
    frame = msgspec.structs.replace(frame, drag_area_m2=0.0, motor_tau_s=1e-6)
    dyn = rovers(frame)
    drive(dyn, 1.0, 0.5)
    tau = frame.free_speed / frame.stall_accel
    top = frame.free_speed * 0.5 - frame.rolling * GRAVITY * tau
    assert dyn.speed[0] == pytest.approx(top * (1.0 - math.exp(-1.0 / tau)), rel=0.01)
    assert dyn.pos[0, 0] == pytest.approx(top * (1.0 - tau * (1.0 - math.exp(-1.0 / tau))), rel=0.02)


def test_tyres_limit_the_start() -> None:
    """A motor stronger than the tyres: the rover starts with mu g, less what rolls against it."""
    frame = msgspec.structs.replace(CAR, stall_accel=50.0, motor_tau_s=1e-6)
    dyn = rovers(frame)
    drive(dyn, 0.5, 1.0)
    assert dyn.speed[0] == pytest.approx((frame.friction - frame.rolling) * GRAVITY * 0.5, rel=0.02)


def test_braking_distance() -> None:
    """Full brake at the tyres' limit: v^2 / (2 (mu + c) g)."""
    frame = msgspec.structs.replace(CAR, drag_area_m2=0.0, stall_accel=100.0, motor_tau_s=1e-6)
    dyn = rovers(frame)
    dyn.speed[:] = 10.0
    for _ in range(2000):
        dyn.throttle[:] = -1.0 if dyn.speed[0] > 0.1 else 0.0
        dyn.step()
    assert dyn.speed[0] == 0.0
    assert dyn.pos[0, 0] == pytest.approx(10.0**2 / (2.0 * (frame.friction + frame.rolling) * GRAVITY), rel=0.02)


def test_coasting_stops(frame: RoverFrame) -> None:
    dyn = rovers(frame)
    drive(dyn, 5.0, 0.5)
    assert dyn.speed[0] > 1.0
    drive(dyn, 15.0)
    assert dyn.speed[0] == 0.0
    rest = dyn.pos.copy()
    drive(dyn, 1.0)
    assert (dyn.pos == rest).all()


@pytest.mark.parametrize("steering", [1.0, -0.5, 0.2])
def test_turn_radius(steering: float) -> None:
    """L / tan(delta), driven as a whole circle that closes."""
    frame = CAR
    dyn = rovers(frame)
    drive(dyn, 5.0, 0.08, steering)
    radius = frame.wheelbase_m / math.tan(abs(steering) * frame.steering_max)
    assert dyn.speed[0] / abs(dyn.rate[2, 0]) == pytest.approx(radius, rel=1e-6)
    assert math.copysign(1.0, dyn.rate[2, 0]) == math.copysign(1.0, steering)
    track = []
    turned, yaw = 0.0, dyn.yaw[0]
    while turned < 2.0 * math.pi:
        dyn.step()
        turned += abs((dyn.yaw[0] - yaw + math.pi) % (2.0 * math.pi) - math.pi)
        yaw = dyn.yaw[0]
        track.append(dyn.pos[:2, 0].copy())
    spots = np.array(track)
    assert np.ptp(spots[:, 0]) == pytest.approx(2.0 * radius, rel=0.02)
    assert np.linalg.norm(spots[-1] - spots[0]) < 0.05 * radius


def test_forward_and_back_leave_the_same_track() -> None:
    dyn = rovers(CAR)
    drive(dyn, 6.0, -0.1, 0.5)
    assert dyn.speed[0] < -0.5
    assert dyn.rate[2, 0] < 0.0  # wheels to the right, backwards: the nose goes left


def test_lateral_limit() -> None:
    """Too fast for the circle: the tyres give mu g and the turn is wider."""
    frame = CAR
    dyn = rovers(frame)
    drive(dyn, 8.0, 0.6)
    drive(dyn, 0.3, 0.6, 1.0)
    speed, lateral = dyn.speed[0], dyn.speed[0] * dyn.rate[2, 0]
    assert speed**2 / (frame.wheelbase_m / math.tan(frame.steering_max)) > 2.0 * frame.friction * GRAVITY
    driven = dyn.drive[0]
    assert math.hypot(lateral, driven) == pytest.approx(frame.friction * GRAVITY, rel=1e-6)
    assert dyn.accel[1, 0] ** 2 + dyn.accel[0, 0] ** 2 == pytest.approx(lateral**2, rel=0.05)


def test_wind_pushes() -> None:
    """A tail wind saves drag."""
    speeds = []
    for wind in (0.0, 8.0, -8.0):
        dyn = rovers(CAR)
        dyn.wind[0] = wind
        drive(dyn, 10.0, 0.5)
        speeds.append(dyn.speed[0])
    assert speeds[1] > speeds[0] > speeds[2]


def test_columns_are_alone() -> None:
    """What one rover does changes nothing for its neighbours."""
    frame = CAR
    three, one = rovers(frame, (0.0, 1.0, 2.0)), rovers(frame, (1.0,))
    three.throttle, three.steering = np.array([0.9, 0.2, -0.4]), np.array([0.1, -0.3, 1.0])
    one.throttle, one.steering = np.array([0.2]), np.array([-0.3])
    for _ in range(1000):
        three.step()
        one.step()
    assert three.pos[:, 1] == pytest.approx(one.pos[:, 0], abs=1e-12)
