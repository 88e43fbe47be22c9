"""Friction and the cushion of air near the ground, against closed forms."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from tests.sim.physics.closed_forms import energy
from zmav.sim.dynamics.airframe import GRAVITY, airframe
from zmav.sim.dynamics.copter import FRICTION, SINK_M, CopterDynamics, GroundContact

DT = 1 / 200


def copter(height: float = 0.0) -> CopterDynamics:
    frame = msgspec.structs.replace(airframe("hexa"), drag_area_m2=0.0)
    return CopterDynamics(frame, np.array([[5.0], [-2.0], [-height]]), np.array([0.7]), DT)


def run(dyn: CopterDynamics, seconds: float) -> None:
    for _ in range(round(seconds / DT)):
        dyn.step()


def test_what_lands_comes_to_rest() -> None:
    dyn = copter(height=0.2)
    run(dyn, 4.0)
    assert dyn.resting[0]
    assert abs(float(dyn.pos[2, 0])) < 0.03
    there = dyn.pos.copy()
    run(dyn, 2.0)
    assert (dyn.pos == there).all()


def test_a_slide_on_level_ground_is_as_long_as_friction_says() -> None:
    dyn = copter()
    dyn.resting[:] = False
    run(dyn, 0.2)
    dyn.resting[:] = False
    start = dyn.pos[0, 0]
    dyn.vel[0] = 3.0
    run(dyn, 3.0)
    assert dyn.resting[0]
    assert dyn.pos[0, 0] - start == pytest.approx(9.0 / (2.0 * FRICTION * GRAVITY), rel=0.12)


def test_the_ground_takes_energy_and_gives_none() -> None:
    dyn = copter(height=1.0)
    dyn.vel[:, 0] = (1.0, -0.5, 0.0)

    last = float(energy(dyn)[0])
    spring = dyn.airframe.weight_n * SINK_M  # may be in the feet meanwhile, a few times that
    for _ in range(60):
        run(dyn, 0.05)
        assert float(energy(dyn)[0]) < last + 10.0 * spring
        last = min(last, float(energy(dyn)[0]))
    assert dyn.resting[0]


def test_rotors_near_the_ground_carry_more_as_cheeseman_and_bennett_found() -> None:
    ground = GroundContact(np.zeros((3, 4)), 10.0, (0.127, 0.15))
    for height in (0.0, 0.1, 0.4):
        expected = 1.0 / (1.0 - (0.127 / (4.0 * (height + 0.15))) ** 2)
        assert ground.cushion(np.array([height]))[0] == pytest.approx(expected)
