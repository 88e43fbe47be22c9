"""SIL: the fleet file's vehicle in the simulator, by 'zmav up' and the same check flight as on the bench."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from agents.hil.cli import hil
from agents.hil.flight import HOVERS, kind_of
from agents.hil.report import find, hash_of
from agents.hil.sil import sil
from tests.agents.hil.conftest import FLEET
from zmav.config import load_fleet
from zmav.errors import BadConfig, Unsupported

SWITCH = "[vehicles.quad1.pilot_switch]\nchannel = 7\n"


@pytest.mark.slow
async def test_a_copter_flies_every_check(fleet: Path, tmp_path: Path) -> None:
    """... within a fence that makes the square smaller; the report says what was flown, and of which file."""
    assert await sil(fleet, "quad1", tmp_path) == 0
    report = find(tmp_path, "quad1", "sil")
    assert report is not None and report.passed and report.identity is not None
    assert {check.name for check in report.checks} == {"autopilot", "parameters", *HOVERS, "link"}
    assert {check.status for check in report.checks} == {"ok"}
    found = {check.name: check.found for check in report.checks}
    assert "6 m sides" in found["square"]
    assert "the switch (channel 7 at 1950 µs) took it" in found["pilot"]
    assert report.fleet_hash == hash_of(load_fleet(fleet), "quad1")
    assert (report.identity.autopilot, report.identity.kind) == ("ardupilot", "copter")
    assert len(report.params) > 1000


async def test_a_fence_that_leaves_no_room_is_said_and_nothing_is_armed(fleet: Path, tmp_path: Path) -> None:
    fleet.write_text(FLEET.replace("radius = 8.0", "radius = 3.0"), encoding="utf-8")
    assert await sil(fleet, "quad1", tmp_path) == 1
    report = find(tmp_path, "quad1", "sil")
    assert report is not None and not report.passed
    last = report.checks[-1]
    assert (last.name, last.status) == ("ready", "BAD")
    assert "the geofence leaves no room for a square of 4 m" in last.found


async def test_what_cannot_be_simulated_is_said(fleet: Path, tmp_path: Path) -> None:
    with pytest.raises(BadConfig, match="no vehicle 'quad2'"):
        await sil(fleet, "quad2", tmp_path)
    assert await sil(fleet, "px1", tmp_path, ardupilot="/nowhere") == 1
    report = find(tmp_path, "px1", "sil")
    assert report is not None and "expected a vehicle of that autopilot" in report.checks[-1].found
    with pytest.raises(Unsupported, match="no check flight for a sub by ardupilot"):
        kind_of("ardupilot", "sub")


async def test_a_program_that_is_not_there_ends_the_stage_with_its_words(fleet: Path, tmp_path: Path) -> None:
    assert await sil(fleet, "quad1", tmp_path, ardupilot=str(tmp_path / "none")) == 1
    report = find(tmp_path, "quad1", "sil")
    assert report is not None
    assert "simulator ended with 1" in report.checks[-1].found and "no arducopter" in report.checks[-1].found


def test_the_hash_is_of_how_it_flies_and_not_of_where_it_is_found(fleet: Path) -> None:
    file = load_fleet(fleet)
    for same in (
        FLEET.replace('link = "/dev/ttyACM0"\nsysid', 'link = "/dev/ttyUSB0,57600"\nsysid'),
        FLEET.replace("[vehicles.quad1.sim]", '[vehicles.quad1.sim]\nairframe = "hexa"'),
        FLEET + "\n[mesh]\nlease = 2.0\n",
        FLEET.replace("[vehicles.px1.sim]", "[vehicles.px1.limits]\nspeed = 1.0\n[vehicles.px1.sim]"),
    ):
        fleet.write_text(same, encoding="utf-8")
        assert hash_of(load_fleet(fleet), "quad1") == hash_of(file, "quad1"), same
    for other in (
        FLEET.replace("radius = 8.0", "radius = 9.0"),
        FLEET.replace("speed = 8.0", "speed = 9.0"),
        FLEET.replace("alt_amsl = 488.0", "alt_amsl = 480.0"),
        FLEET.replace("channel = 7", "channel = 8"),
        FLEET.replace("sysid = 1", "sysid = 2"),
        FLEET + "\n[failsafe]\nhold_after = 0.4\n",
    ):
        fleet.write_text(other, encoding="utf-8")
        assert hash_of(load_fleet(fleet), "quad1") != hash_of(file, "quad1"), other


def test_the_stages_say_what_they_need() -> None:
    run = CliRunner().invoke
    assert "TAKE THE PROPELLERS OFF" in run(hil, ["bench", "--file", "f", "--name", "n"]).output
    assert run(hil, ["bench", "--file", "f", "--name", "n"]).exit_code == 2
    both = run(hil, ["sil", "--file", "f", "--name", "n", "--ardupilot", "a", "--px4", "p"])
    assert both.exit_code == 2 and "not both" in both.output
