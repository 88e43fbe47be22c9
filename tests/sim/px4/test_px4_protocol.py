"""Messages, parameters, events and links of the simulated PX4."""

from __future__ import annotations

import math
import re
import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import zmav.sim.autopilots.px4 as package
from tests.sim.px4.conftest import Companion
from zmav.errors import BadConfig, BadInput
from zmav.mavlink.event import read_event
from zmav.sim import VehicleSpec, World
from zmav.sim.protocol.params import defaults

if TYPE_CHECKING:
    from tests.sim.px4.conftest import MakeCompanion

INT32, REAL32, UINT32 = 6, 9, 5


def as_int(number: float) -> int:
    return int(struct.unpack("<i", struct.pack("<f", number))[0])


def as_float(number: int) -> float:
    return float(struct.unpack("<f", struct.pack("<i", number))[0])


class TestParameters:
    def value(self, companion: Companion, name: str) -> dict[str, Any]:
        companion.clear()
        companion.send("PARAM_REQUEST_READ", param_id=name, param_index=-1)
        return companion.all("PARAM_VALUE")[0]

    def test_integers_travel_bytewise_and_floats_as_they_are(self, companion: Companion) -> None:
        whole = self.value(companion, "SYS_AUTOSTART")
        assert (as_int(whole["param_value"]), whole["param_type"]) == (10040, INT32)
        real = self.value(companion, "COM_OF_LOSS_T")
        assert (real["param_value"], real["param_type"]) == (1.0, REAL32)
        assert as_int(self.value(companion, "COM_FLTMODE1")["param_value"]) == -1

    def test_a_download_begins_with_the_hash_and_has_everything_once(self, companion: Companion) -> None:
        companion.send("PARAM_REQUEST_LIST")
        companion.world.step(1.0)
        first, *rest = companion.all("PARAM_VALUE")
        assert (first["param_id"], first["param_type"]) == ("_HASH_CHECK", UINT32)
        table = defaults("px4")
        assert [(m["param_id"], m["param_index"], m["param_type"]) for m in rest] == [
            (name, index, kind) for index, (name, _, kind) in enumerate(table)
        ]
        assert {m["param_count"] for m in (first, *rest)} == {len(table)}
        assert [name for name, _, _ in table] == sorted(name for name, _, _ in table)

    def test_the_hash_answered_ends_a_download(self, companion: Companion) -> None:
        before = self.value(companion, "_HASH_CHECK")
        companion.clear()
        companion.send("PARAM_REQUEST_LIST")
        companion.send("PARAM_SET", param_id="_HASH_CHECK", param_value=before["param_value"], param_type=UINT32)
        companion.world.step(0.5)
        assert [m["param_id"] for m in companion.all("PARAM_VALUE")] == ["_HASH_CHECK"]

    def test_setting_changes_the_value_and_the_hash(self, companion: Companion) -> None:
        before = self.value(companion, "_HASH_CHECK")["param_value"]
        companion.send("PARAM_SET", param_id="COM_OBL_RC_ACT", param_value=as_float(4), param_type=INT32)
        companion.send("PARAM_SET", param_id="MIS_TAKEOFF_ALT", param_value=3.5, param_type=REAL32)
        values = {m["param_id"]: m for m in companion.all("PARAM_VALUE")}
        assert as_int(values["COM_OBL_RC_ACT"]["param_value"]) == 4
        assert values["MIS_TAKEOFF_ALT"]["param_value"] == 3.5
        assert values["MIS_TAKEOFF_ALT"]["param_index"] == companion.vehicle.px4.params.index["MIS_TAKEOFF_ALT"]
        assert companion.vehicle.px4.params["COM_OBL_RC_ACT"] == 4.0
        assert self.value(companion, "_HASH_CHECK")["param_value"] != before

    def test_another_type_or_an_unknown_name_is_refused_in_words(self, companion: Companion) -> None:
        companion.beat()
        companion.send("PARAM_SET", param_id="COM_OBL_RC_ACT", param_value=4.0, param_type=REAL32)
        companion.send("PARAM_SET", param_id="NOT_THERE", param_value=4.0, param_type=REAL32)
        assert companion.all("PARAM_VALUE") == []
        assert companion.vehicle.px4.params["COM_OBL_RC_ACT"] == 0.0
        assert companion.texts() == ["param types mismatch param: COM_OBL_RC_ACT", "unknown param: NOT_THERE"]

    def test_every_parameter_that_flies_is_there(self) -> None:
        """Parameters are read by name: a wrong one would only raise in the air."""
        names = {name for name, _, _ in defaults("px4")}
        used = set()
        for file in Path(next(iter(package.__path__))).glob("*.py"):
            used |= set(re.findall(r'"((?:COM|MPC|MC|NAV|RTL|MIS)_[A-Z0-9_]+)"', file.read_text(encoding="utf-8")))
        assert len(used) > 30
        assert used <= names


