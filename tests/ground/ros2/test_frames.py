"""Frames and conversions, held against rotation matrices and numbers worked out by hand."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ground.ros2 import convert, frames
from ground.ros2.convert import View
from ground.ros2.types import known
from zmav import wire
from zmav.vision.optics import LOOKING_DOWN, euler_matrix

ANGLES = st.floats(-3.1, 3.1)
PITCHES = st.floats(-1.5, 1.5)
VECTORS = st.tuples(*[st.floats(-100, 100)] * 3)
NED_TO_ENU = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
FRD_TO_FLU = np.diag([1, -1, -1])


def matrix(q: frames.Quaternion) -> Any:
    x, y, z, w = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def in_ned(roll: float, pitch: float, yaw: float) -> Any:
    """The rotation from body (FRD) to NED by MAVLink's angles: about z, y, x."""
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


@given(ANGLES, PITCHES, ANGLES)
def test_an_orientation_is_that_of_the_body_in_east_north_up(roll: float, pitch: float, yaw: float) -> None:
    want = NED_TO_ENU @ in_ned(roll, pitch, yaw) @ FRD_TO_FLU
    assert matrix(frames.orientation(roll, pitch, yaw)) == pytest.approx(want, abs=1e-9)


@given(ANGLES, PITCHES, ANGLES, VECTORS)
def test_a_velocity_in_the_body(roll: float, pitch: float, yaw: float, ned: wire.Vector) -> None:
    body = frames.in_body(frames.enu(ned), frames.orientation(roll, pitch, yaw))
    want = FRD_TO_FLU @ in_ned(roll, pitch, yaw).T @ np.array(ned)
    assert body == pytest.approx(tuple(want), abs=1e-6)


@given(ANGLES, PITCHES, ANGLES, VECTORS)
def test_a_vector_of_the_body_in_the_world(roll: float, pitch: float, yaw: float, flu: wire.Vector) -> None:
    q = frames.orientation(roll, pitch, yaw)
    assert frames.in_body(frames.in_world(flu, q), q) == pytest.approx(flu, abs=1e-6)
    assert frames.in_world(flu, q) == pytest.approx(tuple(matrix(q) @ np.array(flu)), abs=1e-6)


@given(ANGLES, PITCHES, ANGLES)
def test_a_camera_is_turned_as_its_pictures_are_taken(roll: float, pitch: float, yaw: float) -> None:
    """As those who look for things in its pictures have it."""
    want = FRD_TO_FLU @ euler_matrix(roll, pitch, yaw) @ LOOKING_DOWN
    assert matrix(frames.of_camera((roll, pitch, yaw))) == pytest.approx(want, abs=1e-9)


@given(ANGLES)
def test_a_heading_is_its_own_inverse(yaw: float) -> None:
    assert math.remainder(frames.heading(frames.heading(yaw)) - yaw, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)
    q = frames.orientation(0.0, 0.0, yaw)
    assert math.remainder(frames.yaw_of(q) - frames.heading(yaw), 2 * math.pi) == pytest.approx(0.0, abs=1e-9)


@given(VECTORS)
def test_vectors_there_and_back(v: wire.Vector) -> None:
    assert frames.enu(frames.enu(v)) == v
    assert frames.flu(frames.flu(v)) == v


STATE = wire.VehicleState(
    t=10.25,
    fleet="demo",
    name="quad1",
    instance="x",
    position=wire.GlobalPosition(lat_deg=50.0, lon_deg=8.0, alt_amsl=100.0, alt_rel=0.0),
    local=(10.0, 20.0, -5.0),
)


def view(**last: dict[str, Any]) -> View:
    return View(known(), "demo", "quad1", STATE, last, STATE.t)


POSITION = {
    "lat": 500000000,
    "lon": 80000000,
    "alt": 102_000,
    "relative_alt": 2_000,
    "vx": 100,
    "vy": 200,
    "vz": -300,
    "hdg": 9000,
}
ATTITUDE = {"roll": 0.0, "pitch": 0.0, "yaw": 0.0, "rollspeed": 0.1, "pitchspeed": 0.2, "yawspeed": 0.3}
GPS = {
    "lat": 500000000,
    "lon": 80000000,
    "alt": 100_000,
    "alt_ellipsoid": 147_500,
    "fix_type": 6,
    "h_acc": 500,
    "v_acc": 2000,
}


