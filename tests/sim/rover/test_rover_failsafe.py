"""ArduRover's failsafes and fence, with the numbers and words that the real one was seen to use."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.sim.rover.conftest import MakeYard, Yard

HOLD, AUTO, RTL, GUIDED, MANUAL = 4, 10, 11, 15, 0
HEARTBEAT = {"type": 6, "autopilot": 8}


def set_param(yard: Yard, name: str, value: float) -> None:
    yard.gcs.send("PARAM_SET", param_id=name, param_value=value, param_type=9)


def test_ground_station_lost(make_yard: MakeYard) -> None:
    """FS_GCS_TIMEOUT and FS_TIMEOUT after its last word: FS_ACTION, under the radio's name, as in the real one."""
    yard = make_yard(params={"FS_GCS_ENABLE": 1})
    yard.ready()
    yard.goto(60.0, 0.0)
    yard.gcs.send("HEARTBEAT", **HEARTBEAT)
    took = yard.gcs.until(lambda: yard.rover.mode.number == HOLD, 20.0)
    assert took == pytest.approx(5.0 + 1.5, abs=0.25)
    assert yard.gcs.texts() == ["Radio Failsafe"]
    assert yard.gcs.last("HEARTBEAT")["system_status"] == 5
    yard.gcs.send("HEARTBEAT", **HEARTBEAT)
    yard.gcs.world.step(0.3)
    assert yard.gcs.texts()[-1] == "GCS Failsafe Cleared"
    assert yard.gcs.last("HEARTBEAT")["system_status"] == 3
    assert yard.rover.mode.number == HOLD


def test_ground_station_lost_by_its_own_name(make_yard: MakeYard) -> None:
    yard = make_yard(params={"FS_GCS_ENABLE": 1, "FS_THR_ENABLE": 0, "FS_ACTION": 1})
    yard.ready()
    yard.goto(10.0, 0.0)
    yard.gcs.send("HEARTBEAT", **HEARTBEAT)
    yard.gcs.until(lambda: yard.rover.mode.number == RTL, 20.0)
    assert "GCS Failsafe" in yard.gcs.texts()


def test_who_was_never_heard_is_not_missed(make_yard: MakeYard) -> None:
    yard = make_yard(params={"FS_GCS_ENABLE": 1})
    yard.ready()
    yard.gcs.world.step(10.0)
    assert yard.rover.mode.number == GUIDED


def test_radio_lost(yard: Yard) -> None:
    """Half a second without pulses, and FS_TIMEOUT more; in HOLD nothing happens."""
    yard.ready()
    yard.rover.pilot.lose()
    took = yard.gcs.until(lambda: yard.rover.mode.number == HOLD, 10.0)
    assert took == pytest.approx(2.0, abs=0.25)
    assert yard.gcs.texts() == ["Radio Failsafe"]
    yard.rover.pilot.regain()
    yard.gcs.world.step(0.3)
    assert yard.gcs.texts()[-1] == "Radio Failsafe Cleared"
    yard.gcs.clear()
    yard.rover.pilot.lose()
    yard.gcs.world.step(5.0)
    assert yard.gcs.texts() == []


def test_throttle_of_a_lost_radio(make_yard: MakeYard) -> None:
    """Below FS_THR_VALUE is as none at all."""
    yard = make_yard(params={"FS_ACTION": 5})
    yard.ready(MANUAL)
    yard.rover.pilot.pwm[2] = 900
    yard.gcs.until(lambda: not yard.rover.armed, 5.0)
    assert yard.gcs.texts()[-2:] == ["Radio Failsafe", "Throttle disarmed"]
    assert yard.stands(), "a lost stick has driven it"


def test_a_mission_goes_on(make_yard: MakeYard) -> None:
    """FS_THR_ENABLE 2."""
    from tests.sim import plans

    yard = make_yard(params={"FS_THR_ENABLE": 2})
    yard.gcs.until(lambda: yard.rover.position_ok)
    assert plans.upload(yard.gcs, [plans.at(16, 100, 0)]) == 0
    yard.ready()
    yard.mode(AUTO)
    yard.rover.pilot.lose()
    yard.gcs.world.step(3.0)
    assert "Failsafe - Continuing Auto Mode" in yard.gcs.texts()
    assert yard.rover.mode.number == AUTO


