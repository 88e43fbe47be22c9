"""PX4's loops: each one's step response against the closed form of its order, what its parameters do, and a real
vehicle's recorded answer.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from tests.sim.conftest import MakeGcs
from zmav.sim import VehicleSpec
from zmav.sim.arrays import body_z
from zmav.sim.control.allocation import Allocator
from zmav.sim.control.setpoints import Axis, SetpointHandle, Spool
from zmav.sim.dynamics.airframe import airframe
from zmav.sim.environment import Environment
from zmav.sim.fleets.base import Surroundings
from zmav.sim.fleets.copter import CopterFleet

TICK = 0.01


class Flight:
    """N multirotors under PX4's loops that hover 100 m up; the first one is told what to do."""

    def __init__(self, kind: str, n: int = 1, *, px4: bool = True) -> None:
        start = np.zeros((3, n))
        start[2] = -100.0
        around = Surroundings(environment=Environment())
        self.fleet = CopterFleet(airframe(kind), start, np.zeros(n), TICK / 2, around, px4=px4)
        frame = self.fleet.airframe
        self.fleet.dynamics.rotor[:] = math.sqrt(frame.hover_thrust_n / frame.thrust_max_n)
        self.handles = [self.fleet.handle(i) for i in range(n)]
        for sp in self.handles:
            sp.spool(Spool.FLY)
            sp.raw(px4)
            sp.move(pos=(0.0, 0.0, -100.0))
            sp.limit("lean", math.radians(45.0))
        self.run(1.0)

    @property
    def sp(self) -> SetpointHandle:
        return self.handles[0]

    def run(self, seconds: float, look: Callable[[], float] | None = None) -> list[float]:
        values = []
        for _ in range(round(seconds / TICK)):
            self.fleet.advance(2)
            if look is not None:
                values.append(look())
        return values

    def carry(self) -> None:
        self.sp.direct_thrust(self.fleet.airframe.hover_thrust_n / self.fleet.airframe.thrust_max_n)


@pytest.fixture(params=["sih", "hexa"])
def flight(request: pytest.FixtureRequest) -> Flight:
    return Flight(request.param)


def test_a_torque_turns_the_body_as_newton_says(flight: Flight) -> None:
    dyn, frame = flight.fleet.dynamics, flight.fleet.airframe
    torque_nm = Allocator(frame).torque_nm
    for axis, share in enumerate((0.02, -0.02, 0.02)):
        flight.carry()
        torque = [0.0, 0.0, 0.0]
        torque[axis] = share
        before = float(dyn.rate[axis, 0])
        flight.sp.torque(*torque)
        flight.run(0.3)
        settled = 0.3 - frame.rotor_tau_s  # the rotors' lag costs its time constant
        turned = float(dyn.rate[axis, 0]) - before
        damping = 1.0 if frame.spin_drag == 0.0 else 1.0 - 0.5 * settled * frame.spin_drag / frame.inertia_kgm2[axis]
        expected = share * torque_nm[axis] / frame.inertia_kgm2[axis] * settled * damping
        assert turned == pytest.approx(expected, rel=0.2)
        flight.sp.move(pos=tuple(dyn.pos[:, 0].tolist()))
        flight.run(2.0)


@pytest.mark.parametrize(("axis", "name"), [(0, "roll"), (1, "pitch")])
def test_a_rate_is_reached_as_by_a_first_order_lag_of_its_gain(flight: Flight, axis: int, name: str) -> None:
    """P alone: time constant 1 / (P * highest torque / inertia), and the rotors' lag before it."""
    frame, gains = flight.fleet.airframe, flight.fleet.setpoints.gains
    for each in ("rate_i", "rate_d"):
        flight.sp.tune(each, (0, 1, 2), 0.0)
    flight.sp.tune("rate_p", (0, 1), 0.03)
    flight.carry()
    gain = 0.03 * Allocator(frame).torque_nm[axis] / frame.inertia_kgm2[axis]
    drag = frame.spin_drag / frame.inertia_kgm2[axis]
    wanted = [0.0, 0.0, 0.0]
    wanted[axis] = 0.5
    flight.sp.rates(wanted[0], wanted[1], wanted[2])
    values = flight.run(3.0 / gain, lambda: float(flight.fleet.dynamics.rate[axis, 0]))
    final = 0.5 * gain / (gain + drag)
    reached = next(i for i, v in enumerate(values) if v >= 0.632 * final) * TICK
    assert reached == pytest.approx(1.0 / (gain + drag) + frame.rotor_tau_s, rel=0.25)
    assert max(values) < 1.12 * final
    assert gains.rate_p[axis, 0] == 0.03