def test_altitude_is_above_the_ellipsoid_or_not_said() -> None:
    fix = convert.fix(view(GLOBAL_POSITION_INT=POSITION, GPS_RAW_INT=GPS))
    assert (fix.latitude, fix.longitude) == (50.0, 8.0)
    assert fix.altitude == pytest.approx(102.0 + 47.5)
    assert (fix.status.status, fix.position_covariance_type) == (2, 2)
    assert list(np.diag(fix.position_covariance.reshape(3, 3))) == [0.25, 0.25, 4.0]
    assert math.isnan(convert.fix(view(GLOBAL_POSITION_INT=POSITION)).altitude)
    raw = convert.raw_fix(view(GPS_RAW_INT=GPS | {"alt_ellipsoid": 0, "fix_type": 1}))
    assert math.isnan(raw.altitude)
    assert raw.status.status == -1


def test_pose_and_twist_are_east_north_up_and_forward_left_up() -> None:
    """At yaw 0 the nose points north, along y; 2 m above where the state was, and so 7 m above the origin."""
    seen = view(GLOBAL_POSITION_INT=POSITION, ATTITUDE=ATTITUDE)
    odom = convert.odometry(seen)
    at, q = odom.pose.pose.position, odom.pose.pose.orientation
    assert (at.x, at.y, at.z) == pytest.approx((20.0, 10.0, 7.0))
    assert (q.x, q.y, q.z, q.w) == pytest.approx((0, 0, math.sqrt(0.5), math.sqrt(0.5)))
    linear, angular = odom.twist.twist.linear, odom.twist.twist.angular
    assert (linear.x, linear.y, linear.z) == pytest.approx((1.0, -2.0, 3.0))
    assert (angular.x, angular.y, angular.z) == pytest.approx((0.1, -0.2, -0.3))
    assert (odom.header.stamp.sec, odom.header.stamp.nanosec) == (10, 250_000_000)
    world = convert.velocity_local(seen).twist
    assert (world.linear.x, world.linear.y, world.linear.z) == pytest.approx((2.0, 1.0, 3.0))
    assert (world.angular.x, world.angular.y, world.angular.z) == pytest.approx((0.2, 0.1, -0.3)), "along the world's"
    assert convert.compass(seen).data == 90.0
    assert convert.rel_alt(seen).data == 2.0


def test_acceleration_in_each_autopilots_units_or_said_to_be_none() -> None:
    mg = {"xacc": 0, "yacc": 0, "zacc": -1000}
    assert convert.imu(view(ATTITUDE=ATTITUDE, RAW_IMU=mg)).linear_acceleration.z == pytest.approx(9.80665)
    si = {"xacc": 1.0, "yacc": 2.0, "zacc": -9.8}
    felt = convert.imu(view(ATTITUDE=ATTITUDE, HIGHRES_IMU=si)).linear_acceleration
    assert (felt.x, felt.y, felt.z) == (1.0, -2.0, 9.8)
    assert convert.imu(view(ATTITUDE=ATTITUDE)).linear_acceleration_covariance[0] == -1.0


def test_a_battery_that_says_nothing_has_no_figures() -> None:
    known_ = {"voltage_battery": 12_600, "current_battery": 1_500, "battery_remaining": 80}
    battery = convert.battery(view(SYS_STATUS=known_))
    assert (battery.voltage, battery.current, battery.percentage) == pytest.approx((12.6, -15.0, 0.8))
    battery = convert.battery(
        view(SYS_STATUS={"voltage_battery": 65535, "current_battery": -1, "battery_remaining": -1})
    )
    assert not battery.present
    assert all(map(math.isnan, (battery.voltage, battery.current, battery.percentage)))


def test_nothing_is_made_of_what_was_not_heard() -> None:
    every = (convert.fix, convert.raw_fix, convert.rel_alt, convert.compass, convert.imu, convert.battery, convert.pose)
    for make in (*every, convert.odometry, convert.velocity_local, convert.velocity_body, convert.transform):
        assert make(view()) is None
    assert convert.state(View(known(), "demo", "quad1", None, {}, time.time())) is None


@pytest.mark.parametrize(
    ("autopilot", "mode", "shown"),
    [("px4", "HOLD", "AUTO.LOITER"), ("px4", "OFFBOARD", "OFFBOARD"), ("ardupilot", "LAND", "LAND")],
)
def test_modes_have_the_names_that_mavros_gives_them(autopilot: str, mode: str, shown: str) -> None:
    state = wire.VehicleState(
        t=1.0, fleet="demo", name="q", instance="x", autopilot=autopilot, mode=mode, status="ACTIVE", landed=True
    )
    said = convert.state(View(known(), "demo", "q", state, {}, 1.0))
    assert (said.mode, said.guided, said.system_status) == (shown, mode == "OFFBOARD", 4)
    assert convert.extended_state(View(known(), "demo", "q", state, {}, 1.0)).landed_state == 1


def test_an_event_is_a_status_text() -> None:
    event = wire.Event(t=2.0, kind="statustext", severity="critical", text="Bad compass")
    assert (convert.status_text(known(), event).severity, convert.status_text(known(), event).text) == (
        2,
        "Bad compass",
    )