def test_low_battery(make_yard: MakeYard) -> None:
    """BATT_FS_LOW_ACT 2 holds, BATT_LOW_TIMER seconds after the voltage fell; the state stays what the mode's is."""
    yard = make_yard(params={"BATT_LOW_VOLT": 11.0, "BATT_FS_LOW_ACT": 2})
    yard.ready()
    set_param(yard, "SIM_BATT_VOLTAGE", 10.5)
    took = yard.gcs.until(lambda: yard.rover.mode.number == HOLD, 20.0)
    assert took == pytest.approx(10.0, abs=0.5)
    assert yard.gcs.texts()[0].startswith("Battery 1 is low 10.")
    assert yard.gcs.last("HEARTBEAT")["system_status"] == 3


def test_lost_position(yard: Yard) -> None:
    """Without a GPS GUIDED goes on for a while, then holds; modes without a position remain."""
    yard.ready()
    yard.goto(80.0, 0.0)
    yard.gcs.world.step(2.0)
    yard.gcs.world.fault("rover1", "gps-loss")
    took = yard.gcs.until(lambda: yard.rover.mode.number == HOLD, 20.0)
    assert took == pytest.approx(8.5, abs=1.5)
    assert [t for t in yard.gcs.texts() if "EKF" in t and "IMU" not in t][:2] == ["EKF variance", "EKF failsafe"]
    assert yard.gcs.last("HEARTBEAT")["system_status"] == 5
    yard.gcs.until(yard.stands)
    assert [yard.mode(m) for m in (5, RTL, MANUAL)] == [4, 4, 0]


@pytest.mark.parametrize(("action", "mode"), [(1, "RTL"), (2, "HOLD"), (6, "LOITER"), (0, "MANUAL")])
def test_fence(make_yard: MakeYard, action: int, mode: str) -> None:
    """Across the circle by hand: FENCE_ACTION."""
    yard = make_yard(params={"FENCE_ENABLE": 1, "FENCE_TYPE": 2, "FENCE_RADIUS": 10, "FENCE_ACTION": action})
    yard.ready(MANUAL)
    yard.keep(7.0, lambda: yard.sticks(1500, 1650))
    assert math.hypot(*yard.place) > 10.0
    assert yard.rover.mode.name == mode
    assert any("breached" in text for text in yard.gcs.texts())
    assert yard.gcs.last("FENCE_STATUS")["breach_count"] == 1


def test_only_circles_and_polygons(make_yard: MakeYard) -> None:
    """A rover has no ceiling: the bits of FENCE_TYPE for one mean nothing."""
    yard = make_yard(params={"FENCE_ENABLE": 1, "FENCE_TYPE": 15})
    yard.ready()
    yard.gcs.world.step(1.0)
    assert yard.rover.fence.configured == 6


def test_rally(yard: Yard) -> None:
    """RTL goes to the nearest rally point where it is nearer than home."""
    from tests.sim import plans

    yard.gcs.until(lambda: yard.rover.position_ok)
    here = yard.rover.position
    north = round((here.lat_deg + 0.00009) * 1e7)
    point = {"command": 5100, "frame": 3, "x": north, "y": round(here.lon_deg * 1e7), "z": 0.0}
    assert plans.upload(yard.gcs, [point], 2) == 0
    yard.ready()
    yard.goto(16.0, 0.0)
    yard.gcs.until(lambda: yard.place[0] > 14.0 and yard.stands(), 40.0)
    yard.mode(RTL)
    yard.gcs.until(lambda: "Reached destination" in yard.gcs.texts(), 30.0)
    assert yard.place[0] == pytest.approx(10.0, abs=3.0)


def test_every_frame_of_its_radio_is_heard(yard: Yard) -> None:
    """One comes with each of its own updates, 20 ms apart, whatever becomes of that by rounding."""
    yard.ready()
    for _ in range(200):
        yard.gcs.world.step(0.02)
        assert yard.rover.rc.silent_s < 0.015
