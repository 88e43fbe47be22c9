"""Modes and commands of the simulated ArduCopter beyond the usual: for a pilot, round a point, and home by the way it
came.
"""

from __future__ import annotations

import itertools
import math

import pytest

from tests.sim.conftest import GUIDED, Desk, MakeDesk
from tests.sim.plans import at, do, upload
from zmav.sim.autopilots.arducopter.smartrtl import thinned
from zmav.sim.control.gains import arducopter_gains
from zmav.sim.fleets.copter import CopterFleet

ACRO, CIRCLE, DRIFT, SPORT, POSHOLD, SMART_RTL, AUTO_RTL, AUTO = 1, 7, 11, 13, 16, 21, 27, 3


@pytest.fixture
def flying(desk: Desk) -> Desk:
    """In GUIDED, 10 m up, the throttle stick in its middle."""
    desk.take_off(10.0)
    desk.vehicle.copter.pilot.sticks(throttle=0.5)
    return desk


def mode(desk: Desk) -> int:
    return int(desk.last("HEARTBEAT")["custom_mode"])


def choose(desk: Desk, number: int) -> None:
    assert desk.command(176, 1, number) == 0
    assert mode(desk) == number


class TestPilot:
    def test_poshold_leans_with_the_stick_and_stays_where_it_stops(self, flying: Desk) -> None:
        choose(flying, POSHOLD)
        copter = flying.vehicle.copter
        copter.pilot.sticks(roll=0.5)
        flying.world.step(2.0)
        assert math.degrees(copter.sense.roll) == pytest.approx(15.0, abs=1.0)
        copter.pilot.sticks(roll=0.0)
        flying.world.step(5.0)
        there = flying.ned
        flying.world.step(5.0)
        assert math.dist(flying.ned, there) < 0.2
        assert there[1] > 3.0

    def test_sport_keeps_its_lean_when_the_stick_is_let_go(self, flying: Desk) -> None:
        choose(flying, SPORT)
        copter = flying.vehicle.copter
        copter.pilot.sticks(pitch=0.2)
        flying.world.step(0.2)
        copter.pilot.sticks(pitch=0.0)
        flying.world.step(1.0)
        assert math.degrees(copter.sense.pitch) == pytest.approx(-0.2 * 360 * 0.2, abs=1.5)
        assert abs(copter.sense.down + 10.0) < 0.7

    def test_drift_turns_with_the_roll_stick_and_brakes_what_slips(self, flying: Desk) -> None:
        choose(flying, DRIFT)
        copter = flying.vehicle.copter
        copter.pilot.sticks(pitch=0.3)
        flying.world.step(3.0)
        copter.pilot.sticks(pitch=0.1, roll=0.2)
        flying.world.step(3.0)
        assert copter.sense.r > 0.2
        copter.pilot.sticks(pitch=0.0, roll=0.0)
        flying.world.step(6.0)
        assert math.hypot(copter.sense.vn, copter.sense.ve) < 0.5

    def test_acro_turns_at_the_sticks_rate_and_its_trainer_levels_it(self, flying: Desk) -> None:
        copter = flying.vehicle.copter
        copter.params.set("ACRO_TRAINER", 0)
        choose(flying, ACRO)
        copter.pilot.sticks(yaw=0.5)
        flying.world.step(1.5)
        assert math.degrees(copter.sense.r) == pytest.approx(0.5 * 202.5, abs=8.0)
        copter.pilot.sticks(yaw=0.0, roll=0.3)
        flying.world.step(0.25)
        lean = copter.sense.roll
        assert math.degrees(lean) > 5.0
        copter.pilot.sticks(roll=0.0)
        flying.world.step(0.5)
        kept = copter.sense.roll
        copter.params.set("ACRO_TRAINER", 2)
        flying.world.step(1.5)
        assert kept > 0.7 * lean
        assert copter.sense.roll < 0.35 * kept


