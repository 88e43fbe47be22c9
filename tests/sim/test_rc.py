"""The pilot's input: overrides, manual control, auxiliary switches, and what the receiver's loss leads to."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

from zmav.sim import VehicleSpec

if TYPE_CHECKING:
    from tests.sim.conftest import Gcs, MakeGcs

GUIDED, STABILIZE, LOITER, RTL, LAND = 4, 0, 5, 6, 9
ACCEPTED, DENIED, FAILED = 0, 2, 4
IGNORED, RELEASED = 65535, 65534

AnotherGcs = Callable[..., "Gcs"]


@pytest.fixture
def ready(gcs: Gcs) -> Gcs:
    gcs.world.step(1.0)
    return gcs


def override(gcs: Gcs, **channels: int) -> None:
    """RC_CHANNELS_OVERRIDE of some channels ("c3"), all others left alone."""
    values = {f"chan{i}_raw": IGNORED for i in range(1, 19)}
    values.update({f"chan{name[1:]}_raw": pwm for name, pwm in channels.items()})
    gcs.send("RC_CHANNELS_OVERRIDE", **values)
    gcs.world.step(0.05)


def channels(gcs: Gcs, *numbers: int) -> list[int]:
    fields = gcs.last("RC_CHANNELS")
    return [fields[f"chan{n}_raw"] for n in numbers]


class TestOverride:
    def test_what_the_receiver_gives_is_reported(self, ready: Gcs) -> None:
        fields = ready.last("RC_CHANNELS")
        assert [fields[f"chan{i}_raw"] for i in range(1, 10)] == [1500, 1500, 1000, 1500, 1800, 1000, 1000, 1800, 0]
        assert (fields["chancount"], fields["rssi"]) == (8, 255)

    def test_holds_channels_for_as_long_as_it_lasts(self, ready: Gcs) -> None:
        override(ready, c1=1600, c9=1234)
        assert channels(ready, 1, 2, 9) == [1600, 1500, 1234]
        ready.world.step(2.8)
        assert channels(ready, 1, 9) == [1600, 1234]
        ready.world.step(0.3)  # RC_OVERRIDE_TIME is 3 s
        assert channels(ready, 1, 9) == [1500, 0]

    def test_zero_releases_one_of_the_first_eight_only(self, ready: Gcs) -> None:
        override(ready, c1=1600, c9=1234)
        override(ready, c1=0, c9=0)
        assert channels(ready, 1, 9) == [1500, 1234]

    def test_65534_releases_one_of_the_others_only(self, ready: Gcs) -> None:
        override(ready, c1=RELEASED, c9=1234)
        assert channels(ready, 1, 9) == [RELEASED, 1234]  # taken for a pulse width, as the real one does
        override(ready, c9=RELEASED)
        assert channels(ready, 9) == [0]

    @pytest.mark.parametrize(("lasts", "held"), [(-1.0, True), (0.0, False)])
    def test_can_last_for_ever_or_not_at_all(self, make_gcs: MakeGcs, lasts: float, held: bool) -> None:
        gcs = make_gcs([VehicleSpec(params={"RC_OVERRIDE_TIME": lasts})])
        gcs.world.step(1.0)
        override(gcs, c1=1600)
        gcs.world.step(20.0)
        assert (channels(gcs, 1) == [1600]) is held

    def test_is_only_taken_from_the_ground_station(self, ready: Gcs, another_gcs: AnotherGcs) -> None:
        other = another_gcs(ready.world, ready.vehicle, sysid=254)
        override(other, c1=1700)
        assert channels(ready, 1) == [1500]
        ready.send("PARAM_SET", param_id="MAV_GCS_SYSID", param_value=254.0, param_type=4)
        override(other, c1=1700)
        assert channels(ready, 1) == [1700]

    def test_flies_the_copter(self, ready: Gcs) -> None:
        ready.put_up(5.0)
        override(ready, c3=1500)
        assert ready.command(176, 1, LOITER) == ACCEPTED
        for _ in range(4):
            override(ready, c2=1400, c3=1500)
            ready.world.step(1.0)
        assert ready.vehicle.copter.sense.vn == pytest.approx(0.2 * 12.5, abs=0.4)  # LOIT_SPEED

    def test_of_the_mode_channel_changes_the_mode_and_the_pilots_switch_wins_it_back(self, ready: Gcs) -> None:
        override(ready, c5=1555)
        assert ready.vehicle.copter.mode.number == int(ready.vehicle.copter.params["FLTMODE4"])
        override(ready, c5=0)
        assert ready.vehicle.copter.mode.number == int(ready.vehicle.copter.params["FLTMODE6"])
        ready.vehicle.pilot_mode("LAND")
        ready.world.step(0.1)
        assert ready.vehicle.copter.mode.number == LAND


class TestManualControl:
    def test_moves_the_sticks(self, ready: Gcs) -> None:
        ready.send("MANUAL_CONTROL", target=1, x=500, y=-500, z=300, r=1000)
        ready.world.step(0.05)
        assert channels(ready, 1, 2, 3, 4) == [1250, 1250, 1300, 2000]

    def test_axes_that_are_left_out_are_the_pilots(self, ready: Gcs) -> None:
        ready.send("MANUAL_CONTROL", target=1, x=32767, y=1000, z=300, r=32767)
        ready.world.step(0.05)
        assert channels(ready, 1, 2, 3, 4) == [2000, 1500, 1300, 1500]

    @pytest.mark.parametrize("fields", [{"target": 7, "y": 1000}, {"target": 1, "y": 1000, "z": -1}])
    def test_for_others_or_downwards_is_ignored(self, ready: Gcs, fields: dict[str, int]) -> None:
        ready.send("MANUAL_CONTROL", **fields)
        ready.world.step(0.05)
        assert channels(ready, 1) == [1500]


class TestLoss:
    def lost(self, make_gcs: MakeGcs, **params: float) -> Gcs:
        """In the air, with the radio gone for two seconds."""
        gcs = make_gcs([VehicleSpec(params=params)])
        gcs.put_up(4.0)
        gcs.vehicle.copter.pilot.lose()
        gcs.world.step(2.0)
        return gcs

    def test_returns_after_a_second_and_can_be_had_back(self, make_gcs: MakeGcs) -> None:
        gcs = make_gcs()
        gcs.put_up(4.0)
        gcs.vehicle.copter.pilot.lose()
        gcs.world.step(0.9)
        assert gcs.vehicle.copter.mode.number == GUIDED
        gcs.world.step(0.3)  # RC_FS_TIMEOUT is 1 s
        assert gcs.vehicle.copter.mode.number == RTL
        assert "Radio Failsafe" in gcs.texts()
        assert gcs.last("HEARTBEAT")["system_status"] == 5
        assert gcs.last("RC_CHANNELS")["chan3_raw"] == 1000  # the last there was
        gcs.vehicle.copter.pilot.regain()
        gcs.world.step(0.2)
        assert "Radio Failsafe Cleared" in gcs.texts()
        assert gcs.vehicle.copter.mode.number == RTL  # until the pilot turns the switch
        gcs.vehicle.pilot_mode("LOITER")
        gcs.world.step(0.1)
        assert gcs.vehicle.copter.mode.number == LOITER

    @pytest.mark.parametrize(("action", "mode"), [(0, GUIDED), (1, RTL), (3, LAND), (4, RTL), (5, LAND), (7, 17)])
    def test_does_what_fs_thr_enable_says(self, make_gcs: MakeGcs, action: int, mode: int) -> None:
        gcs = self.lost(make_gcs, FS_THR_ENABLE=action)
        assert gcs.vehicle.copter.mode.number == mode

    def test_may_leave_guided_alone(self, make_gcs: MakeGcs) -> None:
        gcs = self.lost(make_gcs, FS_OPTIONS=4)
        assert gcs.vehicle.copter.mode.number == GUIDED
        assert "Radio Failsafe - Continuing Guided Mode" in gcs.texts()

    def test_is_kept_off_by_overrides(self, make_gcs: MakeGcs) -> None:
        gcs = make_gcs()
        gcs.put_up(4.0)
        gcs.vehicle.copter.pilot.lose()
        for _ in range(6):
            override(gcs, c3=1500)
            gcs.world.step(0.5)
        assert gcs.vehicle.copter.mode.number == GUIDED

    def test_on_the_ground_disarms_and_keeps_it_from_arming(self, ready: Gcs) -> None:
        assert ready.command(176, 1, GUIDED) == ACCEPTED
        assert ready.command(400, 1) == ACCEPTED
        ready.vehicle.copter.pilot.lose()
        ready.world.step(1.5)
        assert not ready.vehicle.copter.armed
        assert "Radio Failsafe - Disarming" in ready.texts()
        assert ready.command(400, 1) == FAILED
        assert ready.texts()[-1] == "Arm: Radio failsafe on"
        assert ready.command(176, 1, STABILIZE) == FAILED
        assert ready.texts()[-1] == "Mode change to STABILIZE failed: in RC failsafe"

    def test_low_throttle_counts_as_loss(self, make_gcs: MakeGcs) -> None:
        gcs = make_gcs()
        gcs.put_up(4.0)
        gcs.vehicle.copter.pilot.pwm[2] = 960  # FS_THR_VALUE is 975
        gcs.world.step(0.2)
        assert gcs.vehicle.copter.mode.number == RTL
        gcs.vehicle.copter.pilot.sticks(throttle=0.0)
        gcs.world.step(0.2)
        assert "Radio Failsafe Cleared" in gcs.texts()


class TestArming:
    @pytest.mark.parametrize(
        ("stick", "name"), [("roll", "Roll (RC1)"), ("pitch", "Pitch (RC2)"), ("yaw", "Yaw (RC4)")]
    )
    def test_needs_sticks_in_the_middle(self, ready: Gcs, stick: str, name: str) -> None:
        ready.vehicle.copter.pilot.sticks(**{stick: 0.3})
        ready.world.step(0.1)
        assert ready.command(400, 1) == FAILED
        assert ready.texts()[-1] == f"Arm: {name} is not neutral"
