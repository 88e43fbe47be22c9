"""``zmav ftp`` and ``zmav log`` against a simulated vehicle with its real agent."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from zmav.cli.common import size
from zmav.errors import BadInput, NoSuchVehicle, Refused

if TYPE_CHECKING:
    from tests.cli.conftest import StartProcess, Vehicle


def test_a_file_there_and_back_from_the_shell(vehicle: Vehicle, tmp_path: Path) -> None:
    zmav, data = vehicle.zmav, bytes(range(256)) * 20
    local = tmp_path / "hello.lua"
    local.write_bytes(data)
    assert zmav("ftp", "quad1", "mkdir", "/APM/cli").out == "/APM/cli: made\n"
    told = zmav("ftp", "quad1", "put", str(local), "/APM/cli/")
    assert told.out == f"{local} -> /APM/cli/hello.lua (5.1 kB, checksum agrees)\n"
    assert zmav("ftp", "quad1", "ls", "/APM/cli").out.split() == ["5120", "hello.lua"]
    (row,) = zmav("ftp", "quad1", "ls", "/APM/cli", "--json").lines
    assert row == {"name": "hello.lua", "size": 5120, "directory": False}
    back = tmp_path / "back.lua"
    (row,) = zmav("ftp", "quad1", "get", "/APM/cli/hello.lua", str(back), "--json").lines
    assert row == {"path": "/APM/cli/hello.lua", "file": str(back), "size": 5120}
    assert back.read_bytes() == data
    assert zmav("ftp", "quad1", "rm", "/APM/cli/hello.lua").out == "/APM/cli/hello.lua: removed\n"
    zmav("ftp", "quad1", "rmdir", "/APM/cli")
    assert "terrain/" in zmav("ftp", "quad1", "ls", "/APM").out
    assert zmav("ftp", "quad1", "cancel").out == "no transfer was under way\n"


def test_what_goes_wrong_is_said(vehicle: Vehicle, tmp_path: Path) -> None:
    zmav = vehicle.zmav
    error = zmav.fails("ftp", "quad1", "get", "/APM/nope", str(tmp_path)).error
    assert isinstance(error, Refused)
    assert "there is no such file" in error.message
    told = zmav.fails("ftp", "quad1", "rm", "/APM/nope", "/APM/neither", "--json")
    assert [json.loads(row)["error"] for row in told.out.splitlines()] == ["refused", "refused"]
    assert isinstance(zmav.fails("ftp", "quad1", "put", str(tmp_path / "x"), "/APM/x").error, BadInput)
    assert isinstance(zmav.fails("ftp", "quad9", "ls").error, NoSuchVehicle)
    zmav.misused("ftp", "quad1", "put", "/APM/x")
    zmav.misused("ftp", "quad1", "fly")


def test_a_refusal_ends_with_1_and_the_reason(start: StartProcess, vehicle: Vehicle) -> None:
    process = start("ftp", "quad1", "ls", "/nope", "-e", vehicle.endpoint)
    assert process.wait() == 1
    assert process.stderr == "zmav: cannot list /nope: there is no such file or directory"


@pytest.mark.parametrize(
    ("count", "text"), [(0, "0 B"), (999, "999 B"), (1000, "1.0 kB"), (2_500_000, "2.5 MB"), (7e9, "7.0 GB")]
)
def test_sizes_as_a_person_reads_them(count: float, text: str) -> None:
    assert size(count) == text