class TestMessages:
    def test_who_it_is(self, companion: Companion) -> None:
        assert companion.command(512, 148) == [0]
        version = companion.all("AUTOPILOT_VERSION")[0]
        assert version["flight_sw_version"] == 0x011001FF
        assert version["capabilities"] == 59647
        assert version["uid"] == companion.vehicle.uid != 0

    def test_rates_can_be_asked_for_and_given_back(self, companion: Companion) -> None:
        assert companion.command(511, 30, 100_000) == [0]
        assert companion.command(510, 30) == [0]
        assert companion.all("MESSAGE_INTERVAL")[-1]["interval_us"] == 100_000
        companion.clear()
        companion.world.step(2.0)
        assert len(companion.all("ATTITUDE")) == pytest.approx(20, abs=1)
        companion.command(511, 30, -1)
        companion.clear()
        companion.world.step(1.0)
        assert companion.all("ATTITUDE") == []
        companion.command(511, 30, 0)
        companion.world.step(1.0)
        assert len(companion.all("ATTITUDE")) == pytest.approx(100, abs=2)

    def test_what_it_has_not_is_refused(self, companion: Companion) -> None:
        assert companion.command(511, 241000, 1000) == [4]
        assert companion.command(512, 241000) == [2]
        assert companion.command(512, math.nan) == [2]

    def test_an_event_reads_as_the_services_read_it(self, companion: Companion) -> None:
        companion.arm()
        msgid = companion.dialect.message("EVENT").id
        frame = next(frame for _, frame in companion.heard if frame.msgid == msgid)
        event = read_event(frame)
        assert event is not None and event.for_people
        assert (event.id, event.level, event.log_level, event.sequence) == (0x0102089D, 2, 6, 1)

    def test_the_clock_is_its_own(self, companion: Companion) -> None:
        companion.world.step(2.0)
        companion.clear()
        companion.send("TIMESYNC", tc1=0, ts1=77)
        assert companion.all("TIMESYNC") == [{"tc1": 2_000_000_000, "ts1": 77}]

    def test_a_reboot_of_a_board_starts_again(self, companion: Companion) -> None:
        board = Companion(companion.world, companion.vehicle, "pty")
        companion.ready()
        companion.command(511, 30, -1)
        assert board.command(246, 1) == [0]
        companion.world.step(0.5)
        assert companion.vehicle.px4.uptime < 0.4
        assert len(companion.all("ATTITUDE")) > 10


class TestLinks:
    def test_heartbeats_of_a_companion_reappear_on_the_other_link(self, companion: Companion) -> None:
        ground = Companion(companion.world, companion.vehicle, "ground", sysid=255)
        companion.beat(18)
        assert [(f.sysid, f.compid) for _, f in ground.heard if f.msgid == 0] == [(240, 191)]

    def test_the_ground_link_has_rates_of_its_own(self, companion: Companion) -> None:
        ground = Companion(companion.world, companion.vehicle, "ground", sysid=255)
        companion.world.step(4.0)
        assert len(ground.heard) / 4.0 == pytest.approx(362, rel=0.06)
        assert ground.all("HIGHRES_IMU") == []


class TestSpecs:
    def test_px4s_come_after_the_copters(self) -> None:
        with pytest.raises(BadConfig, match="autopilot"):
            World([VehicleSpec(autopilot="ardu", endpoints=())])
        world = World(copters=2, px4=2, endpoint=())
        try:
            assert [v.sysid for v in world.vehicles] == [1, 2, 3, 4]
            assert [v.status().mode for v in world.vehicles] == ["STABILIZE", "STABILIZE", "HOLD", "HOLD"]
            with pytest.raises(BadInput, match="PX4"):
                _ = world.vehicles[2].copter
            with pytest.raises(BadInput, match="ArduCopter"):
                _ = world.vehicles[0].px4
        finally:
            world.close()


class TestOthers:
    """What ground stations ask for besides."""

    def test_the_modes_there_are(self, companion: Companion) -> None:
        assert companion.command(512, 435, 0) == [0]
        modes = companion.all("AVAILABLE_MODES")
        assert [m["mode_index"] for m in modes] == list(range(1, len(modes) + 1))
        assert {m["number_modes"] for m in modes} == {len(modes)}
        names = {m["mode_name"]: m["custom_mode"] for m in modes}
        assert names["Hold"] == 4 << 16 | 3 << 24 and names["Offboard"] == 6 << 16
        companion.clear()
        assert companion.command(512, 435, 3) == [0]
        assert [m["mode_index"] for m in companion.all("AVAILABLE_MODES")] == [3]
        assert companion.command(512, 435, 99) == [2]

    @pytest.mark.parametrize("message", [259, 280, 395, 397, 16384])
    def test_what_it_has_not_is_denied(self, companion: Companion, message: int) -> None:
        """A camera, a gimbal, descriptions of components, a number that means nothing."""
        assert companion.command(512, message) == [2]

    def test_a_system_id_that_is_no_number_is_answered(self, make_companion: MakeCompanion) -> None:
        companion = make_companion(params={"MNT_MODE_IN": 4.0})
        assert companion.command(1001, math.nan, 0.0) == [2]

    def test_it_does_not_speak_for_components_that_are_not_there(self, companion: Companion) -> None:
        companion.send("COMMAND_LONG", target_component=100, command=521)
        companion.send("COMMAND_LONG", target_component=100, command=512, param1=259)
        companion.send("PARAM_REQUEST_READ", target_component=100, param_id="COM_DL_LOSS_T", param_index=-1)
        companion.world.step(0.2)
        assert not companion.all("COMMAND_ACK") and not companion.all("PARAM_VALUE")
