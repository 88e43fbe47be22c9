"""OFFBOARD of the simulated PX4: entry, loss, and every level of setpoint."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from tests.sim.px4.conftest import Companion, MakeCompanion

FAILSAFE = 0x01DEDBD0


class TestEntry:
    def test_disarmed_without_a_stream_it_is_accepted_and_arming_then_refused(self, companion: Companion) -> None:
        companion.ready()
        assert companion.mode(6) == [0, 0]
        assert companion.arm() == [1]
        companion.world.step(1.1)
        last = companion.all("HEARTBEAT")[-1]
        assert (last["base_mode"], last["custom_mode"], last["system_status"]) == (1, 6 << 16, 0)
        assert companion.mode(4, 3) == [0, 0]
        assert companion.arm() == [0]

    def test_disarmed_with_a_stream_it_may_be_armed(self, companion: Companion) -> None:
        companion.ready()
        companion.stream(1.0, lambda: companion.position(0.0, 0.0, -3.0))
        assert companion.mode(6) == [0, 0]
        assert companion.arm() == [0]
        say = lambda: companion.position(0.0, 0.0, -3.0)  # noqa: E731
        assert companion.until(lambda: companion.near(0.0, 0.0, -3.0, 0.3), say=say) > 4.0

    @pytest.mark.parametrize(("seconds", "verdict"), [(0.0, 1), (0.05, 0), (1.0, 0)])
    def test_in_the_air_there_must_be_a_stream(self, companion: Companion, seconds: float, verdict: int) -> None:
        companion.put_up()
        companion.stream(seconds, lambda: companion.position(0.0, 0.0, -3.0))
        assert companion.mode(6) == [0, verdict]
        assert companion.flying == ("OFFBOARD" if verdict == 0 else "HOLD")

    def test_two_a_second_are_enough_and_fewer_are_not(self, companion: Companion) -> None:
        companion.offboard(lambda: companion.position(0.0, 0.0, -4.0), 4.0)
        for _ in range(8):
            companion.position(0.0, 0.0, -4.0)
            companion.world.step(0.5)
        assert companion.flying == "OFFBOARD"
        companion.world.step(1.2)
        assert companion.flying != "OFFBOARD"

    def test_a_message_that_asks_for_nothing_is_no_sign_of_life(self, companion: Companion) -> None:
        companion.beat()
        companion.put_up()
        companion.stream(1.0, lambda: companion.position(0.0, 0.0, -3.0, type_mask=0xFFF))
        assert companion.mode(6) == [0, 1]
        assert "SET_POSITION_TARGET_LOCAL_NED invalid\t" in companion.texts()


class TestLoss:
    def test_by_default_it_sinks_in_posctl_disarms_and_shows_offboard_again(self, companion: Companion) -> None:
        def say() -> None:
            companion.position(0.0, 0.0, -5.0)

        companion.offboard(say, 5.0)
        companion.stream(2.3, say)  # so that no heartbeat comes just when the stream is missed
        companion.clear()
        stopped = companion.world.time_s
        companion.world.step(16.0)
        beats = [
            (at - stopped, m["custom_mode"] >> 16 & 0xFF, m["system_status"], bool(m["base_mode"] & 128))
            for at, m in companion.timed("HEARTBEAT")
        ]
        left = next(at for at, main, status, _ in beats if (main, status) == (3, 5))
        assert 1.0 < left <= 2.1
        assert all(main == 6 for at, main, _, _ in beats if at < left)
        done = next(at for at, main, status, armed in beats if (main, status, armed) == (6, 0, False))
        assert 11.5 < done < 14.5  # 13 s were measured, from the same height
        assert FAILSAFE in companion.events()
        assert companion.arm() == [1]
        assert companion.mode(4, 3) == [0, 0]
        assert companion.arm() == [0]

    @pytest.mark.parametrize(
        ("action", "mode"), [(0, "POSCTL"), (1, "ALTCTL"), (2, "STABILIZED"), (3, "RTL"), (4, "LAND"), (5, "HOLD")]
    )
    def test_what_happens_is_a_parameter(self, make_companion: MakeCompanion, action: int, mode: str) -> None:
        companion = make_companion(params={"COM_OBL_RC_ACT": float(action)})
        companion.offboard(lambda: companion.position(0.0, 0.0, -5.0))
        companion.world.step(1.2)
        assert companion.flying == mode
        current = companion.vehicle.node.fields("CURRENT_MODE")
        assert current is not None and current["intended_custom_mode"] == 6 << 16

    def test_so_is_how_long_it_waits(self, make_companion: MakeCompanion) -> None:
        companion = make_companion(params={"COM_OF_LOSS_T": 3.0})
        companion.offboard(lambda: companion.position(0.0, 0.0, -5.0))
        companion.world.step(2.9)
        assert companion.flying == "OFFBOARD"
        companion.world.step(0.2)
        assert companion.flying == "POSCTL"

    def test_a_stream_that_comes_back_is_followed_again(self, companion: Companion) -> None:
        companion.offboard(lambda: companion.position(0.0, 0.0, -8.0), 8.0)
        companion.world.step(2.0)
        assert companion.vehicle.px4.system_status == 5
        companion.stream(1.0, lambda: companion.position(0.0, 0.0, -8.0))
        assert companion.flying == "OFFBOARD" and companion.vehicle.px4.system_status == 4

    def test_another_mode_ends_the_failsafe(self, companion: Companion) -> None:
        companion.offboard(lambda: companion.position(0.0, 0.0, -5.0), 5.0)
        companion.world.step(1.5)
        assert companion.mode(4, 3) == [0, 0]
        companion.world.step(2.0)
        assert companion.flying == "HOLD" and companion.vehicle.px4.system_status == 4
        assert abs(companion.vehicle.px4.sense.vd) < 0.2


class TestSetpoints:
    def test_a_position_is_about_its_own_start(self, make_companion: MakeCompanion) -> None:
        companion = make_companion(start_ned_m=(100.0, 50.0, 0.0))

        def say() -> None:
            companion.position(8.0, -3.0, -5.0, yaw=1.0)

        companion.offboard(say)
        companion.until(lambda: companion.near(8.0, -3.0, -5.0, 0.3), say=say)
        companion.stream(4.0, say)
        assert companion.vehicle.px4.sense.yaw == pytest.approx(1.0, abs=0.1)

    @pytest.mark.parametrize(("frame", "up"), [(5, 590.09), (6, 6.0)])
    def test_a_global_position(self, companion: Companion, frame: int, up: float) -> None:
        place = companion.vehicle.px4.place((6.0, 6.0, 0.0))

        def say() -> None:
            companion.send(
                "SET_POSITION_TARGET_GLOBAL_INT",
                coordinate_frame=frame,
                type_mask=0x9F8,
                lat_int=round(place.lat_deg * 1e7),
                lon_int=round(place.lon_deg * 1e7),
                alt=up,
            )

        companion.offboard(say)
        companion.until(lambda: companion.near(6.0, 6.0, -6.0, 0.3), say=say)

    def test_a_velocity_by_the_compass_and_by_the_nose(self, companion: Companion) -> None:
        companion.offboard(lambda: companion.velocity(1.5, 0.0))
        companion.stream(4.0, lambda: companion.velocity(1.5, 0.0))
        # Against the air its integrator is slow: five sixths after four seconds, as recorded.
        assert companion.vehicle.px4.sense.vn == pytest.approx(5 / 6 * 1.5, abs=0.1)
        companion.stream(6.0, lambda: companion.velocity(0.0, 0.0, type_mask=0x9C7, yaw=math.pi / 2))
        companion.stream(4.0, lambda: companion.velocity(2.0, 0.0, coordinate_frame=8))
        sense = companion.vehicle.px4.sense
        assert [sense.vn, sense.ve] == pytest.approx([0.0, 1.8], abs=0.3)

    def test_each_axis_has_its_own_mask(self, companion: Companion) -> None:
        """A height held while flying along: position in z, velocity in x and y."""

        def say() -> None:
            companion.velocity(2.0, 0.0, type_mask=0xDE3, z=-6.0)

        companion.offboard(say, 5.0)
        companion.stream(6.0, say)
        assert companion.ned[2] == pytest.approx(-6.0, abs=0.3)
        assert companion.vehicle.px4.sense.vn == pytest.approx(1.7, abs=0.2)

    def test_an_acceleration_is_all_that_is_flown(self, companion: Companion) -> None:
        """Where no velocity is asked for, its integral, which leans against the air, has no say."""
        companion.offboard(lambda: companion.velocity(0.0, 2.0))
        companion.stream(10.0, lambda: companion.velocity(0.0, 2.0))
        assert companion.vehicle.px4.sense.roll > 0.1
        companion.stream(3.0, lambda: companion.velocity(0.0, 0.0, type_mask=0xC3F, afx=-1.0))
        sense = companion.vehicle.px4.sense
        assert abs(sense.roll) < 0.01 and abs(sense.ve) < 0.3  # the air has stopped it
        assert sense.vn < -0.8

    def test_an_attitude_with_thrust(self, companion: Companion) -> None:
        companion.offboard(lambda: companion.attitude(0.0, 0.0, 0.49))
        companion.stream(1.0, lambda: companion.attitude(0.0, 0.0, 0.49))
        before = companion.ned[2]
        companion.stream(2.0, lambda: companion.attitude(0.0, 0.0, 0.49))
        assert companion.ned[2] == pytest.approx(before, abs=0.5)  # about what carries it
        companion.stream(1.0, lambda: companion.attitude(0.2, 0.0, 0.5))
        assert companion.vehicle.px4.sense.roll == pytest.approx(0.2, abs=0.03)
        companion.stream(1.0, lambda: companion.attitude(0.0, -0.2, 0.5))
        assert companion.vehicle.px4.sense.pitch == pytest.approx(-0.2, abs=0.03)

    def test_body_rates_with_thrust(self, companion: Companion) -> None:
        rates: dict[str, Any] = {"type_mask": 128, "q": [1, 0, 0, 0], "thrust": 0.49}

        def say(p: float = 0.0, r: float = 0.0) -> None:
            companion.send("SET_ATTITUDE_TARGET", **rates, body_roll_rate=p, body_pitch_rate=0.0, body_yaw_rate=r)

        companion.offboard(say)
        companion.stream(2.0, lambda: say(r=0.8))
        assert companion.vehicle.px4.sense.r == pytest.approx(0.8, abs=0.1)
        companion.stream(0.5, lambda: say(p=0.5))
        sense = companion.vehicle.px4.sense
        assert sense.p == pytest.approx(0.5, abs=0.05) and sense.roll == pytest.approx(0.25, abs=0.08)
        companion.stream(1.0, say)
        assert companion.vehicle.px4.sense.roll > 0.15  # nothing levels it

    def test_numbers_that_are_none_are_not_flown(self, companion: Companion) -> None:
        companion.offboard(lambda: companion.position(0.0, 0.0, -4.0), 4.0)
        companion.stream(1.0, lambda: companion.attitude(0.0, 0.0, math.nan))
        companion.stream(2.0, lambda: companion.position(math.inf, math.nan, -1e30))
        assert companion.near(0.0, 0.0, -4.0, 1.0)
        assert all(math.isfinite(value) for value in companion.vehicle.px4.sense)


class TestTorque:
    """PX4 1.13 and older took torques: SET_ACTUATOR_CONTROL_TARGET."""

    @staticmethod
    def say(companion: Companion, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0, thrust: float = 0.5) -> None:
        controls = [roll, pitch, yaw, thrust, 0.0, 0.0, 0.0, 0.0]
        companion.send("SET_ACTUATOR_CONTROL_TARGET", group_mlx=0, controls=controls)

    def test_each_turns_about_its_axis(self, make_companion: MakeCompanion) -> None:
        companion = make_companion(firmware="1.13")
        companion.offboard(lambda: self.say(companion))
        assert companion.flying == "OFFBOARD"
        companion.stream(0.2, lambda: self.say(companion, yaw=0.1))
        assert companion.vehicle.px4.sense.r > 0.02
        companion.stream(0.1, lambda: self.say(companion, roll=0.05))
        assert companion.vehicle.px4.sense.p > 0.1
        companion.stream(0.1, lambda: self.say(companion, pitch=-0.05))
        assert companion.vehicle.px4.sense.q < -0.1
        # Nothing levels it: with no torque the rates stay.
        before = companion.vehicle.px4.sense
        companion.stream(0.1, lambda: self.say(companion))
        assert companion.vehicle.px4.sense.p == pytest.approx(before.p, abs=0.1)

    def test_the_thrust_goes_with_it(self, make_companion: MakeCompanion) -> None:
        companion = make_companion(firmware="1.13")
        companion.offboard(lambda: self.say(companion))
        companion.stream(1.0, lambda: self.say(companion, thrust=0.7))
        assert companion.vehicle.px4.sense.vd < -1.0

    def test_it_says_so(self, make_companion: MakeCompanion) -> None:
        old, new = make_companion(firmware="1.13"), make_companion()
        for companion, takes, version in ((old, True, (1, 13)), (new, False, (1, 16))):
            companion.command(512, 148)
            said = companion.all("AUTOPILOT_VERSION")[-1]
            assert bool(said["capabilities"] & 0x400) is takes
            assert (said["flight_sw_version"] >> 24, said["flight_sw_version"] >> 16 & 0xFF) == version

    def test_the_newer_does_not_listen(self, companion: Companion) -> None:
        companion.put_up()
        companion.stream(1.0, lambda: self.say(companion))
        assert companion.mode(6) == [0, 1]

    def test_other_groups_are_no_sign_of_life(self, make_companion: MakeCompanion) -> None:
        companion = make_companion(firmware="1.13")
        companion.put_up()
        other = lambda: companion.send("SET_ACTUATOR_CONTROL_TARGET", group_mlx=1, controls=[0.0] * 8)  # noqa: E731
        companion.stream(1.0, other)
        assert companion.mode(6) == [0, 1]
        companion.stream(1.0, lambda: self.say(companion, roll=math.nan))
        assert companion.mode(6) == [0, 0]
        companion.stream(0.5, lambda: self.say(companion, roll=math.nan))
        assert all(math.isfinite(value) for value in companion.vehicle.px4.sense)
