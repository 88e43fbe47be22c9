"""Modes, arming and sticks of the simulated ArduRover, against what the real one was seen to do."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tests.sim.rover.conftest import MakeYard, Yard

MANUAL, HOLD, LOITER, AUTO, RTL, GUIDED, INITIALISING = 0, 4, 5, 10, 11, 15, 16


def test_wakes_up(make_yard: MakeYard) -> None:
    """INITIALISING for the boot, then the mode of the switch; state and flags as recorded."""
    yard = make_yard(ready_s=12.0)
    seen: list[tuple[int, int, int]] = []
    for _ in range(28):
        yard.gcs.world.step(0.5)
        beat = yard.gcs.all("HEARTBEAT")[-1]
        step = (beat["custom_mode"], beat["base_mode"], beat["system_status"])
        if seen[-1:] != [step]:
            seen.append(step)
    assert beat["type"] == 10
    assert seen == [(INITIALISING, 65, 2), (MANUAL, 65, 4)]
    texts = yard.gcs.texts()
    assert "Beginning INS calibration. Do not move vehicle" in texts
    assert texts.index("ArduPilot Ready") < texts.index("AHRS: DCM active") < texts.index("AHRS: EKF3 active")


def test_mode_in_the_heartbeat(yard: Yard) -> None:
    yard.gcs.until(lambda: yard.rover.position_ok)
    for mode, flags, state in ((MANUAL, 65, 4), (HOLD, 1, 3), (LOITER, 9, 4), (RTL, 9, 4), (GUIDED, 9, 4)):
        assert yard.mode(mode) == 0
        beat = yard.gcs.last("HEARTBEAT")
        assert (beat["custom_mode"], beat["base_mode"], beat["system_status"]) == (mode, flags, state)


def test_modes_that_are_refused(yard: Yard) -> None:
    yard.gcs.until(lambda: yard.rover.position_ok)
    before = yard.rover.mode
    for mode, texts in {
        2: ["No such mode 2"],
        13: ["No such mode 13"],
        INITIALISING: ["Flight mode change failed"],
        AUTO: ["No Mission. Can't set AUTO.", "Flight mode change failed"],
    }.items():
        yard.gcs.clear()
        assert yard.mode(mode) == 4
        assert yard.gcs.texts() == texts
        assert yard.rover.mode is before


def test_arming(yard: Yard) -> None:
    yard.gcs.until(lambda: yard.rover.position_ok)
    yard.gcs.clear()
    yard.mode(RTL)
    assert yard.gcs.command(400, 1) == 4
    assert yard.gcs.texts() == ["Arm: Mode not armable"]
    yard.mode(HOLD)
    yard.rover.pilot.pwm[2] = 1700
    yard.gcs.world.step(0.1)
    assert yard.gcs.command(400, 1) == 4
    assert yard.gcs.texts()[-1] == "Arm: Throttle (RC3) is not neutral"
    yard.rover.pilot.pwm[2] = 1500
    yard.gcs.world.step(0.1)
    assert yard.gcs.command(400, 1) == 0
    assert yard.gcs.texts()[-1] == "Throttle armed"
    assert yard.gcs.command(400, 0) == 0
    assert yard.gcs.texts()[-1] == "Throttle disarmed"


def test_needs_a_position_only_where_it_must(make_yard: MakeYard) -> None:
    yard = make_yard(ready_s=8.0)
    yard.gcs.until(lambda: yard.rover.boot.has("prearm"))
    assert yard.mode(GUIDED) == 0
    assert yard.gcs.command(400, 1) == 4
    assert yard.mode(MANUAL) == 0
    assert yard.gcs.command(400, 1) == 0
    assert yard.mode(LOITER) == 4


def test_disarms_on_its_way(yard: Yard) -> None:
    """The motors stop; the wheels go on until they stand, and home follows it."""
    yard.ready(MANUAL)
    yard.keep(3.0, lambda: yard.sticks(1500, 1650))
    assert yard.speed > 2.0
    assert yard.gcs.command(400, 0) == 0
    yard.gcs.until(yard.stands)
    yard.gcs.world.step(1.5)
    assert yard.rover.from_home < 0.6
    assert math.hypot(*yard.place) > 5.0


def test_manual(yard: Yard) -> None:
    """Outputs as measured on the real one: past the dead zone, throttle in whole per cents."""
    yard.ready(MANUAL)
    for pulses, servos in (((1500, 1600), (1500, 1570)), ((1800, 1600), (1787, 1570)), ((1800, 1300), (1787, 1320))):
        yard.keep(1.0, lambda p=pulses: yard.sticks(*p))  # type: ignore[misc]
        out = yard.gcs.last("SERVO_OUTPUT_RAW")
        assert (out["servo1_raw"], out["servo3_raw"]) == servos
    assert out["servo2_raw"] == out["servo4_raw"] == 0


def test_manual_control(yard: Yard) -> None:
    """Steering by y, throttle by z, both ways; the sticks' own axes are left alone."""
    yard.ready(MANUAL)
    gcs = yard.gcs
    for z, y, servos in ((600, 200, (1574, 1785)), (300, -200, (1426, 1625))):
        yard.keep(1.0, lambda z=z, y=y: gcs.send("MANUAL_CONTROL", target=1, x=0, y=y, z=z, r=0))  # type: ignore[misc]
        out = gcs.last("SERVO_OUTPUT_RAW")
        assert (out["servo1_raw"], out["servo3_raw"]) == servos
    yard.keep(2.0, lambda: gcs.send("MANUAL_CONTROL", target=1, x=0, y=0, z=-500, r=0))
    assert yard.speed < 0.0


