"""What an ArduPlane does when its pilot, its ground station, its battery, its fence or its engine fails it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.sim.plane.conftest import CIRCLE, FBWA, GUIDED, LOITER, MANUAL, RTL

if TYPE_CHECKING:
    from tests.sim.plane.conftest import Field


def warnings(field: Field) -> list[str]:
    return [m["text"] for m in field.gcs.all("STATUSTEXT") if m["severity"] == 4]


def test_losing_the_radio_has_a_short_and_a_long_step(flying: Field) -> None:
    flying.plane.pilot.sticks(throttle=0.5)
    assert flying.mode(FBWA) == 0
    flying.plane.pilot.lose()
    start = flying.gcs.world.time_s
    flying.gcs.until(lambda: flying.plane.mode.number == CIRCLE)
    assert flying.gcs.world.time_s - start == pytest.approx(1.5, abs=0.25)  # FS_SHORT_TIMEOUT
    assert flying.gcs.last("HEARTBEAT")["system_status"] == 5
    flying.gcs.until(lambda: flying.plane.mode.number == RTL)
    assert flying.gcs.world.time_s - start == pytest.approx(6.5, abs=0.4)  # and FS_LONG_TIMEOUT after it
    flying.plane.pilot.regain()
    flying.wait(0.5)
    assert warnings(flying) == [
        "Throttle failsafe on",
        "RC Short Failsafe: switched to CIRCLE",
        "RC Long Failsafe On: RTL",
        "Throttle failsafe off",
        "RC Long Failsafe Cleared",
    ]
    assert flying.plane.mode.number == RTL
    assert flying.gcs.last("HEARTBEAT")["system_status"] == 4


def test_a_radio_that_comes_back_soon_gives_the_mode_back(flying: Field) -> None:
    flying.plane.pilot.sticks(throttle=0.5)
    assert flying.mode(FBWA) == 0
    flying.plane.pilot.lose()
    flying.wait(2.5)
    assert flying.plane.mode.number == CIRCLE
    flying.plane.pilot.regain()
    flying.wait(0.5)
    assert flying.plane.mode.number == FBWA
    assert warnings(flying)[-2:] == ["Throttle failsafe off", "Short Failsafe Cleared"]
    assert "Flight mode FBWA restored" in flying.gcs.texts()


@pytest.mark.parametrize(("action", "mode"), [(0, GUIDED), (1, RTL), (2, FBWA)])
def test_on_errands_the_long_action_decides(flying: Field, action: int, mode: int) -> None:
    flying.set("FS_LONG_ACTN", action)
    assert flying.mode(GUIDED) == 0
    flying.plane.pilot.lose()
    flying.wait(2.5)
    assert flying.plane.mode.number == GUIDED
    assert "RC Short Failsafe On" in warnings(flying)
    flying.wait(5.0)
    assert flying.plane.mode.number == mode
    assert f"RC Long Failsafe On: {flying.plane.mode.name}" in warnings(flying)


@pytest.mark.parametrize(("action", "mode"), [(1, CIRCLE), (2, FBWA), (3, LOITER)])
def test_the_short_action_decides(flying: Field, action: int, mode: int) -> None:
    flying.set("FS_SHORT_ACTN", action)
    flying.plane.pilot.lose()
    flying.wait(2.2)
    assert flying.plane.mode.number == mode
    if action == 2:
        # It glides: level, without power.
        flying.wait(1.0)
        assert flying.plane.sense.throttle == 0.0
        assert abs(flying.plane.sense.roll) < 0.1


def test_a_low_throttle_is_a_lost_radio_unless_it_is_not_watched(flying: Field) -> None:
    flying.plane.pilot.pwm[2] = 950
    flying.set("THR_FS_VALUE", 960)
    flying.wait(0.5)
    assert flying.plane.rc.lost
    flying.set("THR_FAILSAFE", 0)
    flying.wait(0.3)
    assert not flying.plane.rc.lost


def test_the_ground_station_is_missed_where_asked(flying: Field) -> None:
    flying.set("FS_GCS_ENABL", 1)
    flying.set("FS_LONG_ACTN", 1)
    assert flying.mode(GUIDED) == 0
    flying.keep(3.0, flying.heartbeat)
    assert flying.plane.mode.number == GUIDED
    flying.wait(6.0)
    assert flying.plane.mode.number == RTL
    flying.keep(1.0, flying.heartbeat)
    assert warnings(flying) == ["GCS Failsafe On: RTL", "GCS Failsafe Off"]


def test_by_default_nobody_misses_the_ground_station(flying: Field) -> None:
    flying.heartbeat()
    flying.wait(8.0)
    assert flying.plane.mode.number == LOITER
    assert not warnings(flying)


def test_a_low_battery(flying: Field) -> None:
    flying.set("BATT_FS_LOW_ACT", 1)
    flying.set("BATT_LOW_TIMER", 1)
    flying.set("BATT_LOW_VOLT", 13.0)
    flying.wait(2.0)
    assert flying.plane.mode.number == RTL
    assert warnings(flying)[0].startswith("Battery 1 is low 12.")


@pytest.mark.parametrize(("action", "mode"), [(0, FBWA), (1, RTL)])
def test_a_fence_is_kept(flying: Field, action: int, mode: int) -> None:
    for name, value in {"FENCE_TYPE": 2, "FENCE_RADIUS": 130, "FENCE_ACTION": action, "FENCE_ENABLE": 1}.items():
        flying.set(name, value)
    flying.plane.pilot.sticks(throttle=0.6)
    assert flying.mode(FBWA) == 0
    flying.gcs.until(lambda: flying.away() > 130.0)
    flying.wait(0.5)
    assert flying.plane.mode.number == mode
    assert "Circle fence breached" in flying.gcs.texts()
    assert flying.gcs.last("FENCE_STATUS")["breach_type"] == 3
    if action:
        flying.gcs.clear()
        assert flying.mode(MANUAL) == 4
        assert flying.gcs.texts() == ["Mode change to MANUAL denied, in fence recovery"]
        flying.gcs.until(lambda: flying.away() < 120.0, 30.0)
        flying.wait(0.5)
        assert "Fence breach cleared" in flying.gcs.texts()


def test_the_fence_keeps_repositions_out(flying: Field) -> None:
    for name, value in {"FENCE_TYPE": 2, "FENCE_RADIUS": 400, "FENCE_ENABLE": 1}.items():
        flying.set(name, value)
    flying.wait(0.2)
    assert flying.reposition(600, 0, 60, param2=1.0) == 2
    assert flying.plane.mode.number == LOITER


def test_with_everything_lost_it_flies_on_without_a_stall(flying: Field) -> None:
    """No radio, no ground station, no GPS: wings, speed and height are kept."""
    flying.set("FS_GCS_ENABL", 1)
    flying.heartbeat()
    flying.plane.pilot.lose()
    flying.gcs.world.fault("plane1", "gps-loss")
    speeds = flying.track(20.0, lambda: flying.plane.eas)
    assert 18.0 < min(speeds) <= max(speeds) < 28.0
    assert 40.0 < flying.plane.height < 130.0
    assert flying.plane.armed


def test_an_engine_that_stops_lets_it_glide(flying: Field) -> None:
    flying.set("THR_MAX", 0)
    speeds = flying.track(8.0, lambda: flying.plane.eas)
    assert min(speeds[8:]) > 8.0
    assert flying.plane.sense.throttle == 0.0


def test_sticks_from_the_ground_are_taken(flying: Field) -> None:
    assert flying.mode(FBWA) == 0

    def send() -> None:
        flying.gcs.send("MANUAL_CONTROL", target=flying.gcs.vehicle.sysid, x=0, y=500, z=600, r=0, buttons=0)

    flying.keep(2.0, send)
    assert flying.plane.sense.roll == pytest.approx(0.567, abs=0.05)  # half of ROLL_LIMIT_DEG
    assert flying.plane.sense.throttle == pytest.approx(0.6, abs=0.02)

    def override() -> None:
        flying.gcs.send(
            "RC_CHANNELS_OVERRIDE",
            chan1_raw=1250,
            chan2_raw=65535,
            chan3_raw=1500,
            chan4_raw=65535,
            **{f"chan{i}_raw": 65535 for i in range(5, 9)},
        )

    flying.keep(2.0, override)
    assert flying.plane.sense.roll == pytest.approx(-0.567, abs=0.05)
    assert flying.plane.mode.number == FBWA
