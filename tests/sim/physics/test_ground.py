"""Slopes, friction and the cushion of air near the ground, against closed forms."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from tests.sim.conftest import MakeDesk
from zmav.sim import VehicleSpec
from zmav.sim.arrays import body_z
from zmav.sim.dynamics.airframe import GRAVITY, airframe
from zmav.sim.dynamics.copter import CopterDynamics
from zmav.sim.dynamics.ground import FRICTION, SINK_M, Ground
from zmav.sim.environment import Terrain

DT = 1 / 200


def on_slope(slope: float, height: float = 0.0, east: float = 0.0) -> CopterDynamics:
    terrain = Terrain(down_m=3.0, slope_north=slope, slope_east=east)
    start = np.array([[5.0], [-2.0], [0.0]])
    start[2] = terrain.down(start[0], start[1]) - height
    frame = msgspec.structs.replace(airframe("hexa"), drag_area_m2=0.0)
    return CopterDynamics(frame, start, np.array([0.7]), DT, terrain)


def run(dyn: CopterDynamics, seconds: float) -> None:
    for _ in range(round(seconds / DT)):
        dyn.step()


@pytest.mark.parametrize(("north", "east"), [(0.3, 0.0), (-0.2, 0.4), (0.5, 0.0)])
def test_what_stands_on_a_slope_stays_there_and_upright_to_it(north: float, east: float) -> None:
    dyn = on_slope(north, east=east)
    before = dyn.pos.copy()
    run(dyn, 3.0)
    assert (dyn.pos == before).all()
    assert dyn.resting[0]
    down = body_z(dyn.q)[:, 0]
    assert down == pytest.approx([-c for c in dyn.terrain.normal], abs=1e-9)


def test_what_lands_on_a_slope_comes_to_rest_on_it() -> None:
    dyn = on_slope(0.3, height=0.4)
    run(dyn, 4.0)
    assert dyn.resting[0]
    assert abs(float(dyn.ground.height(dyn.pos)[0])) < 0.03
    there = dyn.pos.copy()
    run(dyn, 2.0)
    assert (dyn.pos == there).all()


def test_what_stands_steeper_than_friction_holds_slides_with_what_is_left() -> None:
    slope = 0.95
    assert slope > FRICTION
    dyn = on_slope(slope)
    run(dyn, 1.0)
    first = float(np.linalg.norm(dyn.vel))
    run(dyn, 1.0)
    angle = math.atan(slope)
    expected = GRAVITY * (math.sin(angle) - FRICTION * math.cos(angle))
    assert float(np.linalg.norm(dyn.vel)) - first == pytest.approx(expected, rel=0.05)
    assert dyn.vel[0, 0] < -1.0  # downhill


def test_a_slide_on_level_ground_is_as_long_as_friction_says() -> None:
    dyn = on_slope(0.0)
    dyn.resting[:] = False
    run(dyn, 0.2)
    dyn.resting[:] = False
    start = dyn.pos[0, 0]
    dyn.vel[0] = 3.0
    run(dyn, 3.0)
    assert dyn.resting[0]
    assert dyn.pos[0, 0] - start == pytest.approx(9.0 / (2.0 * FRICTION * GRAVITY), rel=0.12)


def test_the_ground_takes_energy_and_gives_none() -> None:
    dyn = on_slope(0.2, height=1.0)
    dyn.vel[:, 0] = (1.0, -0.5, 0.0)

    def mechanical() -> float:
        """Against the world's origin: kinetic, and that of height."""
        over_ground = float(dyn.energy()[0])
        return over_ground - dyn.airframe.weight_n * float(dyn.terrain.down(dyn.pos[0], dyn.pos[1])[0])

    last = mechanical()
    spring = dyn.airframe.weight_n * SINK_M  # may be in the feet meanwhile, a few times that
    for _ in range(60):
        run(dyn, 0.05)
        assert mechanical() < last + 10.0 * spring
        last = min(last, mechanical())
    assert dyn.resting[0]


def test_rotors_near_the_ground_carry_more_as_cheeseman_and_bennett_found() -> None:
    ground = Ground(Terrain(), np.zeros((3, 4)), 10.0, (0.127, 0.15))
    for height in (0.0, 0.1, 0.4):
        expected = 1.0 / (1.0 - (0.127 / (4.0 * (height + 0.15))) ** 2)
        assert ground.cushion(np.array([height]))[0] == pytest.approx(expected)


def test_a_copter_flies_from_a_slope_and_lands_on_it(make_desk: MakeDesk) -> None:
    terrain = Terrain(slope_north=0.15, slope_east=-0.1)
    desk = make_desk([VehicleSpec()], terrain=terrain)
    desk.take_off(4.0)
    desk.goto(6.0, 3.0, -4.0)
    desk.until(lambda: desk.near(6.0, 3.0, -4.0))
    assert desk.command(176, 1, 9) == 0
    desk.until(lambda: not desk.vehicle.copter.armed, 40.0)
    assert desk.ned[2] == pytest.approx(float(terrain.down(np.array(6.0), np.array(3.0))), abs=0.15)
    there = desk.ned
    desk.world.step(5.0)
    assert desk.ned == there
