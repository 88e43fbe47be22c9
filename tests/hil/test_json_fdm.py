"""ArduPilot's JSON interface without sockets: packets in, answers out."""

from __future__ import annotations

import json
import math
import struct
from typing import Any

import numpy as np
import pytest

from tests.hil.conftest import plant
from tests.hil.hover import PLUS, state_of, steer
from zmav.errors import BadMessage
from zmav.hil.craft import craft
from zmav.hil.json_fdm import JsonFdm, compose, parse_servos
from zmav.hil.plant import Plant
from zmav.sim.arrays import quat_from_euler

STILL = [1000] * 16


def packet(frame: int, pwm: list[int] = STILL, rate: int = 1200, magic: int = 18458) -> bytes:
    return struct.pack(f"<HHI{len(pwm)}H", magic, rate, frame, *pwm)


def told(answer: bytes) -> dict[str, Any]:
    """The answer as the published page has it: a line of its own, newline before and after, no blanks."""
    assert answer[:1] == answer[-1:] == b"\n"
    assert answer.count(b"\n") == 2
    assert b" " not in answer
    found: dict[str, Any] = json.loads(answer)
    return found


def step(fdm: JsonFdm, data: bytes) -> dict[str, Any]:
    assert fdm.take(data) is None
    return told(fdm.answer())


