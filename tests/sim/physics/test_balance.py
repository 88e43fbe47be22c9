"""Energy and momentum in air, terminal speeds, and the same seed giving the same bits."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from tests.sim.conftest import MakeGcs
from tests.sim.physics.closed_forms import energy
from zmav.sim import VehicleSpec
from zmav.sim.dynamics.airframe import GRAVITY, airframe
from zmav.sim.dynamics.copter import CopterDynamics

DT = 1 / 200
HIGH_M = 5000.0  # over the ground


def free(kind: str, **changes: float) -> CopterDynamics:
    frame = msgspec.structs.replace(airframe(kind), **changes)
    return CopterDynamics(frame, np.array([[0.0], [0.0], [-HIGH_M]]), np.zeros(1), DT)


def run(dyn: CopterDynamics, seconds: float) -> None:
    for _ in range(round(seconds / DT)):
        dyn.step()


@pytest.mark.parametrize("kind", ["quad", "hexa", "sih"])
def test_air_takes_energy_and_gives_none(kind: str) -> None:
    dyn = free(kind)
    dyn.vel[:, 0] = (14.0, -6.0, -9.0)
    dyn.rate[:, 0] = (1.0, -0.5, 0.3)
    last = float(energy(dyn, -HIGH_M)[0])
    lost = last
    for _ in range(30):
        run(dyn, 0.1)
        now = float(energy(dyn, -HIGH_M)[0])
        assert now <= last + 1e-6 * abs(last)
        last = now
    if dyn.airframe.drag_area_m2 > 0.0:
        assert last < lost - 5.0


@pytest.mark.parametrize("kind", ["quad", "hexa"])
def test_drag_alone_slows_as_one_over_time(kind: str) -> None:
    """m v' = -k v^2: v = v0 / (1 + k v0 t / m)."""
    dyn = free(kind)
    dyn.vel[0] = 20.0
    dyn.density[:] = 1.0
    frame = dyn.airframe
    for _ in range(200):
        dyn.step()
        dyn.vel[2] = 0.0  # held up
    k = 0.5 * frame.drag_area_m2 / frame.mass_kg
    assert dyn.vel[0, 0] == pytest.approx(20.0 / (1.0 + k * 20.0 * 1.0), rel=1e-3)


@pytest.mark.parametrize("kind", ["quad", "hexa"])
def test_level_terminal_speed_under_a_lean(kind: str) -> None:
    """What leans at a constant height goes as fast as g tan(lean) m = k v^2 + c cos^2(lean) v, c at this thrust."""
    dyn = free(kind, inflow_mps=0.0)
    frame, lean = dyn.airframe, math.radians(25.0)
    k, c = 0.5 * float(dyn.density[0]) * frame.drag_area_m2, frame.rotor_drag_kgps
    hover = frame.hover_thrust_n
    for _ in range(3000):
        dyn.q[:, 0] = (math.cos(lean / 2), 0.0, -math.sin(lean / 2), 0.0)
        dyn.rate[:] = 0.0
        # The thrust that keeps the height: drag of the discs has a part along the vertical too.
        in_plane = dyn.vel[0, 0] * math.cos(lean)
        share = (hover / math.cos(lean)) / frame.thrust_max_n
        share += c * in_plane * math.sin(lean) / math.cos(lean) / len(frame.rotors) / frame.thrust_max_n * 1.03
        dyn.rotor[:] = math.sqrt(share)
        linear, square = 1.0 - frame.thrust_expo, frame.thrust_expo
        dyn.throttle[:] = (math.sqrt(linear**2 + 4 * square * share) - linear) / (2 * square)
        dyn.step()
        dyn.vel[2] = 0.0
    speed, thrust = float(dyn.vel[0, 0]), float(dyn.thrust.sum())
    disc = c * math.sqrt(thrust / frame.weight_n) * math.cos(lean) ** 2
    assert thrust * math.sin(lean) == pytest.approx(k * speed * speed + disc * speed, rel=1e-3)
    assert 6.0 < speed < 20.0


def test_a_rotor_that_climbs_carries_less_as_its_advance_ratio_says() -> None:
    dyn = free("hexa")
    frame = dyn.airframe
    dyn.rotor[:] = dyn.throttle[:] = 1.0
    for climb in (0.0, 5.0, 10.0):
        dyn.vel[:, 0] = (0.0, 0.0, -climb)
        dyn.step()
        assert dyn.thrust[0, 0] == pytest.approx(frame.thrust_max_n * (1.0 - climb / 22.6), rel=2e-2)


def test_thrust_goes_with_the_density_of_the_air_and_the_square_of_the_supply() -> None:
    dyn = free("hexa", inflow_mps=0.0)
    dyn.throttle[:] = 0.7
    run(dyn, 1.0)
    full = float(dyn.thrust.sum())
    dyn.density[:] = 0.9 * dyn.airframe.air_density
    dyn.supply[:] = 0.8
    run(dyn, 1.0)
    assert dyn.thrust.sum() == pytest.approx(full * 0.9 * 0.64, rel=1e-6)


def test_a_failed_rotor_gives_nothing_and_a_weak_one_its_share() -> None:
    dyn = free("hexa", inflow_mps=0.0)
    dyn.efficiency[:, 0] = (1.0, 0.0, 0.5, 1.0, 1.0, 1.0)
    dyn.throttle[:] = 0.6
    run(dyn, 1.0)
    assert dyn.thrust[:3, 0] / dyn.thrust[5, 0] == pytest.approx([1.0, 0.0, 0.5])


def test_weight_is_what_a_scale_would_show() -> None:
    assert airframe("hexa").weight_n == pytest.approx(3.2 * GRAVITY)


def _fly(make_gcs: MakeGcs, specs: list[VehicleSpec], **options: object) -> list[float]:
    """Ten seconds of the first vehicle in gusts, as numbers."""
    gcs = make_gcs(specs, gusts="moderate", wind=(4.0, 1.0, 0.0), noise="typical", **options)
    gcs.take_off(6.0)
    gcs.goto(15.0, -5.0, -8.0)
    path = []
    for _ in range(50):
        gcs.world.step(0.1)
        path += [*gcs.vehicle.node.brain.sense]
    return path


def test_a_seed_gives_its_own_bits_whoever_else_flies(make_gcs: MakeGcs) -> None:
    """The same each time, others than another seed, and the same for the first of several vehicles."""
    alone, again, other = (_fly(make_gcs, [VehicleSpec()], seed=seed) for seed in (5, 5, 6))
    assert alone == again
    assert np.abs(np.array(alone[:300]) - np.array(other[:300])).max() > 0.01
    among = _fly(make_gcs, [VehicleSpec(), VehicleSpec(), VehicleSpec(autopilot="px4")], seed=5)
    assert np.abs(np.array(alone) - np.array(among)).max() < 1e-9
