"""Modes, arming and sticks of the simulated ArduRover, against what the real one was seen to do."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.sim.rover.conftest import MakeYard, Yard

MANUAL, ACRO, STEERING, HOLD, LOITER, FOLLOW, SIMPLE, DOCK, CIRCLE = 0, 1, 3, 4, 5, 6, 7, 8, 9
AUTO, RTL, SMART_RTL, GUIDED, INITIALISING = 10, 11, 12, 15, 16


def test_wakes_up(make_yard: MakeYard) -> None:
    """INITIALISING for the boot, then the mode of the switch; state and flags as recorded."""
    yard = make_yard(ready_s=12.0)
    seen: list[tuple[int, int, int]] = []
    for _ in range(28):
        yard.desk.world.step(0.5)
        beat = yard.desk.all("HEARTBEAT")[-1]
        step = (beat["custom_mode"], beat["base_mode"], beat["system_status"])
        if seen[-1:] != [step]:
            seen.append(step)
    assert beat["type"] == 10
    assert seen == [(INITIALISING, 65, 2), (MANUAL, 65, 4)]
    texts = yard.desk.texts()
    assert "Beginning INS calibration. Do not move vehicle" in texts
    assert texts.index("ArduPilot Ready") < texts.index("AHRS: DCM active") < texts.index("AHRS: EKF3 active")


def test_mode_in_the_heartbeat(yard: Yard) -> None:
    yard.desk.until(lambda: yard.rover.position_ok)
    for mode, flags, state in (
        (MANUAL, 65, 4), (ACRO, 65, 4), (STEERING, 65, 4), (HOLD, 1, 3), (LOITER, 9, 4), (SIMPLE, 1, 4), (CIRCLE, 9, 4),
        (RTL, 9, 4), (SMART_RTL, 9, 4), (GUIDED, 9, 4),
    ):  # fmt: skip
        assert yard.mode(mode) == 0
        beat = yard.desk.last("HEARTBEAT")
        assert (beat["custom_mode"], beat["base_mode"], beat["system_status"]) == (mode, flags, state)


def test_modes_that_are_refused(yard: Yard) -> None:
    yard.desk.until(lambda: yard.rover.position_ok)
    before = yard.rover.mode
    for mode, texts in {
        2: ["No such mode 2"],
        13: ["No such mode 13"],
        FOLLOW: ["Flight mode change failed"],
        DOCK: ["Dock: target not acquired", "Flight mode change failed"],
        INITIALISING: ["Flight mode change failed"],
        AUTO: ["No Mission. Can't set AUTO.", "Flight mode change failed"],
    }.items():
        yard.desk.clear()
        assert yard.mode(mode) == 4
        assert yard.desk.texts() == texts
        assert yard.rover.mode is before


def test_arming(yard: Yard) -> None:
    yard.desk.until(lambda: yard.rover.position_ok)
    yard.desk.clear()
    yard.mode(RTL)
    assert yard.desk.command(400, 1) == 4
    assert yard.desk.texts() == ["Arm: Mode not armable"]
    yard.mode(HOLD)
    yard.rover.pilot.pwm[2] = 1700
    yard.desk.world.step(0.1)
    assert yard.desk.command(400, 1) == 4
    assert yard.desk.texts()[-1] == "Arm: Throttle (RC3) is not neutral"
    yard.rover.pilot.pwm[2] = 1500
    yard.desk.world.step(0.1)
    assert yard.desk.command(400, 1) == 0
    assert yard.desk.texts()[-1] == "Throttle armed"
    assert yard.desk.command(400, 0) == 0
    assert yard.desk.texts()[-1] == "Throttle disarmed"


def test_needs_a_position_only_where_it_must(make_yard: MakeYard) -> None:
    yard = make_yard(ready_s=8.0)
    yard.desk.until(lambda: yard.rover.boot.has("prearm"))
    assert yard.mode(GUIDED) == 0
    assert yard.desk.command(400, 1) == 4
    assert yard.mode(MANUAL) == 0
    assert yard.desk.command(400, 1) == 0
    assert yard.mode(LOITER) == 4


def test_disarms_on_its_way(yard: Yard) -> None:
    """The motors stop; the wheels go on until they stand, and home follows it."""
    yard.ready(MANUAL)
    yard.keep(3.0, lambda: yard.sticks(1500, 1650))
    assert yard.speed > 2.0
    assert yard.desk.command(400, 0) == 0
    yard.desk.until(yard.stands)
    yard.desk.world.step(1.5)
    assert yard.rover.from_home < 0.6
    assert math.hypot(*yard.place) > 5.0


def test_manual(yard: Yard) -> None:
    """Outputs as measured on the real one: past the dead zone, throttle in whole per cents."""
    yard.ready(MANUAL)
    for pulses, servos in (((1500, 1600), (1500, 1570)), ((1800, 1600), (1787, 1570)), ((1800, 1300), (1787, 1320))):
        yard.keep(1.0, lambda p=pulses: yard.sticks(*p))  # type: ignore[misc]
        out = yard.desk.last("SERVO_OUTPUT_RAW")
        assert (out["servo1_raw"], out["servo3_raw"]) == servos
    assert out["servo2_raw"] == out["servo4_raw"] == 0


def test_manual_control(yard: Yard) -> None:
    """Steering by y, throttle by z, both ways; the sticks' own axes are left alone."""
    yard.ready(MANUAL)
    desk = yard.desk
    for z, y, servos in ((600, 200, (1574, 1785)), (300, -200, (1426, 1625))):
        yard.keep(1.0, lambda z=z, y=y: desk.send("MANUAL_CONTROL", target=1, x=0, y=y, z=z, r=0))  # type: ignore[misc]
        out = desk.last("SERVO_OUTPUT_RAW")
        assert (out["servo1_raw"], out["servo3_raw"]) == servos
    yard.keep(2.0, lambda: desk.send("MANUAL_CONTROL", target=1, x=0, y=0, z=-500, r=0))
    assert yard.speed < 0.0


