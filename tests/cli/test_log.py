"""``zmav log`` against a simulated vehicle with its real agent."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from zmav.errors import BadInput, Refused
from zmav.sim.protocol.ardupilot.node import MavNode
from zmav.sim.protocol.ardupilot.storage import Storage

if TYPE_CHECKING:
    from tests.cli.conftest import Vehicle


@pytest.fixture
def storage(vehicle: Vehicle) -> Iterator[Storage]:
    """The vehicle's, with two logs and no others."""
    node = vehicle.sim.node
    assert isinstance(node, MavNode)
    found = node.storage

    def fill() -> None:
        found.logs.erase()
        for size in (300, 50_000):
            found.logs.begin(bytearray(size * b"x"), time.time())

    vehicle.world.call(fill)
    yield found
    vehicle.world.call(found.logs.erase)


def test_logs_are_listed_fetched_and_erased(vehicle: Vehicle, storage: Storage, tmp_path: Path) -> None:
    zmav = vehicle.zmav
    rows = zmav("log", "quad1", "list", "--json").lines
    assert [(row["id"], row["size"]) for row in rows] == [(1, 300), (2, 50_000)]
    assert zmav("log", "quad1", "list").out.splitlines()[1].endswith("   50.0 kB")
    out = tmp_path / "log.bin"
    (row,) = zmav("log", "quad1", "get", "latest", "--to", str(out), "--json").lines
    assert row == {"id": 2, "file": str(out), "size": 50_000}
    assert out.read_bytes() == b"x" * 50_000
    told = zmav("log", "quad1", "get", "all", "1", "--to", str(tmp_path / "logs"))
    assert len(told.out.splitlines()) == 2
    assert sorted(path.stat().st_size for path in (tmp_path / "logs").iterdir()) == [300, 50_000]
    assert zmav("log", "quad1", "erase", "--yes").out == "2 logs erased\n"
    assert zmav("log", "quad1", "list").out == "no logs\n"


def test_what_goes_wrong_is_said(vehicle: Vehicle, storage: Storage) -> None:
    zmav = vehicle.zmav
    error = zmav.fails("log", "quad1", "get", "7").error
    assert isinstance(error, BadInput)
    assert error.message == "there is no log 7; there are: 1, 2"
    zmav("do", "quad1", "arm")
    try:
        error = zmav.fails("log", "quad1", "list").error
        assert isinstance(error, Refused)
        assert "while it is armed" in error.message
    finally:
        zmav("do", "quad1", "disarm")
    zmav.misused("log", "quad1", "get")
    zmav.misused("log", "quad1", "get", "newest")
    zmav.misused("log", "quad1", "list", "1")
    assert zmav.fails("log", "quad1", "erase").out == ""  # nobody is there to say yes
    assert len(zmav("log", "quad1", "list", "--json").lines) == 3
