"""What the simulated autopilot does with MAVLink: intervals, streams, parameters, commands, missions, routing."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest

from zmav.errors import BadConfig
from zmav.mavlink import load_dialect
from zmav.mavlink.codec import Packer
from zmav.sim import VehicleSpec
from zmav.sim.protocol.ardupilot.copter import CopterNode
from zmav.sim.protocol.ardupilot.reports import REPORTS
from zmav.sim.protocol.params import defaults

if TYPE_CHECKING:
    from tests.sim.conftest import Gcs, MakeGcs

ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
SET_INTERVAL, REQUEST, GET_INTERVAL = 511, 512, 510
ATTITUDE, LOCAL, GLOBAL, ODOMETRY, VERSION = 30, 32, 33, 331, 148

AnotherGcs = Callable[..., "Gcs"]


def test_unasked_it_sends_heartbeats_at_1_hz_and_little_else(gcs: Gcs) -> None:
    gcs.world.step(1.0)
    gcs.clear()
    gcs.world.step(30.0)
    names = [gcs.dialect.name_of(frame.msgid) for frame in gcs.frames]
    assert names.count("HEARTBEAT") == 30
    assert set(names) == {"HEARTBEAT", "TIMESYNC"}
    assert sum(len(frame.data) for frame in gcs.frames) / 30 < 60.0


class TestIntervals:
    @pytest.mark.parametrize("hz", [1.0, 4.0, 10.0, 30.0, 50.0, 100.0])
    def test_hold_their_rate_in_simulated_time(self, gcs: Gcs, hz: float) -> None:
        gcs.world.step(1.0)
        assert gcs.command(SET_INTERVAL, ATTITUDE, 1e6 / hz) == ACCEPTED
        gcs.world.step(0.5)
        gcs.clear()
        gcs.world.step(6.0)
        stamps = [m["time_boot_ms"] for m in gcs.all("ATTITUDE")]
        # ArduPilot keeps whole milliseconds.
        expected = 1000.0 / math.floor(1000.0 / hz)
        assert len(stamps) == pytest.approx(6.0 * expected, abs=1)
        gaps = [b - a for a, b in itertools.pairwise(stamps)]
        assert max(gaps) - min(gaps) <= 10  # the world's tick

    def test_can_be_stopped_and_asked_for(self, gcs: Gcs) -> None:
        assert gcs.command(SET_INTERVAL, ATTITUDE, 1e5) == ACCEPTED
        assert gcs.command(GET_INTERVAL, ATTITUDE) == ACCEPTED
        assert gcs.all("MESSAGE_INTERVAL") == [{"message_id": ATTITUDE, "interval_us": 100_000}]
        assert gcs.command(SET_INTERVAL, ATTITUDE, -1) == ACCEPTED
        assert gcs.command(GET_INTERVAL, ATTITUDE) == ACCEPTED
        assert gcs.all("MESSAGE_INTERVAL")[-1] == {"message_id": ATTITUDE, "interval_us": -1}
        gcs.world.step(0.2)
        gcs.clear()
        gcs.world.step(2.0)
        assert gcs.all("ATTITUDE") == []

    def test_zero_is_the_default_rate(self, gcs: Gcs) -> None:
        assert gcs.command(SET_INTERVAL, 0, 2e5) == ACCEPTED
        assert gcs.command(SET_INTERVAL, 0, 0) == ACCEPTED
        assert gcs.command(GET_INTERVAL, 0) == ACCEPTED
        assert gcs.all("MESSAGE_INTERVAL")[-1]["interval_us"] == 1_000_000

    def test_what_is_not_produced_is_denied(self, gcs: Gcs) -> None:
        assert gcs.command(SET_INTERVAL, ODOMETRY, 1e5) == DENIED
        assert gcs.command(GET_INTERVAL, ODOMETRY) == FAILED
        assert gcs.command(REQUEST, ODOMETRY) == FAILED

    def test_are_each_links_own(self, gcs: Gcs, another_gcs: AnotherGcs) -> None:
        other = another_gcs(gcs.world, gcs.vehicle)
        assert gcs.command(SET_INTERVAL, ATTITUDE, 1e5) == ACCEPTED
        gcs.world.step(2.0)
        assert len(gcs.all("ATTITUDE")) >= 19
        assert other.all("ATTITUDE") == []

    def test_local_position_flows_only_once_there_is_one(self, make_gcs: MakeGcs) -> None:
        gcs = make_gcs(ready_s=10.0)
        assert gcs.command(SET_INTERVAL, LOCAL, 1e5) == ACCEPTED
        assert gcs.command(SET_INTERVAL, GLOBAL, 1e5) == ACCEPTED
        gcs.world.step(2.0)
        assert {(m["lat"], m["lon"], m["alt"]) for m in gcs.all("GLOBAL_POSITION_INT")} == {(0, 0, 0)}
        gcs.world.step(2.0)  # by now the GPS has a place, and the filter none
        assert gcs.all("LOCAL_POSITION_NED") == []
        assert gcs.all("GLOBAL_POSITION_INT")[-1]["lat"] != 0
        gcs.world.step(7.0)
        assert len(gcs.all("LOCAL_POSITION_NED")) >= 9


def test_every_message_can_be_requested(make_gcs: MakeGcs) -> None:
    gcs = make_gcs([VehicleSpec(params={"FENCE_ENABLE": 1, "RNGFND1_TYPE": 1, "CAM1_TYPE": 1, "MNT1_TYPE": 1})])
    gcs.put_up(2.0)
    gcs.goto(1.0, 0.0, -2.0)
    gcs.world.step(0.1)
    for name in REPORTS:
        assert gcs.last(name), name
    assert gcs.splitter.counters.bad_crc == gcs.splitter.counters.lost == 0


def test_a_requested_message_comes_after_its_acknowledgement(gcs: Gcs) -> None:
    gcs.clear()
    assert gcs.command(REQUEST, VERSION) == ACCEPTED
    assert [gcs.dialect.name_of(f.msgid) for f in gcs.frames] == ["COMMAND_ACK", "AUTOPILOT_VERSION"]


def test_data_streams_as_older_clients_ask_for_them(gcs: Gcs) -> None:
    gcs.world.step(1.0)
    gcs.send("REQUEST_DATA_STREAM", req_stream_id=10, req_message_rate=5, start_stop=1)
    gcs.clear()
    gcs.world.step(4.0)
    assert len(gcs.all("ATTITUDE")) == pytest.approx(20, abs=1)
    gcs.send("REQUEST_DATA_STREAM", req_stream_id=0, req_message_rate=2, start_stop=1)
    gcs.world.step(0.5)
    gcs.clear()
    gcs.world.step(4.0)
    for name in ("ATTITUDE", "VFR_HUD", "SYS_STATUS", "GLOBAL_POSITION_INT", "RC_CHANNELS", "BATTERY_STATUS"):
        assert len(gcs.all(name)) == pytest.approx(8, abs=1), name
    gcs.send("REQUEST_DATA_STREAM", req_stream_id=0, req_message_rate=2, start_stop=0)
    gcs.clear()
    gcs.world.step(2.0)
    assert {gcs.dialect.name_of(f.msgid) for f in gcs.frames} <= {"HEARTBEAT", "TIMESYNC"}


def test_the_serial_ports_rates_are_parameters(make_gcs: MakeGcs) -> None:
    gcs = make_gcs([VehicleSpec(params={"MAV1_EXTRA1": 4})])
    gcs.world.step(3.0)
    assert len(gcs.all("ATTITUDE")) == pytest.approx(12, abs=1)


class TestParameters:
    def test_a_download_gives_them_all_within_a_second(self, gcs: Gcs) -> None:
        gcs.world.step(1.0)
        gcs.send("PARAM_REQUEST_LIST")
        gcs.world.step(0.95)
        values = gcs.all("PARAM_VALUE")
        table = defaults("arducopter")
        assert len(values) == len(table) == 1354
        assert [v["param_index"] for v in values] == list(range(1354))
        assert {v["param_count"] for v in values} == {1354}
        assert [(v["param_id"], v["param_type"]) for v in values] == [(name, kind) for name, _, kind in table]
        assert [v["param_value"] for v in values] == pytest.approx([value for _, value, _ in table], rel=1e-6)

    def test_read_by_name_and_by_index(self, gcs: Gcs) -> None:
        gcs.send("PARAM_REQUEST_READ", param_id="GUID_TIMEOUT", param_index=-1)
        gcs.send("PARAM_REQUEST_READ", param_id="", param_index=3)
        first, second = gcs.all("PARAM_VALUE")
        assert (first["param_id"], first["param_value"], first["param_index"]) == ("GUID_TIMEOUT", 3.0, 65535)
        assert (second["param_id"], second["param_index"]) == ("PILOT_THR_BHV", 3)

    @pytest.mark.parametrize(("name", "index"), [("NO_SUCH", -1), ("", 5000), ("", -2)])
    def test_what_does_not_exist_stays_unanswered(self, gcs: Gcs, name: str, index: int) -> None:
        gcs.send("PARAM_REQUEST_READ", param_id=name, param_index=index)
        gcs.send("PARAM_SET", param_id="NO_SUCH", param_value=1.0, param_type=9)
        assert gcs.all("PARAM_VALUE") == []

    def test_setting_is_told_to_every_link(self, gcs: Gcs, another_gcs: AnotherGcs) -> None:
        other = another_gcs(gcs.world, gcs.vehicle)
        gcs.send("PARAM_SET", param_id="WPNAV_SPEED", param_value=512.5, param_type=9)
        for each in (gcs, other):
            assert [v["param_value"] for v in each.all("PARAM_VALUE")] == [512.5]
        assert gcs.vehicle.copter.params["WPNAV_SPEED"] == 512.5

    def test_integers_are_kept_as_integers_of_their_size(self, gcs: Gcs) -> None:
        for given, kept in ((2.6, 3.0), (300.0, 127.0), (-300.0, -128.0)):
            gcs.send("PARAM_SET", param_id="WP_YAW_BEHAVIOR", param_value=given, param_type=2)
            assert gcs.all("PARAM_VALUE")[-1]["param_value"] == kept

    @pytest.mark.parametrize("value", [math.nan, math.inf])
    def test_what_is_no_number_is_ignored(self, gcs: Gcs, value: float) -> None:
        gcs.send("PARAM_SET", param_id="WPNAV_SPEED", param_value=value, param_type=9)
        assert gcs.all("PARAM_VALUE") == []
        assert gcs.vehicle.copter.params["WPNAV_SPEED"] == 1000.0

    def test_each_vehicle_has_its_own(self, make_gcs: MakeGcs) -> None:
        gcs = make_gcs(2)
        gcs.send("PARAM_SET", param_id="RTL_ALT", param_value=900.0, param_type=6)
        assert [v.copter.params["RTL_ALT"] for v in gcs.world.vehicles] == [900.0, 1500.0]

    def test_a_preset_that_does_not_exist_is_named(self, make_gcs: MakeGcs) -> None:
        with pytest.raises(BadConfig, match="NO_SUCH"):
            make_gcs([VehicleSpec(params={"NO_SUCH": 1.0})])

    def test_a_system_id_there_cannot_be_is_not_spoken_with(self, gcs: Gcs) -> None:
        for value in (0.0, 999.0):
            gcs.send("PARAM_SET", target_system=0, param_id="MAV_SYSID", param_value=value, param_type=4)
            assert gcs.frames[-1].sysid == (1 if value == 0.0 else 255)

    def test_the_system_id_is_one_and_is_spoken_with_at_once(self, gcs: Gcs) -> None:
        gcs.send("PARAM_SET", param_id="MAV_SYSID", param_value=42.0, param_type=4)
        assert gcs.frames[-1].sysid == 42
        gcs.clear()
        gcs.send("PARAM_REQUEST_READ", target_system=1, param_id="RTL_ALT", param_index=-1)
        assert gcs.frames == []
        gcs.send("PARAM_REQUEST_READ", target_system=42, param_id="RTL_ALT", param_index=-1)
        assert len(gcs.frames) == 1


class TestCommands:
    @pytest.mark.parametrize("number", [31, 999, 31000])
    def test_unknown_ones_are_unsupported(self, gcs: Gcs, number: int) -> None:
        assert gcs.command(number, 1, 2, 3) == UNSUPPORTED
        assert gcs.command_int(number) == UNSUPPORTED

    def test_both_forms_mean_the_same(self, gcs: Gcs) -> None:
        gcs.world.step(1.0)
        assert gcs.command_int(176, param1=1, param2=4) == ACCEPTED
        assert gcs.command_int(400, param1=1) == ACCEPTED
        assert gcs.command_int(22, z=5.0, frame=6) == DENIED  # frame 3 it must be
        assert gcs.command_int(22, z=5.0) == ACCEPTED
        assert gcs.vehicle.copter.armed

    @pytest.mark.parametrize("number", [176, 400, 511, 512, 178, 185, 246])
    def test_parameters_that_are_no_numbers_are_denied(self, gcs: Gcs, number: int) -> None:
        assert gcs.command(number, math.nan, math.nan) == DENIED

    @pytest.mark.parametrize("number", sorted(CopterNode.HANDLERS))
    def test_no_parameters_upset_it(self, gcs: Gcs, number: int) -> None:
        """Whatever the numbers are there is one answer, and the vehicle goes on."""
        odd = [0.0, -1.0, 1e38, -1e38, math.nan, math.inf, 2.5]
        pick = random.Random(number)
        gcs.world.step(1.0)
        for _ in range(60):
            assert gcs.command(number, *[pick.choice(odd) for _ in range(7)]) in range(9)
            whole = [pick.choice([0, 2**31 - 1, -(2**31)]) for _ in range(2)]
            p = {f"param{i}": pick.choice(odd) for i in range(1, 5)}
            assert gcs.command_int(
                number, x=whole[0], y=whole[1], z=pick.choice(odd), frame=pick.randrange(256), **p
            ) in range(9)
        gcs.world.step(0.5)
        assert gcs.splitter.counters.bad_crc == 0

    def test_home_can_be_asked_for_and_moved(self, gcs: Gcs) -> None:
        gcs.world.step(1.0)
        assert gcs.command(410) == ACCEPTED
        home = gcs.all("HOME_POSITION")[-1]
        assert (home["latitude"], home["longitude"], home["altitude"]) == (-353632610, 1491652300, 584090)
        assert all(math.isnan(c) for c in home["q"])
        assert gcs.command_int(179, x=-353632000, y=1491652000, z=590.0, frame=0) == ACCEPTED
        assert gcs.last("HOME_POSITION")["latitude"] == pytest.approx(-353632000, abs=1)
        assert gcs.last("HOME_POSITION")["x"] == pytest.approx(610e-7 * 111318.845, abs=0.05)
        assert gcs.last("GPS_GLOBAL_ORIGIN")["latitude"] == -353632610
        assert gcs.command(179, 1) == ACCEPTED
        assert gcs.last("HOME_POSITION")["latitude"] == -353632610

    def test_the_banner_and_the_prearm_checks(self, gcs: Gcs) -> None:
        gcs.world.step(0.05)
        assert gcs.command(42428) == ACCEPTED
        assert gcs.texts()[-3].startswith("ArduCopter V4.7.0-dev")
        assert gcs.texts()[-1] == "Frame: QUAD/PLUS"
        gcs.clear()
        gcs.world.step(0.2)
        assert gcs.command(401) == ACCEPTED
        assert [t for t in gcs.texts() if t.startswith("PreArm: ")]


def test_times_are_synchronised_both_ways(gcs: Gcs) -> None:
    gcs.world.step(2.0)
    gcs.clear("TIMESYNC")
    gcs.send("TIMESYNC", tc1=0, ts1=123)
    assert gcs.all("TIMESYNC")[0]["ts1"] == 123
    assert gcs.all("TIMESYNC")[0]["tc1"] == pytest.approx(2.0e9, abs=1e7)
    gcs.clear("TIMESYNC")
    gcs.send("TIMESYNC", tc1=5, ts1=5)  # an answer, not a question
    assert gcs.all("TIMESYNC") == []
    gcs.world.step(9.0)
    assert [m["tc1"] for m in gcs.all("TIMESYNC")] == [0]


def test_a_ping_comes_back(gcs: Gcs) -> None:
    gcs.send("PING", target_system=0, target_component=0, time_usec=7, seq=9)
    assert gcs.all("PING") == [{"time_usec": 7, "seq": 9, "target_system": 255, "target_component": 190}]


def test_the_uid_tells_vehicles_apart_and_stays(make_gcs: MakeGcs) -> None:
    first, again = make_gcs(3, seed=5), make_gcs(3, seed=5)
    uids = [v.uid for v in first.world.vehicles]
    assert len(set(uids)) == 3
    assert all(uids)
    assert uids == [v.uid for v in again.world.vehicles]
    version = first.last("AUTOPILOT_VERSION")
    assert version["uid"] == uids[0]
    assert bytes(version["uid2"][:8]) == uids[0].to_bytes(8, "little")
    clash = make_gcs([VehicleSpec(sysid=9, uid=77), VehicleSpec(sysid=9, uid=78)])
    assert [(v.sysid, v.uid) for v in clash.world.vehicles] == [(9, 77), (9, 78)]


class TestRouting:
    def test_other_systems_and_components_are_not_obeyed(self, gcs: Gcs) -> None:
        gcs.world.step(1.0)
        gcs.clear()
        gcs.send("COMMAND_LONG", target_system=7, command=176, param1=1.0, param2=4.0)
        assert gcs.frames == []
        assert gcs.vehicle.copter.mode.number == 0
        gcs.send("COMMAND_LONG", target_system=0, target_component=0, command=176, param1=1.0, param2=4.0)
        assert gcs.vehicle.copter.mode.number == 4

    def test_links_hear_each_other_through_the_autopilot(self, gcs: Gcs, another_gcs: AnotherGcs) -> None:
        companion = another_gcs(gcs.world, gcs.vehicle, sysid=1, compid=191)
        companion.send("HEARTBEAT", type=18, autopilot=8)
        assert [(f.sysid, f.compid) for f in gcs.frames] == [(1, 191)]
        assert companion.frames == []
        gcs.clear()
        gcs.send("COMMAND_LONG", target_system=1, target_component=191, command=400, param1=1.0)
        assert gcs.frames == []  # it was for the companion alone
        assert [f.sysid for f in companion.frames] == [255]
        companion.clear()
        gcs.send("COMMAND_LONG", target_system=1, target_component=42, command=520, param1=1.0)
        assert len(gcs.all("COMMAND_ACK")) == 1  # nobody there: the autopilot answers itself

    def test_a_closed_link_is_forgotten(self, gcs: Gcs, another_gcs: AnotherGcs) -> None:
        gone = another_gcs(gcs.world, gcs.vehicle, sysid=9)
        gone.send("HEARTBEAT", type=6)
        gcs.vehicle.node.close_channel(gone.channel)
        gcs.send("PARAM_REQUEST_READ", target_system=9, param_id="RTL_ALT", param_index=-1)
        gcs.world.step(2.0)
        assert gone.frames == []


class TestRobustness:
    def test_every_link_counts_its_own_sequence(self, gcs: Gcs, another_gcs: AnotherGcs) -> None:
        other = another_gcs(gcs.world, gcs.vehicle)
        for each, hz in ((gcs, 50.0), (other, 7.0)):
            assert each.command(SET_INTERVAL, ATTITUDE, 1e6 / hz) == ACCEPTED
        gcs.world.step(12.0)
        for each in (gcs, other):
            assert each.frames[0].seq == 0
            assert each.splitter.counters.lost == 0
        assert len(gcs.frames) > 512 > len(other.frames)

    def test_a_full_link_loses_messages_and_no_sequence_numbers(self, gcs: Gcs, another_gcs: AnotherGcs) -> None:
        other = another_gcs(gcs.world, gcs.vehicle)
        assert other.command(SET_INTERVAL, ATTITUDE, 1e5) == ACCEPTED
        other.limit = 0
        gcs.world.step(2.0)
        assert other.channel.dropped > 10
        other.limit = 1 << 20
        gcs.world.step(2.0)
        assert other.splitter.counters.lost == 0
        assert len(other.all("ATTITUDE")) > 15
        assert len(gcs.all("HEARTBEAT")) == 5

    @pytest.mark.parametrize("seed", range(4))
    def test_no_parameter_upsets_the_flight(self, gcs: Gcs, seed: int) -> None:
        """Every parameter at the ends of what it can hold: the copter may fly badly, but its numbers stay numbers."""
        gcs.put_up(3.0)
        gcs.goto(30.0, 0.0, -5.0)
        rng = random.Random(seed)
        gcs.send("REQUEST_DATA_STREAM", req_stream_id=0, req_message_rate=10, start_stop=1)
        for name in gcs.vehicle.copter.params.names:
            if name != "MAV_SYSID":
                value = rng.choice([0.0, -1.0, 1e-30, 3e38, -3e38, 100.0])
                gcs.send("PARAM_SET", param_id=name, param_value=value, param_type=9)
        for mode in (5, 2, 0, 6, 17, 9, 4):
            gcs.command(176, 1, mode)
            gcs.vehicle.copter.pilot.sticks(roll=0.5, pitch=-0.5, yaw=1.0, throttle=0.8)
            gcs.world.step(0.4)
        assert all(math.isfinite(number) for number in gcs.vehicle.copter.sense)
        assert gcs.vehicle.node.bad_messages == 0

    def test_garbage_and_torn_frames_disturb_nothing(self, gcs: Gcs) -> None:
        rng = random.Random(3)
        node, channel = gcs.vehicle.node, gcs.channel
        for _ in range(300):
            node.receive(channel, rng.randbytes(rng.randrange(1, 400)))
        packer = Packer(load_dialect("ardupilotmega"), 255, 190)
        for name in ("COMMAND_LONG", "PARAM_SET", "SET_POSITION_TARGET_LOCAL_NED", "HEARTBEAT"):
            whole = packer.pack(name)
            node.receive(channel, whole[: len(whole) // 2])
            flipped = bytearray(whole)
            flipped[-1] ^= 0xFF
            node.receive(channel, bytes(flipped))
        node.receive(channel, bytes(300))
        assert channel.splitter.counters.garbage > 1000
        gcs.world.step(1.0)
        assert gcs.command(176, 1, 4) == ACCEPTED

    def test_any_well_formed_message_is_survived(self, gcs: Gcs) -> None:
        """Every message of the dialect with random payloads, from random systems."""
        rng = random.Random(4)
        gcs.world.step(1.0)
        for message in gcs.dialect.by_id.values():
            for _ in range(3):
                packer = Packer(gcs.dialect, rng.randrange(256), rng.randrange(256))
                fields: dict[str, Any] = {}
                for field in message.fields:
                    if field.name in ("target_system", "target_component"):
                        fields[field.name] = 1
                    elif not field.length:
                        fields[field.name] = rng.choice([0, 1, 2, 4, 100])
                gcs.vehicle.node.receive(gcs.channel, packer.pack(message.name, **fields))
        gcs.world.step(0.5)
        assert gcs.vehicle.node.bad_messages == 0
        gcs.clear()
        gcs.send("PING", target_system=0, target_component=0, seq=1)
        assert len(gcs.frames) == 1
