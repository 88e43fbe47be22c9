"""GUIDED's targets: frames, masks, timeouts, and what makes no sense."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from zmav.sim.autopilots.ardupilot.state import Doing
from zmav.sim.geo import METRES_PER_DEGREE

if TYPE_CHECKING:
    from tests.sim.conftest import Gcs, MakeGcs

LOCAL, OFFSET, BODY, BODY_OFFSET = 1, 7, 8, 9
POSITION, VELOCITY, BOTH, ACCELERATION = 0x0DF8, 0x0DC7, 0x0DC0, 0x0C3F
NO_YAW, NO_YAW_RATE = 0x400, 0x800
ACCEPTED, DENIED, FAILED, COMMAND_INT_ONLY = 0, 2, 4, 8


@pytest.fixture
def up(gcs: Gcs) -> Gcs:
    """A copter 5 m over its start, in GUIDED."""
    gcs.put_up(5.0)
    return gcs


def test_a_position_target_is_reached_and_never_times_out(up: Gcs) -> None:
    up.goto(12.0, -4.0, -7.0)
    up.until(lambda: up.near(12.0, -4.0, -7.0))
    up.world.step(8.0)
    assert up.near(12.0, -4.0, -7.0, 0.3)


def test_on_the_ground_targets_lift_nothing(gcs: Gcs) -> None:
    gcs.world.step(1.0)
    assert gcs.command(176, 1, 4) == ACCEPTED
    assert gcs.command(400, 1) == ACCEPTED
    gcs.goto(10.0, 0.0, -10.0)
    gcs.world.step(3.0)
    gcs.fly(1.0, 0.0, -2.0)
    gcs.world.step(2.0)
    assert gcs.ned == (0.0, 0.0, 0.0)


def test_outside_guided_targets_are_ignored(up: Gcs) -> None:
    assert up.command(176, 1, 17) == ACCEPTED  # BRAKE
    up.goto(20.0, 0.0, -5.0)
    up.world.step(3.0)
    assert up.near(0.0, 0.0, -5.0)


def test_a_velocity_is_flown_and_dropped_after_guid_timeout(up: Gcs) -> None:
    up.fly(3.0, 0.0)
    up.world.step(2.9)
    assert up.vehicle.copter.sense.vn == pytest.approx(3.0, abs=0.2)
    up.world.step(2.4)
    assert abs(up.vehicle.copter.sense.vn) < 0.4  # at rest within about 5 s of the last word
    up.world.step(1.5)
    there = up.ned
    up.world.step(2.0)
    assert up.near(*there, within=0.2)


def test_a_repeated_velocity_keeps_it_going(up: Gcs) -> None:
    for _ in range(6):
        up.fly(0.0, 2.0, -0.5)
        up.world.step(1.0)
    sense = up.vehicle.copter.sense
    assert (sense.vn, sense.ve, sense.vd) == pytest.approx((0.0, 2.0, -0.5), abs=0.15)


def test_guid_timeout_is_a_parameter(up: Gcs) -> None:
    up.send("PARAM_SET", param_id="GUID_TIMEOUT", param_value=1.0, param_type=9)
    up.fly(3.0, 0.0)
    up.world.step(1.5)
    moving = up.vehicle.copter.sense.vn
    up.world.step(1.5)
    assert moving > 1.5
    assert up.vehicle.copter.sense.vn < 0.5


@pytest.mark.parametrize(
    ("frame", "east_of_north"), [(LOCAL, False), (OFFSET, False), (BODY, True), (BODY_OFFSET, True)]
)
def test_position_frames(up: Gcs, frame: int, east_of_north: bool) -> None:
    """From (4, 0), nose to the east, 3 m "forward": north of the origin or of here, or east of here."""
    up.goto(4.0, 0.0, -5.0, mask=POSITION & ~NO_YAW, yaw=math.pi / 2)
    up.until(lambda: up.near(4.0, 0.0, -5.0, 0.1) and abs(up.vehicle.copter.sense.yaw - math.pi / 2) < 0.02)
    up.goto(3.0, 0.0, -6.0 if frame == LOCAL else -1.0, frame=frame)
    expected = {LOCAL: (3.0, 0.0, -6.0), OFFSET: (7.0, 0.0, -6.0)}.get(frame, (4.0, 3.0, -6.0))
    assert east_of_north == (expected[1] > 1.0)
    up.until(lambda: up.near(*expected, within=0.3), 15.0)


@pytest.mark.parametrize("frame", [BODY, BODY_OFFSET])
def test_velocity_in_body_axes(up: Gcs, frame: int) -> None:
    up.goto(0.0, 0.0, -5.0, mask=POSITION & ~NO_YAW, yaw=math.pi / 2)
    up.world.step(4.0)
    up.fly(2.0, 0.0, frame=frame)
    up.world.step(2.5)
    assert up.vehicle.copter.sense.ve == pytest.approx(2.0, abs=0.2)
    assert abs(up.vehicle.copter.sense.vn) < 0.2


def test_position_with_velocity_leads_along_and_holds_when_starved(up: Gcs) -> None:
    for tick in range(40):
        at = 0.1 * tick * 2.0
        up.goto(at, 0.0, -5.0, mask=BOTH, vx=2.0)
        up.world.step(0.1)
    assert up.vehicle.copter.sense.vn == pytest.approx(2.0, abs=0.3)
    up.world.step(6.0)
    assert up.near(7.8, 0.0, -5.0)


def test_acceleration_is_flown_for_guid_timeout(up: Gcs) -> None:
    up.send("SET_POSITION_TARGET_LOCAL_NED", coordinate_frame=1, type_mask=ACCELERATION, afx=1.0, afy=0.0, afz=0.0)
    up.world.step(2.5)
    assert up.vehicle.copter.sense.vn == pytest.approx(2.5, abs=0.6)
    up.world.step(4.0)
    assert abs(up.vehicle.copter.sense.vn) < 0.3


def test_yaw_angle_and_yaw_rate(up: Gcs) -> None:
    up.goto(0.0, 0.0, -5.0, mask=POSITION & ~NO_YAW, yaw=-1.0)
    up.world.step(3.0)
    assert up.vehicle.copter.sense.yaw == pytest.approx(-1.0, abs=0.05)
    up.fly(0.0, 0.0, mask=VELOCITY & ~NO_YAW_RATE, yaw_rate=0.5)
    up.world.step(2.5)
    assert up.vehicle.copter.sense.r == pytest.approx(0.5, abs=0.05)
    up.world.step(4.0)
    assert abs(up.vehicle.copter.sense.r) < 0.05  # starved: it turns no more


def test_it_looks_where_it_flies_unless_told_not_to(up: Gcs) -> None:
    up.goto(0.0, 8.0, -5.0)
    up.until(lambda: up.near(0.0, 8.0, -5.0))
    assert up.vehicle.copter.sense.yaw == pytest.approx(math.pi / 2, abs=0.1)
    up.send("PARAM_SET", param_id="WP_YAW_BEHAVIOR", param_value=0.0, param_type=2)
    up.goto(0.0, 0.0, -5.0)
    up.until(lambda: up.near(0.0, 0.0, -5.0))
    assert up.vehicle.copter.sense.yaw == pytest.approx(math.pi / 2, abs=0.1)


def test_global_frames(up: Gcs) -> None:
    home = up.vehicle.copter.world
    for frame, alt in {0: 592.09, 5: 592.09, 3: 8.0, 6: 8.0, 10: 8.0, 11: 8.0}.items():
        up.goto(0.0, 0.0, -5.0)
        up.send(
            "SET_POSITION_TARGET_GLOBAL_INT",
            coordinate_frame=frame,
            type_mask=POSITION,
            lat_int=round((home.lat_deg + 6.0 / METRES_PER_DEGREE) * 1e7),
            lon_int=round(home.lon_deg * 1e7),
            alt=alt,
        )
        assert up.vehicle.copter.guided.target.pos == pytest.approx((6.0, 0.0, -8.0), abs=0.02), frame
    up.until(lambda: up.near(6.0, 0.0, -8.0, 0.3), 15.0)


NO_TARGETS: list[dict[str, float]] = [
    {"coordinate_frame": 12},
    {"type_mask": POSITION | 0x001},
    {"x": math.nan},
    {"type_mask": VELOCITY, "vx": math.inf},
    {"type_mask": VELOCITY, "vx": 5000.0},
    {"type_mask": 0x0E3F, "afx": 1.0},  # a force
    {"type_mask": 0x0C38},  # a position with an acceleration alone
]
NO_PLACES: list[dict[str, float]] = [{"lat_int": 950_000_000}, {"coordinate_frame": 1}, {"alt": math.nan}]


def doing(gcs: Gcs) -> Doing:
    return gcs.vehicle.copter.guided.doing


def test_targets_that_make_no_sense_stop_it(up: Gcs) -> None:
    target = {"coordinate_frame": 1, "type_mask": POSITION, "x": 40.0, "z": -5.0}
    for bad in NO_TARGETS:
        up.goto(40.0, 0.0, -5.0)
        assert doing(up) is Doing.POSITION
        up.send("SET_POSITION_TARGET_LOCAL_NED", **{**target, **bad})
        assert doing(up) is Doing.HOLD, bad
    place = {"coordinate_frame": 6, "type_mask": POSITION, "lat_int": -353632610, "lon_int": 1491652300, "alt": 5.0}
    for bad in NO_PLACES:
        up.send("SET_POSITION_TARGET_GLOBAL_INT", **place)
        assert doing(up) is Doing.POSITION
        up.send("SET_POSITION_TARGET_GLOBAL_INT", **{**place, **bad})
        assert doing(up) is Doing.HOLD, bad


def test_stopped_means_at_rest(up: Gcs) -> None:
    up.goto(60.0, 0.0, -5.0)
    up.world.step(3.0)
    assert up.vehicle.copter.sense.vn > 3.0
    up.goto(math.nan, 0.0, -5.0)
    up.world.step(4.5)
    assert abs(up.vehicle.copter.sense.vn) < 0.3
    assert up.ned[0] < 35.0


class TestReposition:
    def place(self, gcs: Gcs, north: float) -> dict[str, int]:
        home = gcs.vehicle.copter.world
        lat = round((home.lat_deg + north / METRES_PER_DEGREE) * 1e7)
        return {"x": lat, "y": round(home.lon_deg * 1e7)}

    def test_flies_there(self, up: Gcs) -> None:
        assert up.command_int(192, z=6.0, frame=6, **self.place(up, 8.0)) == ACCEPTED
        up.until(lambda: up.near(8.0, 0.0, -6.0))

    def test_as_a_long_it_is_refused(self, up: Gcs) -> None:
        assert up.command(192, 0, 0, 0, 0, -35.36, 149.16, 10.0) == COMMAND_INT_ONLY

    def test_outside_guided_it_needs_leave_to_change_the_mode(self, up: Gcs) -> None:
        assert up.command(176, 1, 17) == ACCEPTED
        assert up.command_int(192, z=6.0, frame=6, **self.place(up, 8.0)) == DENIED
        assert up.command_int(192, z=6.0, frame=6, param2=1.0, **self.place(up, 8.0)) == ACCEPTED
        assert up.vehicle.copter.mode.name == "GUIDED"

    @pytest.mark.parametrize("place", [{"x": 950_000_000, "y": 0}, {"x": 0, "y": 0}])
    def test_needs_a_place(self, up: Gcs, place: dict[str, int]) -> None:
        assert up.command_int(192, z=6.0, frame=6, **place) == DENIED


def test_speed_can_be_changed_in_flight(up: Gcs) -> None:
    assert up.command(178, 1, 1.5) == ACCEPTED
    up.goto(20.0, 0.0, -5.0)
    up.world.step(4.0)
    assert up.vehicle.copter.sense.vn == pytest.approx(1.5, abs=0.15)
    assert up.command(178, 1, -1) == DENIED
    assert up.command(178, 9, 2.0) == FAILED
    assert up.command(176, 1, 17) == ACCEPTED
    assert up.command(178, 1, 2.0) == FAILED  # BRAKE has no speed


class TestAttitude:
    def lean(self, gcs: Gcs, **fields: object) -> None:
        pitch = math.radians(-10.0)
        q = [math.cos(pitch / 2), 0.0, math.sin(pitch / 2), 0.0]
        gcs.send("SET_ATTITUDE_TARGET", **{"type_mask": 0x07, "q": q, "thrust": 0.5, **fields})

    def test_leans_and_keeps_its_height(self, up: Gcs) -> None:
        for _ in range(4):
            self.lean(up)
            up.world.step(0.5)
        assert math.degrees(up.vehicle.copter.sense.pitch) == pytest.approx(-10.0, abs=1.0)
        assert up.vehicle.copter.sense.vn > 2.0
        assert abs(up.ned[2] + 5.0) < 0.3

    def test_thrust_is_a_climb_rate(self, up: Gcs) -> None:
        self.lean(up, q=[1.0, 0.0, 0.0, 0.0], thrust=0.7)
        up.world.step(2.5)
        assert up.vehicle.copter.sense.vd == pytest.approx(-1.0, abs=0.15)  # 0.4 of WPNAV_SPEED_UP

    def test_thrust_is_thrust_with_that_option(self, up: Gcs) -> None:
        up.send("PARAM_SET", param_id="GUID_OPTIONS", param_value=8.0, param_type=6)
        self.lean(up, q=[1.0, 0.0, 0.0, 0.0], thrust=up.vehicle.copter.airframe.hover_share * 1.2)
        up.world.step(1.0)
        assert up.vehicle.copter.sense.vd == pytest.approx(-0.2 * 9.81, abs=0.5)

    def rates(self, gcs: Gcs, p: float, q: float, r: float, mask: int = 0x80, seconds: float = 1.0) -> None:
        """Body rates (without an attitude unless the mask says so), repeated at 20 Hz."""
        for _ in range(round(seconds * 20)):
            self.lean(gcs, type_mask=mask, q=[1.0, 0.0, 0.0, 0.0], body_roll_rate=p, body_pitch_rate=q, body_yaw_rate=r)
            gcs.world.step(0.05)

    def test_body_rates_are_flown(self, up: Gcs) -> None:
        """Measured with the same words: 54.8 degrees after two seconds, 11.7 after one, and back to 0.7."""
        sense = up.vehicle.copter
        self.rates(up, 0.0, 0.0, 0.5, seconds=2.0)
        assert math.degrees(sense.sense.yaw) == pytest.approx(54.8, abs=4.0)
        self.rates(up, 0.2, 0.0, 0.0)
        assert math.degrees(sense.sense.roll) == pytest.approx(11.7, abs=1.5)
        self.rates(up, -0.2, 0.0, 0.0)
        assert math.degrees(sense.sense.roll) == pytest.approx(0.7, abs=1.5)
        assert abs(up.ned[2] + 5.0) < 0.5

    def test_rates_stop_with_the_stream(self, up: Gcs) -> None:
        self.rates(up, 0.0, 0.0, 0.5)
        up.world.step(4.5)  # GUID_TIMEOUT is 3 s
        assert abs(up.vehicle.copter.sense.r) < 0.05
        assert abs(math.degrees(up.vehicle.copter.sense.roll)) < 1.0

    def test_an_attitude_turns_on_at_its_rates(self, up: Gcs) -> None:
        self.lean(up, type_mask=0x00, q=[1.0, 0.0, 0.0, 0.0], body_yaw_rate=0.4)
        up.world.step(2.0)
        assert up.vehicle.copter.sense.yaw == pytest.approx(0.8, abs=0.2)
        # Sent again and again it stays near the attitude; measured 5.6 degrees.
        self.rates(up, 0.0, 0.0, 0.5, mask=0x00, seconds=3.0)
        assert abs(math.degrees(up.vehicle.copter.sense.yaw)) < 8.0

    def test_neither_attitude_nor_rates_means_no_rates(self, up: Gcs) -> None:
        self.lean(up, type_mask=0x87)
        assert doing(up) is Doing.ATTITUDE
        up.world.step(1.0)
        assert abs(up.vehicle.copter.sense.r) < 0.02

    def test_a_climb_lifts_it_off_the_ground(self, gcs: Gcs) -> None:
        gcs.world.step(1.0)
        assert gcs.command(176, 1, 4) == ACCEPTED
        assert gcs.command(400, 1) == ACCEPTED
        for thrust, expected in ((0.5, 0.0), (0.8, -1.0)):
            for _ in range(30):
                self.lean(gcs, q=[1.0, 0.0, 0.0, 0.0], thrust=thrust)
                gcs.world.step(0.2)
            assert (gcs.ned[2] < expected) is (thrust > 0.5)

    def test_times_out_to_level_flight(self, up: Gcs) -> None:
        self.lean(up)
        up.world.step(3.5)
        assert abs(math.degrees(up.vehicle.copter.sense.pitch)) < 2.0

    def test_what_makes_no_sense_stops_it(self, up: Gcs) -> None:
        bads: list[dict[str, object]] = [{"q": [2.0, 0.0, 0.0, 0.0]}, {"type_mask": 0x06}, {"type_mask": 0x47}]
        for bad in bads:
            self.lean(up)
            assert doing(up) is Doing.ATTITUDE
            self.lean(up, **bad)
            assert doing(up) is Doing.HOLD, bad


def test_targets_are_reported_back(up: Gcs) -> None:
    up.goto(12.0, -4.0, -7.0)
    local = up.last("POSITION_TARGET_LOCAL_NED")
    assert (local["coordinate_frame"], local["type_mask"]) == (1, POSITION)
    assert (local["x"], local["y"], local["z"]) == pytest.approx((12.0, -4.0, -7.0), abs=1e-3)
    world = up.last("POSITION_TARGET_GLOBAL_INT")
    assert (world["coordinate_frame"], world["type_mask"]) == (0, 0xFDF8)
    assert world["alt"] == pytest.approx(584.09 + 7.0, abs=0.01)
    nav = up.last("NAV_CONTROLLER_OUTPUT")
    assert (nav["wp_dist"], nav["target_bearing"]) == (13, 342)
    up.fly(1.0, 2.0, -0.5)
    local = up.last("POSITION_TARGET_LOCAL_NED")
    assert local["type_mask"] == VELOCITY
    assert (local["vx"], local["vy"], local["vz"]) == (1.0, 2.0, -0.5)


def test_the_ekf_origin_is_where_the_vehicle_started(make_gcs: MakeGcs, another_gcs: type[Gcs]) -> None:
    first = make_gcs(2)
    second = another_gcs(first.world, first.world.vehicles[1])
    second.put_up(3.0)
    second.goto(0.0, 5.0, -3.0)
    second.until(lambda: second.near(0.0, 5.0, -3.0))
    assert first.world.vehicles[1].status().ned_m == pytest.approx((0.0, 15.0, -3.0), abs=0.5)
    assert first.ned == (0.0, 0.0, 0.0)