def test_an_attitude_follows_its_own_gain(flight: Flight) -> None:
    """The rate loop is quicker: seen from outside a lag of 1 / MC_ROLL_P and what the rates take."""
    flight.carry()
    flight.sp.tune("angle_p", (0,), 2.0)
    flight.sp.lean(math.radians(10.0), 0.0)
    values = np.degrees(flight.run(3.0, lambda: float(flight.fleet.estimate.euler[0, 0])))
    rise = float((values > 6.32).argmax() + 1) * TICK
    assert rise == pytest.approx(1.0 / 2.0 + 0.1, abs=0.12)
    assert values.max() < 11.0
    assert values[-1] == pytest.approx(10.0, abs=0.5)


def test_default_gains_settle_quickly_without_ringing(flight: Flight) -> None:
    flight.carry()
    flight.sp.lean(math.radians(20.0), 0.0)
    values = np.degrees(flight.run(2.0, lambda: float(flight.fleet.estimate.euler[0, 0])))
    assert 0.1 < float((values > 18.0).argmax() + 1) * TICK < 0.4
    assert values.max() < 1.15 * 20.0
    assert np.abs(values[100:] - 20.0).max() < 1.0


def test_a_velocity_step_is_answered_as_a_real_one_was_recorded() -> None:
    """PX4 1.16.1, simulation in hardware: 2 m/s asked for in OFFBOARD, m/s so many seconds later."""
    recorded = {0.44: 0.80, 0.78: 1.11, 1.10: 1.29, 1.44: 1.36, 2.10: 1.50, 2.77: 1.54, 3.77: 1.67}
    flight = Flight("sih")
    flight.sp.move(vel=(2.0, 0.0, 0.0), horizontal=Axis.VELOCITY, vertical=Axis.VELOCITY)
    values = flight.run(4.0, lambda: float(flight.fleet.dynamics.vel[0, 0]))
    for seconds, speed in recorded.items():
        assert values[round(seconds / TICK) - 1] == pytest.approx(speed, abs=0.12)


def test_a_position_is_approached_as_by_its_gain(flight: Flight) -> None:
    flight.sp.limit("speed", 12.0)
    flight.sp.move(pos=(1.0, 0.0, -100.0))
    values = flight.run(10.0, lambda: float(flight.fleet.dynamics.pos[0, 0]))
    rise = next(i for i, v in enumerate(values) if v > 0.632) * TICK
    assert rise == pytest.approx(1.0 / 0.95 + 0.4, abs=0.4)  # MPC_XY_P, and what the velocity takes
    assert max(values) < 1.25
    assert values[-1] == pytest.approx(1.0, abs=0.1)


def test_thrust_is_turned_first_and_the_nose_takes_its_time() -> None:
    """A lean and a large turn asked for at once: the axis of thrust is there as soon as without the turn."""
    flight = Flight("hexa", 2)
    for sp, yaw in zip(flight.handles, (0.0, 150.0), strict=True):
        sp.direct_thrust(flight.fleet.airframe.hover_thrust_n / flight.fleet.airframe.thrust_max_n)
        sp.lean(0.3, 0.0)
        sp.heading(math.radians(yaw))
    flight.run(0.5)
    lean = np.degrees(np.arccos(body_z(flight.fleet.dynamics.q)[2]))
    assert lean == pytest.approx([math.degrees(0.3)] * 2, abs=2.5)
    assert math.degrees(float(flight.fleet.estimate.euler[2, 1])) < 75.0