class TestCircle:
    def test_it_goes_round_a_point_ahead_with_its_nose_toward_it(self, flying: Desk) -> None:
        choose(flying, CIRCLE)
        copter = flying.vehicle.copter
        centre = (flying.ned[0] + 10.0, flying.ned[1])
        flying.world.step(6.0)
        start = flying.ned
        turned = 0.0
        before = math.atan2(start[1] - centre[1], start[0] - centre[0])
        for _ in range(100):
            flying.world.step(0.1)
            n, e, d = flying.ned
            angle = math.atan2(e - centre[1], n - centre[0])
            turned += (angle - before + math.pi) % (2 * math.pi) - math.pi
            before = angle
            assert math.hypot(n - centre[0], e - centre[1]) == pytest.approx(10.0, abs=0.6)
            assert d == pytest.approx(-10.0, abs=0.3)
        assert math.degrees(turned) == pytest.approx(200.0, abs=10.0)  # CIRCLE_RATE 20 for ten seconds
        inward = math.atan2(centre[1] - flying.ned[1], centre[0] - flying.ned[0])
        assert math.cos(copter.sense.yaw - inward) > math.cos(math.radians(25.0))

    def test_the_pilot_makes_it_wider(self, flying: Desk) -> None:
        choose(flying, CIRCLE)
        centre = (flying.ned[0] + 10.0, flying.ned[1])
        flying.vehicle.copter.pilot.sticks(pitch=-0.2)
        flying.world.step(2.5)
        flying.vehicle.copter.pilot.sticks(pitch=0.0)
        flying.world.step(15.0)
        n, e, _ = flying.ned
        assert math.hypot(n - centre[0], e - centre[1]) == pytest.approx(15.0, abs=1.0)


class TestSmartRtl:
    def test_it_goes_home_by_the_way_it_came_and_lands(self, flying: Desk) -> None:
        for place in ((20.0, 0.0, -10.0), (20.0, 20.0, -10.0)):
            flying.goto(*place)
            flying.until(lambda place=place: flying.near(*place))  # type: ignore[misc]
        choose(flying, SMART_RTL)
        corner = [flying.ned]
        while not flying.near(0.0, 0.0, -2.0, 1.0):
            flying.world.step(0.1)
            corner.append(flying.ned)
            assert len(corner) < 900
        assert min(math.dist(p, (20.0, 0.0, -10.0)) for p in corner) < 3.0
        assert max(p[1] for p in corner if p[0] < 15.0) < 5.0  # not straight across
        flying.until(lambda: not flying.vehicle.copter.armed, 60.0)
        assert math.hypot(*flying.ned[:2]) < 0.7

    def test_without_a_way_it_is_refused(self, desk: Desk) -> None:
        desk.vehicle.copter.params.set("SRTL_POINTS", 0)
        desk.take_off(5.0)
        assert desk.command(176, 1, SMART_RTL) == 4
        assert desk.texts()[-1] == "Mode change to SMARTRTL failed: init failed"

    def test_a_failsafe_takes_it(self, flying: Desk) -> None:
        copter = flying.vehicle.copter
        copter.params.set("FS_THR_ENABLE", 4)
        copter.pilot.lose()
        flying.world.step(2.0)
        assert mode(flying) == SMART_RTL

    def test_points_on_a_line_are_left_out(self) -> None:
        line = [(float(i), 0.1 * (i % 2), 0.0) for i in range(20)]
        bend = [(19.0, float(i), 0.0) for i in range(1, 10)]
        assert thinned(line + bend, 0.5) == [line[0], line[-1], bend[-1]]


class TestAutoRtl:
    def test_it_joins_the_mission_where_the_landing_begins(self, flying: Desk) -> None:
        items = [at(16, 30.0, 0.0, 10.0), at(16, 60.0, 0.0, 10.0), do(189), at(16, 5.0, 5.0, 8.0), do(21)]
        assert upload(flying, items) == 0
        assert flying.command(176, 1, AUTO_RTL) == 0
        assert mode(flying) == AUTO_RTL
        assert flying.last("MISSION_CURRENT")["seq"] >= 3
        flying.until(lambda: not flying.vehicle.copter.armed, 90.0)
        assert flying.near(5.0, 5.0, 0.0, 1.0)

    def test_without_a_landing_it_says_so(self, flying: Desk) -> None:
        assert flying.command(176, 1, AUTO_RTL) == 4
        said = "".join(flying.texts()[-2:])  # in two pieces
        assert said == "Mode change to AUTO RTL failed: No return path or landing sequence found"
        assert mode(flying) == GUIDED


