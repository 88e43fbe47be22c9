"""Step responses of every loop of the cascade, and what limits them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zmav.sim.control.gains import arducopter_gains
from zmav.sim.control.reference import root_speed
from zmav.sim.control.setpoints import Axis, SetpointHandle, Spool
from zmav.sim.dynamics.airframe import airframe
from zmav.sim.dynamics.copter import CopterDynamics
from zmav.sim.environment import Environment
from zmav.sim.fleets.base import DEFAULT_PLACE, Sense, Surroundings
from zmav.sim.fleets.copter import CopterFleet
from zmav.sim.sensors.estimate import Estimator
from zmav.sim.sensors.noise import NONE
from zmav.sim.sensors.suite import SensorSuite

if TYPE_CHECKING:
    from tests.sim.conftest import MakeGcs

DT, STEPS = 1 / 200, 2


class Hover:
    """One copter that hovers at the origin, 100 m up."""

    def __init__(self, kind: str, *, px4: bool = False) -> None:
        start, around = np.array([[0.0], [0.0], [-100.0]]), Surroundings(environment=Environment())
        self.fleet = CopterFleet(airframe(kind), start, np.zeros(1), DT, around, px4=px4)
        self.fleet.dynamics.rotor[:] = math.sqrt(self.fleet.airframe.hover_thrust_n / self.fleet.airframe.thrust_max_n)
        self.sp: SetpointHandle = self.fleet.handle(0)
        self.sp.spool(Spool.FLY)
        self.sp.move(pos=(0.0, 0.0, -100.0))
        self.run(0.5)

    def run(self, seconds: float, look: Callable[[float, Sense], None] | None = None) -> Sense:
        ticks = round(seconds / DT / STEPS)
        for tick in range(ticks):
            self.fleet.advance(STEPS)
            if look is not None:
                look((tick + 1) * DT * STEPS, self.fleet.senses()[0])
        return self.fleet.senses()[0]

    def record(self, seconds: float, field: str) -> np.ndarray:
        values: list[float] = []
        self.run(seconds, lambda t, sense: values.append(getattr(sense, field)))
        return np.array(values)


@pytest.fixture(params=["quad", "hexa"])
def hover(request: pytest.FixtureRequest) -> Hover:
    return Hover(request.param)


@pytest.fixture
def quad() -> Hover:
    return Hover("quad")


def rise_time(values: np.ndarray, target: float) -> float:
    """Seconds to nine tenths of ``target``."""
    return float((values / target > 0.9).argmax() + 1) * DT * STEPS


def test_hover_is_still(hover: Hover) -> None:
    sense = hover.run(5.0)
    assert abs(sense.down + 100.0) < 0.02
    assert math.hypot(sense.north, sense.east) < 0.01
    # The air is a little thinner than where it stood.
    assert sense.throttle == pytest.approx(hover.fleet.airframe.hover_throttle, rel=0.01)


@pytest.mark.parametrize("field", ["roll", "pitch"])
def test_attitude_step(hover: Hover, field: str) -> None:
    target = math.radians(20.0)
    hover.sp.lean(target if field == "roll" else 0.0, target if field == "pitch" else 0.0)
    values = hover.record(2.0, field)
    assert rise_time(values, target) < 0.5
    assert values.max() < 1.2 * target
    assert values[-1] == pytest.approx(target, abs=math.radians(0.5))


def test_yaw_step_turns_at_the_allowed_rate_and_does_not_swing(hover: Hover) -> None:
    hover.sp.heading(math.radians(170.0))
    values = np.degrees(hover.record(6.0, "yaw"))
    rates = np.diff(values) / (DT * STEPS)
    assert rates[120:200].mean() == pytest.approx(60.0, abs=2.0)  # ATC_SLEW_YAW
    assert rates.max() < 80.0  # it starts late and catches up
    assert values.max() < 172.0
    assert values[-1] == pytest.approx(170.0, abs=0.5)


def test_yaw_takes_the_short_way(quad: Hover) -> None:
    quad.sp.heading(math.radians(-90.0))
    assert quad.record(1.0, "yaw").max() < 0.01
    quad.run(4.0)
    quad.sp.heading(math.radians(179.0))
    assert quad.record(3.0, "yaw").max() > math.radians(178.0)


def test_velocity_step(hover: Hover) -> None:
    hover.sp.move(vel=(5.0, 0.0, 0.0), horizontal=Axis.VELOCITY, vertical=Axis.VELOCITY)
    values = hover.record(6.0, "vn")
    assert 2.0 < rise_time(values, 5.0) < 3.5  # 2.5 m/s^2, eased in and out
    assert values.max() < 5.5
    assert values[-1] == pytest.approx(5.0, abs=0.15)
    assert abs(hover.fleet.senses()[0].down + 100.0) < 0.2


def test_position_step_keeps_the_limits_and_does_not_overshoot(quad: Hover) -> None:
    quad.sp.move(pos=(60.0, 0.0, -100.0))
    speeds = quad.record(14.0, "vn")
    end = quad.fleet.senses()[0]
    assert 9.0 < speeds.max() < 10.6  # WPNAV_SPEED
    assert abs(end.north - 60.0) < 0.3
    quad.sp.move(pos=(65.0, 0.0, -100.0))
    assert quad.record(8.0, "north").max() < 65.5


def test_climb_and_descent_keep_their_speeds(quad: Hover) -> None:
    quad.sp.move(pos=(0.0, 0.0, -120.0))
    assert quad.record(11.0, "vd").min() == pytest.approx(-2.5, abs=0.1)  # WPNAV_SPEED_UP
    assert quad.fleet.senses()[0].down == pytest.approx(-120.0, abs=0.2)
    quad.sp.move(pos=(0.0, 0.0, -110.0))
    assert quad.record(11.0, "vd").max() == pytest.approx(1.5, abs=0.1)  # WPNAV_SPEED_DN
    assert quad.fleet.senses()[0].down == pytest.approx(-110.0, abs=0.2)


def test_limits_can_be_lowered(quad: Hover) -> None:
    quad.sp.limit("speed", 2.0)
    quad.sp.move(pos=(30.0, 0.0, -100.0))
    assert quad.record(8.0, "vn").max() < 2.3


def test_it_holds_against_wind(hover: Hover) -> None:
    hover.fleet.dynamics.wind[:, 0] = (6.0, -5.0, 0.5)
    hover.run(10.0)
    sense = hover.fleet.senses()[0]
    assert math.hypot(sense.north, sense.east) < 0.3
    assert abs(sense.down + 100.0) < 0.2
    assert math.degrees(math.hypot(sense.roll, sense.pitch)) > 3.0  # it leans into the wind


def test_acceleration_is_followed(quad: Hover) -> None:
    quad.sp.move(acc=(1.0, 0.0, 0.0), horizontal=Axis.ACCELERATION, vertical=Axis.ACCELERATION)
    quad.run(4.0)
    assert quad.fleet.senses()[0].vn == pytest.approx(4.0, abs=0.5)


def test_a_px4_learns_nothing_of_a_velocity_that_is_not_asked_for() -> None:
    quad = Hover("quad", px4=True)
    quad.sp.raw(True)
    quad.sp.move(vel=(2.0, 0.0, -0.5), horizontal=Axis.VELOCITY, vertical=Axis.VELOCITY)
    quad.run(3.0)
    learnt = quad.fleet.cascade.vel_i.copy()
    assert abs(learnt[0, 0]) > 0.1
    # More than it can have: else only an error of the velocity, which is none here, would be learnt from.
    quad.sp.move(acc=(-20.0, 0.0, 0.0), horizontal=Axis.ACCELERATION, vertical=Axis.ACCELERATION)
    quad.run(0.5)
    assert np.array_equal(quad.fleet.cascade.vel_i, learnt)


def test_direct_thrust_lifts_and_drops(hover: Hover) -> None:
    share = hover.fleet.airframe.hover_thrust_n / hover.fleet.airframe.thrust_max_n
    hover.sp.lean(0.0, 0.0)
    hover.sp.direct_thrust(1.2 * share)
    assert hover.run(1.0).vd < -1.1
    hover.sp.direct_thrust(0.5 * share)
    assert hover.run(1.5).vd > 3.0


def test_an_upset_is_caught(hover: Hover) -> None:
    """Thrown on its side and spinning, it levels and comes back."""
    dyn = hover.fleet.dynamics
    dyn.q[:, 0] = (math.cos(0.7), math.sin(0.7), 0.0, 0.0)
    dyn.rate[:, 0] = (3.0, -2.0, 2.0)
    sense = hover.run(9.0)
    assert abs(sense.roll) < 0.02
    assert math.hypot(sense.north, sense.east) < 0.5


def test_gps_noise_wanders_by_what_was_asked() -> None:
    frame = airframe("quad")
    dyn = CopterDynamics(frame, np.zeros((3, 200)), np.zeros(200), DT)
    noise = msgspec.structs.replace(NONE, gps_wander_m=1.0, gps_wander_down_m=1.0)
    estimator = Estimator(dyn, SensorSuite(dyn, DEFAULT_PLACE, (1,), noise))
    path = []
    for _ in range(2000):
        estimator.refresh()
        estimator.observe(0.1)
        path.append(estimator.pos - dyn.pos)
    errors = np.array(path)
    assert errors.std() == pytest.approx(1.0, rel=0.1)
    assert np.abs(np.diff(errors, axis=0)).max() < 0.2  # no jumps
    assert np.abs(errors[-1] - errors[0]).mean() > 0.5  # and not a mere offset


@given(
    distance=st.floats(0.0, 1e4),
    gain=st.floats(0.1, 5.0),
    braking=st.floats(0.1, 10.0),
)
def test_the_approach_can_always_be_braked(distance: float, gain: float, braking: float) -> None:
    """Never faster than constant braking allows, never faster than the linear law, and without a step between them."""

    def speed(at: float) -> float:
        return float(root_speed(np.array([at]), gain, np.array([braking]))[0])

    found = speed(distance)
    assert 0.0 <= found <= gain * distance + 1e-9
    assert found * found <= 2.0 * braking * distance + 1e-9
    join = braking / (gain * gain)
    assert speed(join * (1 - 1e-9)) == pytest.approx(speed(join * (1 + 1e-9)), rel=1e-6)


def test_gains_follow_their_parameters_and_default_to_what_was_measured(make_gcs: MakeGcs) -> None:
    gcs = make_gcs()
    fleet = gcs.vehicle.node.seat.fleet
    assert isinstance(fleet, CopterFleet)
    plain = arducopter_gains(1)
    for name in ("pos_p", "vel_p", "vel_i", "angle_p", "rate_p", "rate_i"):
        assert getattr(fleet.setpoints.gains, name) == pytest.approx(getattr(plain, name), rel=1e-6)
    gcs.vehicle.copter.params.set("ATC_RAT_PIT_P", 0.27)
    assert fleet.setpoints.gains.rate_p[:, 0] == pytest.approx([18.0, 36.0, 7.0], rel=1e-6)