def test_backs_up_as_the_stick_points(yard: Yard) -> None:
    """Stick to the right, backwards: the wheels stand to the right, and the nose goes left."""
    yard.ready(MANUAL)
    yard.keep(3.0, lambda: yard.sticks(1800, 1350))
    assert yard.speed < -1.0
    assert yard.rover.sense.r < -0.3


def test_acro_holds_speed_and_turn_rate(yard: Yard) -> None:
    """4 % of 16.7 m/s; 7/47 of ACRO_TURN_RATE."""
    yard.ready(ACRO)
    yard.keep(8.0, lambda: yard.sticks(1600, 1550))
    assert yard.speed == pytest.approx(0.04 * 5.0 / 0.30, abs=0.1)
    assert math.degrees(yard.rover.sense.r) == pytest.approx(180.0 * 70 / 470, rel=0.4)


def test_steering_holds_lateral_acceleration(yard: Yard) -> None:
    yard.ready(STEERING)
    yard.keep(7.0, lambda: yard.sticks(1970, 1650))
    lateral = yard.speed * yard.rover.sense.r
    assert lateral == pytest.approx(0.6 * 9.80665, rel=0.15)  # ATC_TURN_MAX_G


def test_simple_drives_where_the_sticks_point(yard: Yard) -> None:
    yard.ready(SIMPLE)
    yard.keep(8.0, lambda: yard.sticks(1600, 1500))
    assert yard.rover.sense.yaw == pytest.approx(math.pi / 2.0, abs=0.1)
    assert yard.speed == pytest.approx(70 / 470 * 5.0 / 0.30, rel=0.15)


def test_hold_coasts(yard: Yard) -> None:
    yard.ready(MANUAL)
    yard.keep(3.0, lambda: yard.sticks(1500, 1650))
    yard.mode(HOLD)
    yard.desk.world.step(0.5)
    out = yard.desk.last("SERVO_OUTPUT_RAW")
    assert (out["servo1_raw"], out["servo3_raw"]) == (1500, 1500)
    yard.desk.until(yard.stands)


