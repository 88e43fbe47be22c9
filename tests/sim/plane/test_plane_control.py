"""The plane's controllers: attitude, L1 guidance and total energy, without an autopilot's rules."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import msgspec
import numpy as np
import pytest

from zmav.sim.arrays import Array
from zmav.sim.control.planetargets import GAINS, PlaneHandle, Stage
from zmav.sim.dynamics.airframe import GRAVITY
from zmav.sim.dynamics.wing import TRAINER, Wing
from zmav.sim.environment import Environment, Vector
from zmav.sim.fleets.base import Surroundings
from zmav.sim.fleets.plane import PlaneFleet
from zmav.sim.protocol.params import ParamStore, defaults

UP = math.radians(25.0)
TICK = 0.01


class Flight:
    """Planes in the air at 100 m to the north at 22 m/s, flown by their controllers alone; one for each ``winds``."""

    def __init__(
        self, n: int = 1, winds: Sequence[Vector] = (), gusts: str = "none", frame: Wing | None = None
    ) -> None:
        n = max(n, len(winds))
        start = np.zeros((3, n))
        start[2] = -100.0
        around = Surroundings(environment=Environment(winds[0] if gusts != "none" else (0.0, 0.0, 0.0), gusts=gusts))
        self.fleet = PlaneFleet(frame or TRAINER, start, np.zeros(n), 1 / 200, around)
        self.handles: list[PlaneHandle] = [self.fleet.handle(i) for i in range(n)]
        params = ParamStore(defaults("arduplane"))
        for handle in self.handles:
            for name in GAINS:
                handle.gain(name, params[name])
            handle.flying(True)
            handle.roll(0.0)
            handle.energy(100.0, 22.0)
            handle.limits(roll=math.radians(65.0), pitch=(-0.35, UP), throttle=(0.0, 1.0))
        dyn = self.fleet.dynamics
        if winds:
            dyn.wind[:] = np.array(winds).T
        dyn.airspeed[:] = 22.0 * self.fleet.control.eas2tas
        dyn.vel[0] = dyn.airspeed + dyn.wind[0]
        dyn.vel[1] = dyn.wind[1]
        dyn.throttle[:] = 0.5
        dyn.contact[:] = dyn.resting[:] = False
        self.plane = self.handles[0]

    def fly(self, seconds: float) -> None:
        for _ in range(round(seconds / TICK)):
            self.fleet.advance(2)

    @property
    def euler(self) -> Array:
        """(3, N) degrees."""
        return np.degrees(self.fleet.estimate.euler)

    @property
    def eas(self) -> Array:
        return self.fleet.dynamics.airspeed / self.fleet.control.eas2tas

    @property
    def pos(self) -> Array:
        return self.fleet.dynamics.pos

    def watch(self, seconds: float, look: Callable[[], Array]) -> Array:
        """What ``look`` gives (N,), ten times a second: (times, N)."""
        found = []
        for _ in range(round(seconds * 10)):
            self.fly(0.1)
            found.append(look().copy())
        return np.array(found)


def test_a_bank_is_there_within_a_second_and_hardly_overshoots() -> None:
    angles = np.array([-60.0, 30.0, 45.0])
    flight = Flight(n=3)
    flight.fly(4.0)
    for handle, angle in zip(flight.handles, angles, strict=True):
        handle.roll(math.radians(angle))
    found = flight.watch(4.0, lambda: flight.euler[0])
    assert found[12] == pytest.approx(angles, abs=3.0)
    assert (np.abs(found).max(0) < np.abs(angles) + 3.0).all()
    assert found[-1] == pytest.approx(angles, abs=1.0)


def test_a_pitch_is_held() -> None:
    angles = np.array([-10.0, 12.0])
    flight = Flight(n=2)
    flight.fly(4.0)
    for handle, angle in zip(flight.handles, angles, strict=True):
        handle.pitch(math.radians(angle))
        handle.power(0.6)
    found = flight.watch(4.0, lambda: flight.euler[1])
    assert found[-1] == pytest.approx(angles, abs=1.5)
    assert (np.abs(found).max(0) < np.abs(angles) + 5.0).all()


def turn_rates(frame: Wing) -> tuple[Array, Array]:
    """Of level turns at three banks: as flown, and as g tan(phi) / V has them."""
    flight = Flight(n=3, frame=frame)
    for handle, angle in zip(flight.handles, (20.0, 40.0, 55.0), strict=True):
        handle.roll(math.radians(angle))
    flight.fly(12.0)
    before = flight.euler[2].copy()
    flight.fly(1.0)
    assert np.abs(flight.fleet.dynamics.vel[2]).max() < 0.6
    speed = flight.fleet.dynamics.airspeed
    return np.radians((flight.euler[2] - before) % 360.0), GRAVITY * np.tan(np.radians(flight.euler[0])) / speed


def test_a_turn_without_sideslip_is_coordinated() -> None:
    # Nothing that a turn must overcome with sideslip.
    flown, coordinated = turn_rates(
        msgspec.structs.replace(TRAINER, yaw_r=-0.02, yaw_p=0.0, yaw_rudder=0.0, side_rudder=0.0)
    )
    assert flown == pytest.approx(coordinated, rel=0.03)


def test_the_trainer_turns_somewhat_wider_as_it_slips() -> None:
    # Recorded: 23.5 m/s over the ground at 37.9 degrees round a circle of 96 m, where 72 m would be coordinated.
    flown, coordinated = turn_rates(TRAINER)
    assert flown[1] / coordinated[1] == pytest.approx(72.0 / 96.0, abs=0.06)


def test_a_line_is_captured_and_kept_in_any_wind() -> None:
    winds = [(0.0, 0.0, 0.0), (0.0, 8.0, 0.0), (-9.0, -3.0, 0.0)]
    flight = Flight(winds=winds)
    for handle in flight.handles:
        handle.line((0.0, 120.0), (4000.0, 120.0))
    flight.fly(42.0)
    assert flight.pos[1] == pytest.approx(np.full(3, 120.0), abs=2.0)
    assert (flight.pos[0] > 250.0).all()
    assert abs(flight.plane.flown().cross_track) < 2.0
    # They head into the wind by as much as that takes.
    across = np.array([wind[1] for wind in winds]) / flight.fleet.dynamics.airspeed
    assert flight.euler[2] == pytest.approx(-np.degrees(np.arcsin(across)), abs=3.0)


def test_behind_its_start_a_line_is_joined_there_and_beyond_its_end_it_turns_back() -> None:
    flight = Flight(n=2)
    flight.handles[0].line((-1000.0, 300.0), (-2000.0, 300.0))
    flight.handles[1].line((-400.0, 0.0), (-380.0, 0.0))
    flight.fly(20.0)
    assert flight.fleet.dynamics.vel[0, 0] < -15.0
    assert math.hypot(flight.pos[0, 1] + 380.0, flight.pos[1, 1]) < 350.0


def test_circles_are_held_the_way_round_that_is_asked() -> None:
    radii = np.array([85.0, -85.0, 200.0, 85.0, -85.0])
    flight = Flight(winds=[(0.0, 0.0, 0.0)] * 3 + [(6.0, 0.0, 0.0)] * 2)
    for handle, radius in zip(flight.handles, radii, strict=True):
        handle.circle((150.0, 0.0), float(radius))
    flight.fly(32.0)
    assert all(handle.flown().circling for handle in flight.handles)
    for _ in range(12):
        flight.fly(1.0)
        north, east = flight.pos[0] - 150.0, flight.pos[1]
        off = np.hypot(north, east) / np.abs(radii)
        # As the real one, they fly somewhat outside.
        assert (off > 0.93).all()
        assert (off < [1.25, 1.25, 1.25, 1.6, 1.6]).all()
        around = north * flight.fleet.dynamics.vel[1] - east * flight.fleet.dynamics.vel[0]
        assert ((around > 0.0) == (radii > 0.0)).all()


def test_a_heading_is_flown() -> None:
    flight = Flight()
    flight.plane.fly_heading(math.radians(135.0))
    flight.fly(16.0)
    assert flight.euler[2, 0] == pytest.approx(135.0, abs=2.0)


def test_climbs_and_descents_are_as_fast_as_allowed_and_keep_the_speed() -> None:
    flight = Flight(n=2)
    flight.fly(3.0)
    goals = np.array([150.0, 60.0])
    for handle, goal in zip(flight.handles, goals, strict=True):
        handle.energy(float(goal), 22.0)
    seen = flight.watch(22.0, lambda: np.concatenate([-flight.pos[2], flight.eas]))
    ups, speeds = seen[:, :2], seen[:, 2:]
    climbs = np.diff(ups, axis=0) / 0.1
    assert 4.5 < climbs[:, 0].max() < 6.0  # TECS_CLMB_MAX
    assert 4.0 < -climbs[:, 1].min() < 6.0  # TECS_SINK_MAX
    assert ups[-1] == pytest.approx(goals, abs=1.0)
    assert ups[:, 0].max() < 154.0
    assert ups[:, 1].min() > 57.0
    assert speeds[-1] == pytest.approx([22.0, 22.0], abs=0.4)
    assert speeds.min() > 19.0
    assert speeds.max() < 25.0


def test_another_airspeed_is_taken_up_at_the_same_height() -> None:
    goals = np.array([14.0, 27.0])
    flight = Flight(n=2)
    flight.fly(3.0)
    for handle, goal in zip(flight.handles, goals, strict=True):
        handle.energy(100.0, float(goal))
    ups = flight.watch(24.0, lambda: -flight.pos[2])
    assert flight.eas == pytest.approx(goals, abs=0.5)
    assert ups.min() > 92.0
    assert ups.max() < 108.0
    assert ups[-1] == pytest.approx([100.0, 100.0], abs=1.5)


def test_without_an_engine_it_keeps_its_speed_and_glides() -> None:
    flight = Flight()
    flight.fly(3.0)
    flight.plane.energy(400.0, 22.0)
    flight.plane.limits(roll=1.1, pitch=(-0.35, UP), throttle=(0.0, 0.0))
    speeds = flight.watch(12.0, lambda: flight.eas)
    assert speeds[30:].min() > 8.0  # the stall is at 6.8
    assert float(flight.fleet.dynamics.alpha[0]) < 0.2
    assert flight.fleet.dynamics.vel[2, 0] > 1.0


def test_it_banks_no_more_than_its_airspeed_carries() -> None:
    flight = Flight(n=2)
    for handle in flight.handles:
        handle.energy(100.0, 11.0)
    flight.handles[1].gain("STALL_PREVENTION", 0.0)
    flight.fly(20.0)
    for handle in flight.handles:
        handle.roll(math.radians(60.0))
    flight.fly(1.2)
    assert 20.0 < flight.euler[0, 0] < 40.0
    assert flight.euler[0, 1] > 45.0


def test_a_flare_lets_it_down_softly() -> None:
    flight = Flight()
    flight.plane.energy(100.0, 16.0)
    flight.fly(20.0)
    flight.plane.energy(60.0, 16.0)
    flight.plane.stage(Stage.LAND, 90.0)
    while -flight.pos[2, 0] > 96.5:
        flight.fly(0.05)
    flight.plane.energy(90.0, 16.0)
    flight.plane.stage(Stage.FLARE, 90.0)
    flight.plane.power(0.0)
    while -flight.pos[2, 0] > 90.2:
        flight.fly(0.02)
    assert 0.0 < flight.fleet.dynamics.vel[2, 0] < 1.2
    assert -3.0 < flight.euler[1, 0] < 8.0


def test_gusts_shake_it_and_it_stays_on_its_circle() -> None:
    flight = Flight(winds=[(5.0, 3.0, 0.0)], gusts="moderate")
    flight.plane.circle((0.0, 0.0), 120.0)
    for _ in range(24):
        flight.fly(1.0)
        assert 85.0 < -flight.pos[2, 0] < 115.0
        assert 14.0 < flight.eas[0] < 32.0
    assert math.hypot(flight.pos[0, 0], flight.pos[1, 0]) < 220.0


def test_planes_of_a_fleet_fly_their_own_ways() -> None:
    flight, alone = Flight(n=3), Flight()
    flight.handles[0].circle((0.0, 0.0), 90.0)
    flight.handles[1].line((0.0, 50.0), (3000.0, 50.0))
    flight.handles[2].roll(math.radians(-30.0))
    alone.plane.circle((0.0, 0.0), 90.0)
    flight.fly(6.0)
    alone.fly(6.0)
    assert np.allclose(flight.pos[:, 0], alone.pos[:, 0], atol=1e-6)
    assert flight.pos[1, 1] > 8.0
    assert flight.euler[0, 2] == pytest.approx(-30.0, abs=2.0)


def test_no_gain_makes_the_numbers_vanish() -> None:
    flight = Flight(n=2)
    for name, (low, high) in GAINS.items():
        flight.handles[0].gain(name, -1e30)
        flight.handles[1].gain(name, 1e30)
        assert flight.fleet.targets.gains[name].tolist() == [low, high]
    for handle in flight.handles:
        handle.circle((100.0, 100.0), 50.0)
    flight.fly(10.0)
    assert np.isfinite(flight.pos).all()
    assert np.isfinite(flight.fleet.control.surface).all()