def test_backs_up_as_the_stick_points(yard: Yard) -> None:
    """Stick to the right, backwards: the wheels stand to the right, and the nose goes left."""
    yard.ready(MANUAL)
    yard.keep(3.0, lambda: yard.sticks(1800, 1350))
    assert yard.speed < -1.0
    assert yard.rover.sense.r < -0.3


def test_hold_coasts(yard: Yard) -> None:
    yard.ready(MANUAL)
    yard.keep(3.0, lambda: yard.sticks(1500, 1650))
    yard.mode(HOLD)
    yard.gcs.world.step(0.5)
    out = yard.gcs.last("SERVO_OUTPUT_RAW")
    assert (out["servo1_raw"], out["servo3_raw"]) == (1500, 1500)
    yard.gcs.until(yard.stands)


def test_loiter_stays_within_its_radius(yard: Yard) -> None:
    """Brakes to the place where it can stop; moved out of LOIT_RADIUS it backs to it."""
    yard.ready(MANUAL)
    yard.keep(3.0, lambda: yard.sticks(1500, 1620))
    yard.mode(LOITER)
    target = yard.gcs.last("POSITION_TARGET_GLOBAL_INT")
    yard.gcs.until(yard.stands)
    place = yard.rover.mode.place
    assert place is not None
    where = (place[0] - yard.rover.origin_world[0], place[1] - yard.rover.origin_world[1])
    assert math.dist(where, yard.place) < yard.rover.params["LOIT_RADIUS"] + 0.5
    assert target["type_mask"] == 0xFDF8
    fleet = yard.gcs.vehicle.node.seat.fleet
    fleet.dynamics.pos[0, 0] += 10.0
    yard.gcs.until(lambda: math.dist(where, yard.place) < yard.rover.params["LOIT_RADIUS"] + 0.2, 30.0)
    assert abs(yard.rover.sense.yaw) < 0.5, "it has turned round instead of backing"


def test_mode_switch_is_on_channel_eight(yard: Yard) -> None:
    """MODE1 to MODE6 and MODE_CH."""
    yard.ready(HOLD)
    yard.gcs.vehicle.pilot_mode("RTL")
    yard.gcs.world.step(0.3)
    assert yard.rover.mode.name == "RTL"
    assert yard.rover.pilot.pwm[7] == 1425


def test_return_home(yard: Yard) -> None:
    """Straight home, and a stop there; RTL_SPEED and DO_CHANGE_SPEED say how fast."""
    yard.ready()
    yard.goto(8.0, 2.0)
    yard.gcs.until(lambda: math.dist(yard.place, (8.0, 2.0)) < 2.0 and yard.stands(), 40.0)
    yard.gcs.clear()
    assert yard.gcs.command(20) == 0
    assert yard.rover.mode.name == "RTL"
    yard.gcs.until(lambda: "Reached destination" in yard.gcs.texts(), 40.0)
    yard.gcs.until(yard.stands)
    assert math.hypot(*yard.place) < yard.rover.params["WP_RADIUS"]
    assert yard.rover.armed