def test_a_small_turn_is_asked_for_by_its_gain_whatever_its_weight(flight: Flight) -> None:
    for weight in (0.4, 1.0):
        flight.sp.tune("yaw_weight", (), weight)
        heading = float(flight.fleet.estimate.euler[2, 0])
        flight.sp.heading(heading + 0.05)
        flight.run(2 * TICK)
        assert flight.fleet.cascade.want_rate[2, 0] == pytest.approx(2.8 * 0.05, rel=0.1)  # MC_YAW_P
        flight.run(3.0)


def test_what_the_rotors_cannot_give_winds_up_nothing() -> None:
    """A torque beyond reach for two seconds, then none: the integrators carry nothing over."""
    flight = Flight("hexa")
    flight.carry()
    flight.sp.tune("rate_max", (0, 1, 2), 100.0)
    for _ in range(5):
        flight.sp.rates(0.0, 0.0, 30.0)
        flight.run(0.2)
    kept = abs(float(flight.fleet.cascade.rate_i[2, 0]))
    assert kept < 0.02


class TestParameters:
    def test_each_vehicle_has_its_own(self, make_gcs: MakeGcs) -> None:
        specs = [VehicleSpec(autopilot="px4", params={"MC_ROLLRATE_P": 0.2}), VehicleSpec(autopilot="px4")]
        gcs = make_gcs(specs)
        fleet = gcs.vehicle.node.seat.fleet
        assert isinstance(fleet, CopterFleet)
        gains = fleet.setpoints.gains
        assert gains.rate_p[0] == pytest.approx([0.2, 0.15])
        gcs.world.vehicles[1].px4.params.set("MPC_XY_VEL_I_ACC", 0.9)
        assert gains.vel_i[0] == pytest.approx([0.4, 0.9])
        gcs.world.vehicles[1].px4.params.set("MC_PITCHRATE_MAX", 90.0)
        assert gains.rate_max[1] == pytest.approx([math.radians(220.0), math.pi / 2])

    def test_a_hexarotors_are_those_of_its_airframe(self, make_gcs: MakeGcs) -> None:
        params = make_gcs([VehicleSpec(autopilot="px4", airframe="hexa")]).vehicle.px4.params
        assert (params["CA_ROTOR_COUNT"], params["SYS_AUTOSTART"], params["CA_FAILURE_MODE"]) == (6, 6001, 1)
        assert params["CA_ROTOR5_PX"] == pytest.approx(0.275 * math.cos(math.radians(330.0)), abs=1e-3)


class TestAllocation:
    @pytest.mark.parametrize("kind", ["sih", "hexa"])
    def test_what_fits_is_given_in_full(self, kind: str) -> None:
        frame = airframe(kind)
        allocator = Allocator(frame)
        torque = np.array([[0.1], [-0.05], [0.08]])
        share, missed = allocator.allocate(torque, np.array([0.5]))
        wrench = frame.wrench_matrix() @ (share[:, 0] * frame.thrust_max_n)
        assert wrench[0] == pytest.approx(0.5 * len(frame.rotors) * frame.thrust_max_n)
        assert wrench[1:] == pytest.approx(torque[:, 0] * allocator.torque_nm)
        assert missed is None

    def test_yaw_gives_way_first_then_height(self) -> None:
        allocator = Allocator(airframe("sih"))
        share, missed = allocator.allocate(np.array([[0.3], [0.0], [0.9]]), np.array([0.6]))
        assert share.min() >= 0.0
        assert share.max() <= 1.0
        assert missed is not None and missed[2, 0] > 0.3
        assert abs(missed[0, 0]) < 1e-9
        share, _ = allocator.allocate(np.array([[0.5], [0.0], [0.0]]), np.array([1.0]))
        assert share.mean() < 0.7  # lower, but level
        _, missed = allocator.allocate(np.array([[0.5], [0.0], [0.0]]), np.array([1.0]))
        assert missed is not None and abs(missed[0, 0]) < 1e-9


@pytest.mark.parametrize("kind", ["quad", "sih"])
def test_a_quadrotor_without_a_rotor_comes_down(kind: str) -> None:
    flight = Flight(kind, px4=kind == "sih")
    flight.fleet.dynamics.efficiency[0, 0] = 0.0
    flight.run(5.0)
    assert flight.fleet.dynamics.pos[2, 0] > -80.0
