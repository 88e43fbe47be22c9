"""``zmav param``: list get set save load diff."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from zmav.cli.param import comparison
from zmav.errors import BadInput, NoSuchVehicle
from zmav.formats import paramfile
from zmav.formats.paramfile import shown
from zmav.vehicle.params import differences

if TYPE_CHECKING:
    from tests.cli.conftest import Vehicle


def test_list_by_pattern(vehicle: Vehicle) -> None:
    told = vehicle.zmav("param", "list", "quad1", "wpnav_speed*")
    assert told.out.split() == [
        "name",
        "value",
        "type",
        "WPNAV_SPEED",
        "1000",
        "REAL32",
        "WPNAV_SPEED_DN",
        "150",
        "REAL32",
        "WPNAV_SPEED_UP",
        "250",
        "REAL32",
    ]
    lines = vehicle.zmav("param", "list", "quad*", "--json").lines
    assert len(lines) == 1354
    assert {"vehicle": "quad1", "name": "RTL_ALT", "value": 1500, "type": "INT32"} in lines
    assert "no parameter matches 'NOPE*'" in str(vehicle.zmav.fails("param", "list", "quad1", "NOPE*").error)
    assert vehicle.zmav("param", "list", "quad1", "RTL_ALT", "--refresh").out.split()[-3:] == [
        "RTL_ALT",
        "1500",
        "INT32",
    ]


def test_get(vehicle: Vehicle) -> None:
    (line, other) = vehicle.zmav("param", "get", "quad1", "rtl_alt", "WPNAV_SPEED", "--json").lines
    assert (line["value"], other["value"]) == (1500, 1000.0)
    error = vehicle.zmav.fails("param", "get", "quad1", "RTL_ALTT").error
    assert isinstance(error, BadInput)
    assert "did you mean RTL_ALT" in str(error)
    assert isinstance(vehicle.zmav.fails("param", "get", "rover*", "RTL_ALT").error, NoSuchVehicle)


def test_set_several(vehicle: Vehicle) -> None:
    try:
        told = vehicle.zmav("param", "set", "quad1", "rtl_alt=1600", "WPNAV_SPEED=750.5")
        assert told.out == "quad1: RTL_ALT is 1600\nquad1: WPNAV_SPEED is 750.5\n"
    finally:
        vehicle.zmav("param", "set", "quad*", "RTL_ALT=1500", "WPNAV_SPEED=1000")
    failed = vehicle.zmav.fails("param", "set", "quad1", "RTL_ALT=1.5", "WPNAV_SPEED=1000", "--json")
    bad, good = failed.lines
    assert (bad["name"], bad["error"], good["value"]) == ("RTL_ALT", "bad_input", 1000.0)
    for arguments in (("RTL_ALT=high",), ("RTL_ALT",), ("=3",), ("RTL_ALT=NaN",), ("RTL_ALT=true",)):
        assert isinstance(vehicle.zmav.fails("param", "set", "quad1", *arguments).error, BadInput)


@pytest.mark.parametrize("name", ["q.params", "q.parm"])
def test_save_and_load(vehicle: Vehicle, tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    assert vehicle.zmav("param", "save", "quad1", str(path)).out == f"quad1: 1354 parameters written to {path}\n"
    saved = paramfile.read(path.read_bytes(), name)
    assert (len(saved.params), saved.values()["RTL_ALT"]) == (1354, 1500)
    assert vehicle.zmav("param", "load", "quad1", str(path), "--dry-run").out == ""
    text = path.read_text(encoding="utf-8")
    for before, after in (("RTL_ALT,1500", "RTL_ALT,1600"), ("RTL_ALT\t1500", "RTL_ALT\t1600")):
        text = text.replace(before, after)
    text = text.replace("MAV_SYSID,1", "MAV_SYSID,9").replace("MAV_SYSID\t1\t", "MAV_SYSID\t9\t")
    path.write_text(text, encoding="utf-8")
    told = vehicle.zmav("param", "load", "quad1", str(path), "--dry-run")
    assert told.out == "quad1: RTL_ALT 1500 -> 1600\n"  # and not the system id
    assert told.err == "quad1: 1 would be set; nothing was sent\n"
    assert vehicle.zmav("param", "get", "quad1", "RTL_ALT", "--json").lines[0]["value"] == 1500
    try:
        assert vehicle.zmav("param", "load", "quad1", str(path)).err == "quad1: 1 set, 0 unchanged, 0 failed\n"
        assert vehicle.zmav("param", "get", "quad1", "RTL_ALT", "--json").lines[0]["value"] == 1600
    finally:
        vehicle.zmav("param", "set", "quad1", "RTL_ALT=1500")
    told = vehicle.zmav("param", "diff", "quad1", str(path), "--json")
    assert told.lines == [{"name": "RTL_ALT", "values": {"quad1": 1500, str(path): 1600}}]
    assert "1 parameters differ among 2 (1 more are each vehicle's own" in told.err
    own = vehicle.zmav("param", "diff", "quad1", str(path), "--own", "--json")
    assert {line["name"] for line in own.lines} == {"RTL_ALT", "MAV_SYSID"}


def test_load_names_what_failed(vehicle: Vehicle, tmp_path: Path) -> None:
    path = tmp_path / "q.parm"
    path.write_text("RTL_ALT,0.5\nNOPE,1\nWPNAV_SPEED,1000\n", encoding="utf-8")
    told = vehicle.zmav.fails("param", "load", "quad1", str(path), "--json")
    failed = {line["name"]: line["error"] for line in told.lines if "error" in line}
    assert set(failed) == {"RTL_ALT", "NOPE"}
    assert "takes integers" in failed["RTL_ALT"]


def test_save_a_part_and_refuse_what_cannot_be_written(vehicle: Vehicle, tmp_path: Path) -> None:
    path = tmp_path / "{vehicle}.parm"
    vehicle.zmav("param", "save", "quad*", str(path), "WPNAV_*")
    written = (tmp_path / "quad1.parm").read_text(encoding="utf-8").splitlines()
    assert "WPNAV_SPEED,1000" in written
    assert all(line.startswith(("WPNAV_", "#")) for line in written)
    for target in (str(tmp_path / "q.txt"), str(tmp_path / "nowhere" / "q.params")):
        assert isinstance(vehicle.zmav.fails("param", "save", "quad1", target).error, BadInput)


def test_diff_needs_two_and_readable_files(vehicle: Vehicle, tmp_path: Path) -> None:
    bad = tmp_path / "bad.params"
    bad.write_text("1\t1\tA\n", encoding="utf-8")
    assert "only quad1 to compare" in str(vehicle.zmav.fails("param", "diff", "quad*").error)
    assert "bad.params, line 1" in str(vehicle.zmav.fails("param", "diff", "quad1", str(bad)).error)
    assert "cannot read" in str(vehicle.zmav.fails("param", "diff", "quad1", str(tmp_path / "no.params")).error)
    same = tmp_path / "same.parm"
    same.write_text("RTL_ALT,1500\n", encoding="utf-8")
    assert vehicle.zmav("param", "diff", "quad1", str(same)).out == ""
    same.write_text("RTL_ALT,1\nFOREIGN,2\n", encoding="utf-8")
    told = vehicle.zmav("param", "diff", "quad1", str(same))
    assert told.out.split()[-6:] == ["FOREIGN", "-", "2", "RTL_ALT", "1500", "1"]


def test_a_table_for_fifty() -> None:
    columns = {f"quad{i}": {"A": 2 if i == 7 else 1, **({} if i in (3, 4) else {"B": 0.5})} for i in range(50)}
    head, rows = comparison(differences(columns), list(columns))
    assert head == ["name", "most of 50", "the others"]
    assert list(rows) == [["A", "1 ×49", "2: quad7"], ["B", "0.5 ×48", "-: quad3 quad4"]]
    head, rows = comparison(differences({"a": {"A": 1}, "b": {}}), ["a", "b"])
    assert (head, list(rows)) == (["name", "a", "b"], [["A", "1", "-"]])


def test_values_for_a_person() -> None:
    assert [shown(v) for v in (3.0, -0.0, 0.1, 1e20, None, 2**40)] == ["3", "0", "0.1", "1e+20", "nan", str(2**40)]
    assert json.loads(shown(0.33333334)) == 0.33333334