def lean(body: Plant, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> None:
    body.dynamics.q[:] = quat_from_euler(np.array([roll]), np.array([pitch]), np.array([yaw]))


class TestPackets:
    def test_sixteen_and_thirty_two_outputs_are_read(self) -> None:
        assert parse_servos(packet(7, [*range(1000, 1016)], rate=400)) == (400, 7, tuple(range(1000, 1016)))
        assert parse_servos(packet(8, [*range(1000, 1032)], magic=29569)).pwm[31] == 1031

    @pytest.mark.parametrize(
        "data",
        [b"", b"\x1a", packet(1)[:-1], packet(1) + b"\0", packet(1, magic=18459), packet(1, [1500] * 32), b"{" * 40],
    )
    def test_anything_else_is_refused_and_says_what_is_expected(self, data: bytes) -> None:
        with pytest.raises(BadMessage, match="18458"):
            parse_servos(data)

    def test_a_rate_of_nothing_is_refused(self) -> None:
        with pytest.raises(BadMessage, match="frame rate"):
            parse_servos(packet(1, rate=0))


class TestLockStep:
    def test_each_packet_moves_time_on_by_its_own_rate(self) -> None:
        fdm = JsonFdm(plant())
        times = [step(fdm, packet(i, rate=rate))["timestamp"] for i, rate in enumerate((1200, 1200, 400, 50))]
        assert times == pytest.approx([1 / 1200, 2 / 1200, 2 / 1200 + 1 / 400, 2 / 1200 + 1 / 400 + 0.02], abs=1e-6)

    def test_a_slow_stack_gets_no_coarser_physics(self) -> None:
        body = plant(start=(0.0, 0.0, -50.0))
        fdm = JsonFdm(body)
        step(fdm, packet(0, rate=10))
        assert body.time_s == pytest.approx(0.1)
        assert body.dynamics.dt <= 0.02

    def test_a_packet_that_comes_twice_is_answered_alike_and_no_time_passes(self) -> None:
        fdm = JsonFdm(plant())
        first = step(fdm, packet(0))
        again = fdm.take(packet(0))
        assert again is not None and told(again) == first
        assert (fdm.repeated, fdm.frames) == (1, 1)

    def test_lost_packets_are_made_up_for_but_not_without_end(self) -> None:
        fdm = JsonFdm(plant())
        step(fdm, packet(0, rate=400))
        assert step(fdm, packet(4, rate=400))["timestamp"] == pytest.approx(5 / 400)
        assert fdm.lost == 3
        assert step(fdm, packet(100_000, rate=400))["timestamp"] == pytest.approx(5 / 400 + 0.1)

    def test_a_counter_that_goes_back_is_a_new_stack_and_puts_the_vehicle_back(self) -> None:
        body = plant(start=(3.0, 4.0, 0.0), yaw=1.0)
        fdm = JsonFdm(body)
        for i in range(600):
            step(fdm, packet(i, [1800] * 16, rate=400))
        assert body.truth().pos[2] < -1.0
        found = step(fdm, packet(0, rate=400))
        assert (found["timestamp"], found["position"]) == (1 / 400, [0.0, 0.0, 0.0])
        assert body.truth().euler[2] == pytest.approx(1.0)
        assert fdm.restarts == 1


class TestAnswer:
    def test_a_vehicle_at_rest_feels_gravity_only(self) -> None:
        found = step(JsonFdm(plant(start=(100.0, -50.0, 0.0))), packet(0))
        assert found["imu"]["accel_body"] == pytest.approx([0.0, 0.0, -9.80665], abs=1e-4)
        assert found["imu"]["gyro"] == [0.0, 0.0, 0.0]
        assert found["position"] == [0.0, 0.0, 0.0]  # about its own start
        assert found["quaternion"] == [1.0, 0.0, 0.0, 0.0]
        assert found["no_time_sync"] == 1

    def test_an_accelerometer_leans_with_the_vehicle(self) -> None:
        body = plant(start=(0.0, 0.0, -20.0))
        lean(body, roll=0.2)
        assert body.truth().specific_force == pytest.approx(
            (0.0, -9.80665 * math.sin(0.2), -9.80665 * math.cos(0.2)), abs=1e-6
        )
        lean(body, pitch=0.3)
        assert body.truth().specific_force == pytest.approx(
            (9.80665 * math.sin(0.3), 0.0, -9.80665 * math.cos(0.3)), abs=1e-6
        )

    def test_free_fall_feels_nothing(self) -> None:
        fdm = JsonFdm(plant(start=(0.0, 0.0, -100.0)))
        found = step(fdm, packet(0))
        assert found["imu"]["accel_body"] == pytest.approx([0.0, 0.0, 0.0], abs=1e-3)
        assert found["velocity"][2] > 0.0

    def test_wind_is_told_as_the_instruments_see_it(self) -> None:
        body = plant(start=(0.0, 0.0, -20.0), wind=(-6.0, 0.0, 0.0))  # blows to the south: from ahead
        found = told(compose(body))
        assert found["windvane"]["direction"] == pytest.approx(0.0, abs=1e-4)
        assert found["windvane"]["speed"] == pytest.approx(6.0)
        assert found["airspeed"] == pytest.approx(6.0)
        assert found["velocity_wind"] == [-6.0, 0.0, 0.0]
        lean(body, yaw=math.pi / 2)  # the nose to the east: the wind comes from the left
        assert told(compose(body))["windvane"]["direction"] == pytest.approx(1.5 * math.pi, abs=1e-4)

    def test_the_battery_is_told(self) -> None:
        assert told(compose(plant()))["battery"] == {"voltage": 12.6, "current": 0}

    def test_the_rangefinder_sees_the_ground_along_its_axis(self) -> None:
        body = plant(start=(0.0, 0.0, -10.0))
        assert told(compose(body))["rng_1"] == pytest.approx(10.0)
        lean(body, roll=math.radians(60))
        assert told(compose(body))["rng_1"] == pytest.approx(20.0, rel=1e-3)
        lean(body, roll=math.radians(120))
        # ArduPilot would keep the last distance of a rangefinder that says nothing more.
        assert told(compose(body))["rng_1"] == 9999.0
        assert told(compose(plant(start=(0.0, 0.0, -160.0))))["rng_1"] == pytest.approx(160.0)


@pytest.mark.parametrize(
    ("name", "motor", "roll", "pitch", "yaw"),
    [
        # ardupilot.org, "Connect ESCs and Motors": motor 1 of each frame, and one more; signs of the moment it makes.
        ("quad", 1, -1, 0, 1),
        ("quad", 2, 1, 0, 1),
        ("quad", 3, 0, 1, -1),
        ("quad", 4, 0, -1, -1),
        ("sih", 1, -1, 1, 1),
        ("sih", 2, 1, -1, 1),
        ("sih", 3, 1, 1, -1),
        ("sih", 4, -1, -1, -1),
        ("hexa", 1, -1, 0, -1),
        ("hexa", 2, 1, 0, 1),
        ("hexa", 3, 1, 1, -1),
        ("hexa", 4, -1, -1, 1),
        ("hexa", 5, -1, 1, 1),
        ("hexa", 6, 1, -1, -1),
    ],
)
def test_motors_sit_where_ardupilot_counts_them(name: str, motor: int, roll: int, pitch: int, yaw: int) -> None:
    body = plant(name, start=(0.0, 0.0, -50.0))
    pwm = [1000] * 16
    pwm[motor - 1] = 1600
    fdm = JsonFdm(body)
    for i in range(8):
        step(fdm, packet(i, pwm, rate=400))
    assert [int(np.sign(round(rate, 4))) for rate in body.truth().rate] == [roll, pitch, yaw]


def test_pulses_become_throttle_and_outputs_without_pulses_do_nothing() -> None:
    assert craft("quad").from_pwm([1000, 1500, 2000, 2400, *[0] * 12]) == [0.0, 0.5, 1.0, 1.0]
    assert craft("quad").from_pwm([0, 900, 1250, 1000, *[0] * 12]) == [0.0, 0.0, 0.25, 0.0]


def test_a_controller_hovers_by_the_answers_alone() -> None:
    body = plant(wind=(3.0, 0.0, 0.0))
    fdm = JsonFdm(body)
    pwm = list(STILL)
    for i in range(10 * 400):
        found = step(fdm, packet(i, pwm, rate=400))
        pwm[:4] = [round(1000 + 1000 * u) for u in steer(PLUS, state_of(found), (0.0, 0.0, -5.0), 0.7)]
    north, east, down = body.truth().pos
    assert (north, east, down) == pytest.approx((0.0, 0.0, -5.0), abs=1.0)
    assert body.truth().euler[2] == pytest.approx(0.7, abs=0.05)
    assert body.battery.current[0] == pytest.approx(28.3, rel=0.15)


def test_a_rover_steers_by_its_first_output_and_drives_by_its_third() -> None:
    body = plant("rover")
    fdm = JsonFdm(body)
    pwm = [1500, 0, 1700, *[0] * 13]
    for i in range(400):
        step(fdm, packet(i, pwm, rate=400))
    assert body.truth().vel[0] > 1.0
    assert body.truth().rate[2] == pytest.approx(0.0)
    pwm[0] = 1800
    for i in range(400, 500):
        step(fdm, packet(i, pwm, rate=400))
    assert body.truth().rate[2] > 0.5  # to the right
    pwm[2] = 1100
    for i in range(500, 1600):
        step(fdm, packet(i, pwm, rate=400))
    ahead, _, _ = body.truth().to_body(*body.truth().vel)
    assert ahead < -1.0


@pytest.mark.parametrize(("output", "axis"), [(0, 0), (1, 1), (3, 2)])
def test_a_planes_longer_pulses_roll_right_pitch_up_and_yaw_right(output: int, axis: int) -> None:
    def rates(width: int) -> list[float]:
        body = plant("plane", start=(0.0, 0.0, -200.0))
        body.dynamics.vel[0] = 20.0
        pwm = [1500, 1500, 1400, 1500, *[0] * 12]
        pwm[output] = width
        fdm = JsonFdm(body)
        for i in range(60):
            step(fdm, packet(i, pwm, rate=400))
        return body.truth().rate

    assert rates(1700)[axis] - rates(1300)[axis] > 0.1


def test_a_planes_throttle_begins_at_1000_and_its_pitot_tube_is_told() -> None:
    body = plant("plane", start=(0.0, 0.0, -200.0), wind=(-5.0, 0.0, 0.0))
    body.dynamics.vel[0] = 15.0
    found = step(JsonFdm(body), packet(0, [1500, 1500, 1000, 1500, *[0] * 12]))
    assert body.values[2] == 0.0
    assert found["airspeed"] == pytest.approx(20.0, abs=0.1)
