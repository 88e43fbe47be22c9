"""The gate before the flight: each planted difference is said, and only without any may it fly."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import pytest

import zmav
from agents.hil import gate as gates
from agents.hil.beside import begun, beside
from agents.hil.checkflight import CheckFlight
from agents.hil.gate import ask_doctor, gate, judge_identity, judge_params, judge_real, judge_report
from agents.hil.report import Check, Identity, Report, Stage, find, keep
from tests.agents.hil.conftest import FLEET, MakeBoard
from zmav.children import Children
from zmav.config import load_fleet
from zmav.errors import BadConfig

if TYPE_CHECKING:
    from tests.conftest import Net

WHO = Identity("px4", "copter", "1.16.1", "ab12", 1)
WHERE = Path("hil/px1-sil.json")


@pytest.fixture
def report(fleet: Path) -> Report:
    """A green one."""
    found = begun("sil", load_fleet(fleet), "px1", "the embedded simulator")
    found.identity, found.passed, found.params = WHO, True, {"MPC_XY_VEL_MAX": 12.0, "SYS_HITL": 1}
    found.checks = [Check("arm", "ok", "after 0.4 s")]
    return found


def judged(report: Report | None, **changed: object) -> Check:
    now, fleet_hash = time.time(), report.fleet_hash if report else ""
    if report is not None:
        report = msgspec.structs.replace(report, **changed)
    return judge_report(report, "sil", fleet_hash, now, WHERE)


def test_a_green_report_of_this_file_will_do(report: Report) -> None:
    check = judged(report)
    assert check.status == "ok" and "with this fleet file" in check.found
    left = judged(report, checks=[Check("fence", "left out", "none")])
    assert left.status == "ok" and "left out: fence" in left.found


def test_every_other_report_is_told_apart(report: Report) -> None:
    assert "no report hil/px1-sil.json: run 'zmav hil sil'" in judged(None).found
    bad = [Check("arm", "ok", ""), Check("square", "BAD", "")]
    for changed, words in (
        ({"passed": False, "checks": bad}, "it did not pass (square)"),
        ({"fleet_hash": "another"}, "it flew with another of the fleet file"),
        ({"zmav": "0.0.1"}, "it flew with zmav 0.0.1"),
        ({"t": time.time() - 31 * 86_400}, "31.0 days old"),
        ({"t": time.time() + 86_400}, "-1.0 days old"),  # somebody's clock
    ):
        check = judged(report, **changed)
        assert check.status == "BAD" and words in check.found, check


def test_another_autopilot_is_said(report: Report) -> None:
    flown: dict[Stage, Report | None] = {"sil": report, "bench": report}
    assert [check.status for check in judge_identity(flown, WHO)] == ["ok"]
    for what, value in (("uid", "cd34"), ("firmware", "1.15.0"), ("sysid", 2)):
        other = msgspec.structs.replace(WHO, **{what: value})
        (check,) = judge_identity(flown, other)
        assert (check.name, check.status) == (what, "BAD") and str(value) in check.found
    (kind, *_) = judge_identity(flown, msgspec.structs.replace(WHO, kind="plane"))
    assert (kind.name, kind.status) == ("kind", "BAD")


def test_simulation_has_to_be_off() -> None:
    assert judge_real("px4", {"SYS_HITL": 0, "SIM_BAT_MIN_PCT": 50.0}, "").status == "ok"
    assert judge_real("ardupilot", {"RTL_ALT": 1500}, "").status == "ok"
    for autopilot, params, base_mode, words in (
        ("px4", {"SYS_HITL": 1}, "", "SYS_HITL is 1"),
        ("px4", {"SYS_HITL": 0}, "MAV_MODE_FLAG_HIL_ENABLED", "says that it is in HIL"),
        ("ardupilot", {"SIM_SPEEDUP": 1}, "", "simulates on board"),
    ):
        check = judge_real(autopilot, params, base_mode)
        assert check.status == "BAD" and words in check.found


def test_parameters_that_differ_are_named_unless_they_are_the_sensors() -> None:
    flown = {"RTL_ALT": 1500, "WPNAV_SPEED": 500.0, "SIM_SPEEDUP": 1, "INS_ACCOFFS_X": 0.0, "STAT_BOOTCNT": 3}
    now = {"RTL_ALT": 3000, "WPNAV_SPEED": 500.0, "INS_ACCOFFS_X": 0.12, "STAT_BOOTCNT": 9, "FS_THR_ENABLE": 0}
    found = judge_params("ardupilot", flown, now, ())
    assert [(check.name, check.status, check.found) for check in found] == [
        ("parameter FS_THR_ENABLE", "BAD", "not there on the bench, 0 now"),
        ("parameter RTL_ALT", "BAD", "1500 on the bench, 3000 now"),
        ("parameters not compared", "ok", "3 of simulation, sensors and counters differ"),
    ]
    accepted = judge_params("ardupilot", flown, now, ("RTL_*", "FS_THR_ENABLE"))
    assert {check.status for check in accepted} == {"ok"}
    many = judge_params("ardupilot", {f"P{i}": 0 for i in range(100)}, {f"P{i}": 1 for i in range(100)}, ())
    assert len(many) == gates.MOST_TOLD + 1 and many[-1].found.startswith("60 more differ")


def test_however_many_parameters_may_be_accepted_and_what_is_not_is_named_first() -> None:
    flown, now = {f"P{i}": 0 for i in range(100)}, {f"P{i}": 1 for i in range(100)}
    accepted = judge_params("ardupilot", flown, now, ("P*",))
    assert {check.status for check in accepted} == {"ok"} and accepted[-1].found.startswith("60 more differ")
    found = judge_params("ardupilot", {**flown, "Z": 0}, {**now, "Z": 1}, ("P*",))
    assert [check.name for check in found if check.status == "BAD"] == ["parameter Z"]


def test_a_file_that_is_no_report_is_said(report: Report, tmp_path: Path) -> None:
    path = keep(report, tmp_path)
    assert find(tmp_path, "px1", "sil") == report
    path.write_text("{}", encoding="utf-8")
    with pytest.raises(BadConfig, match="is no report"):
        find(tmp_path, "px1", "sil")


async def test_a_doctor_that_says_nothing_lets_nothing_fly(net: Net, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gates, "examine", lambda seen: iter(()))
    _, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as z:
        (check,) = await ask_doctor(z, 0.2)
    assert check.status == "BAD" and "nothing to look at" in check.found


async def test_a_real_autopilot_before_its_flight(
    fleet: Path,
    tmp_path: Path,
    make_board: MakeBoard,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """... with reports of itself; then with another fleet file, a changed parameter, and no report of the bench."""
    board, file = make_board(hitl=0), load_fleet(fleet)
    device = str(board.link)
    reports = [begun(stage, file, "px1", device) for stage in ("sil", "bench")]
    with Children() as children:
        async with beside(children, fleet, file, "px1", device) as (client, router):
            flight = CheckFlight(client, file, "px1", router, children, reports[0], lambda check: None)
            await flight.meet()
    for each in reports:
        each.identity, each.params, each.passed = reports[0].identity, {**reports[0].params, "SYS_HITL": 1}, True
        keep(each, tmp_path)
    assert await gate(fleet, "px1", tmp_path, device, ()) == 0
    said = capsys.readouterr().out
    assert f"zmav up --file {fleet} --name px1 --link {device}" in said
    assert "ok       doctor:" in said and "BAD" not in said
    assert not board.world.status().vehicles[0].armed

    fleet.write_text(FLEET.replace("speed = 8.0", "speed = 20.0"), encoding="utf-8")
    assert reports[1].params.pop("MPC_XY_VEL_MAX") is not None
    keep(reports[1], tmp_path)
    (tmp_path / "px1-sil.json").unlink()
    assert await gate(fleet, "px1", tmp_path, device, ()) == 1
    said = capsys.readouterr().out
    for words in (
        "no report",
        "BAD      bench: it flew with",
        "BAD      parameter MPC_XY_VEL_MAX",
        "NOT TO BE FLOWN: 3",
    ):
        assert words in said
    assert "zmav up" not in said