def test_loiter_stays_within_its_radius(yard: Yard) -> None:
    """Brakes to the place where it can stop; moved out of LOIT_RADIUS it backs to it."""
    yard.ready(MANUAL)
    yard.keep(3.0, lambda: yard.sticks(1500, 1620))
    yard.mode(LOITER)
    target = yard.desk.last("POSITION_TARGET_GLOBAL_INT")
    yard.desk.until(yard.stands)
    place = yard.rover.loiter.place
    assert place is not None
    where = (place[0] - yard.rover.origin_world[0], place[1] - yard.rover.origin_world[1])
    assert math.dist(where, yard.place) < yard.rover.params["LOIT_RADIUS"] + 0.5
    assert target["type_mask"] == 0xFDF8
    fleet = yard.desk.vehicle.node.seat.fleet
    fleet.dynamics.pos[0, 0] += 10.0
    yard.desk.until(lambda: math.dist(where, yard.place) < yard.rover.params["LOIT_RADIUS"] + 0.2, 30.0)
    assert abs(yard.rover.sense.yaw) < 0.5, "it has turned round instead of backing"


def test_circle(make_yard: MakeYard) -> None:
    """To the edge, then round it clockwise at WP_SPEED, or what the lateral acceleration allows."""
    yard = make_yard(params={"CIRC_RADIUS": 8.0, "CIRC_SPEED": 3.0})
    yard.ready(CIRCLE)
    yard.desk.world.step(12.0)
    assert math.hypot(*yard.place) == pytest.approx(8.0, abs=1.0)
    assert yard.speed == pytest.approx(3.0, abs=0.5)
    assert yard.rover.sense.r == pytest.approx(3.0 / 8.0, rel=0.2)
    assert yard.desk.last("NAV_CONTROLLER_OUTPUT")["nav_bearing"] != 0
    assert yard.desk.command(178, 1, 20) == 0
    assert yard.desk.texts()[-1] == f"Circle: max speed is {math.sqrt(0.6 * 9.80665 * 8.0):4.1f}"


def test_circle_no_smaller_than_it_can_turn(make_yard: MakeYard) -> None:
    yard = make_yard(params={"CIRC_RADIUS": 0.3})
    yard.ready(CIRCLE)
    yard.desk.world.step(0.1)
    assert "Circle: radius increased to TURN_RADIUS ( 0.9)" in [*yard.desk.texts(), *_said_before(yard)]


def _said_before(yard: Yard) -> list[str]:
    yard.mode(HOLD)
    yard.desk.clear()
    yard.mode(CIRCLE)
    return yard.desk.texts()


def test_mode_switch_is_on_channel_eight(yard: Yard) -> None:
    """MODE1 to MODE6 and MODE_CH."""
    yard.ready(HOLD)
    yard.desk.vehicle.pilot_mode("RTL")
    yard.desk.world.step(0.3)
    assert yard.rover.mode.name == "RTL"
    assert yard.rover.pilot.pwm[7] == 1425


def test_return_home(yard: Yard) -> None:
    """Straight home, and a stop there; RTL_SPEED and DO_CHANGE_SPEED say how fast."""
    yard.ready()
    yard.goto(8.0, 2.0)
    yard.desk.until(lambda: math.dist(yard.place, (8.0, 2.0)) < 2.0 and yard.stands(), 40.0)
    yard.desk.clear()
    assert yard.desk.command(20) == 0
    assert yard.rover.mode.name == "RTL"
    yard.desk.until(lambda: "Reached destination" in yard.desk.texts(), 40.0)
    yard.desk.until(yard.stands)
    assert math.hypot(*yard.place) < yard.rover.params["WP_RADIUS"]
    assert yard.rover.armed


def test_smart_return_keeps_to_its_track(yard: Yard) -> None:
    """Round the corner it came by, not straight across."""
    yard.ready()
    for place in ((10.0, 0.0), (10.0, 10.0)):
        yard.goto(*place)
        yard.desk.until(lambda p=place: math.dist(yard.place, p) < 2.0 and yard.stands(), 40.0)  # type: ignore[misc]
    assert yard.mode(SMART_RTL) == 0
    nearest, start = math.inf, yard.desk.world.time_s
    while yard.rover.from_home > 2.5:
        assert yard.desk.world.time_s - start < 90.0
        yard.desk.world.step(0.2)
        nearest = min(nearest, math.dist(yard.place, (10.0, 0.0)))
    assert nearest < 3.0