class TestMotorTest:
    def test_one_motor_after_the_other_clockwise_from_the_nose(self, desk: Desk) -> None:
        desk.until(lambda: desk.vehicle.copter.position_ok)
        assert desk.command(209, 1, 0, 15.0, 1.0, 2) == 0
        desk.world.step(0.5)
        seat = desk.vehicle.node.seat
        assert seat.outputs() == pytest.approx([0.0, 0.0, 0.15, 0.0])  # the front one of a plus frame
        assert desk.last("HEARTBEAT")["base_mode"] & 128
        desk.world.step(1.4)
        assert seat.outputs() == pytest.approx([0.15, 0.0, 0.0, 0.0])  # then the right one
        desk.world.step(2.0)
        assert seat.outputs() == [0.0] * 4
        assert [t for t in desk.texts() if "motor test" in t] == ["starting motor test", "finished motor test"]
        assert not desk.last("HEARTBEAT")["base_mode"] & 128

    def test_not_in_the_air_nor_of_motors_that_are_not_there(self, flying: Desk) -> None:
        assert flying.command(209, 1, 0, 10.0, 1.0) == 4
        assert flying.texts()[-1] == "Motor Test: vehicle not landed"
        assert flying.vehicle.copter.armed

    def test_a_motor_that_is_not_there_ends_it(self, desk: Desk) -> None:
        desk.until(lambda: desk.vehicle.copter.position_ok)
        assert desk.command(209, 7, 0, 10.0, 1.0) == 0
        desk.world.step(0.1)
        assert desk.texts()[-2:] == ["Motor Test: cancelled", "finished motor test"]


class TestRepeat:
    def test_a_relay_goes_there_and_back(self, make_desk: MakeDesk) -> None:
        desk = make_desk()
        desk.vehicle.copter.params.set("RELAY1_FUNCTION", 1)
        desk.vehicle.copter.power_on()
        desk.world.step(1.0)
        assert desk.command(182, 0, 2, 2.0) == 0
        seen = []
        for _ in range(60):
            seen.append(desk.vehicle.copter.payload.relays[0])
            desk.world.step(0.1)
        changes = [a != b for a, b in itertools.pairwise(seen)]
        assert seen[0] is True
        assert sum(changes) == 3
        assert seen[-1] is False

    def test_a_servo_goes_between_a_pulse_and_its_trim(self, desk: Desk) -> None:
        desk.world.step(1.0)
        assert desk.command(184, 9, 1900, 1, 1.0) == 0
        payload = desk.vehicle.copter.payload
        assert payload.servos[8] == 1900
        desk.world.step(0.8)
        assert payload.servos[8] == 1500
        desk.world.step(3.0)
        assert payload.servos[8] == 1500
        assert desk.command(184, 1, 1900, 1, 1.0) == 4  # a motor's


class TestGuidedLimits:
    @pytest.mark.parametrize("limits", [(3.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 4.0), (0.0, 0.0, 12.0, 0.0)])
    def test_a_mission_goes_on_when_they_are_passed(self, flying: Desk, limits: tuple[float, ...]) -> None:
        """DO_GUIDED_LIMITS, then NAV_GUIDED_ENABLE: for so long, so high and so far somebody outside may steer."""
        assert upload(flying, [do(222, *limits), do(92, 1.0), at(16, 0.0, 0.0, 10.0)]) == 0
        choose(flying, AUTO)
        for _ in range(4):
            flying.fly(2.0, 0.0, -0.8)
            flying.world.step(0.25)
        assert flying.last("MISSION_CURRENT")["seq"] < 3
        for _ in range(12):
            flying.fly(2.0, 0.0, -0.8)
            flying.world.step(0.25)
        assert flying.last("MISSION_CURRENT")["seq"] == 3


def test_gains_follow_their_parameters_and_default_to_what_was_measured(make_desk: MakeDesk) -> None:
    desk = make_desk()
    fleet = desk.vehicle.node.seat.fleet
    assert isinstance(fleet, CopterFleet)
    plain = arducopter_gains(1)
    for name in ("pos_p", "vel_p", "vel_i", "angle_p", "rate_p", "rate_i"):
        assert getattr(fleet.setpoints.gains, name) == pytest.approx(getattr(plain, name), rel=1e-6)
    desk.vehicle.copter.params.set("ATC_RAT_PIT_P", 0.27)
    assert fleet.setpoints.gains.rate_p[:, 0] == pytest.approx([18.0, 36.0, 7.0], rel=1e-6)
