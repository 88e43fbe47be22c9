"""The orders in a recording, as 'zmav record --orders' shows them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from click.testing import CliRunner

from ground.record.cli import command
from zmav import cli, keys, wire

if TYPE_CHECKING:
    from tests.conftest import Net

KEY = keys.FLEET.key("demo", topic=keys.ORDERED)


def test_the_orders_in_a_recording_are_shown(bench: Any, tmp_path: Path) -> None:
    """Of those files that can be read."""
    here = bench()
    line = wire.OrderLine(
        t=1_700_000_000.0, who="anna", source="10.0.0.7", verb="do/takeoff", vehicles=["quad1"], outcome="done", more=2
    )
    here.storage.put(KEY, wire.encode(line))
    here.storage.put(KEY, b'{"t": 1, "nonsense": true}')
    here.storage.put("zmav/demo/@fleet/goal", b'{"t": 1}')
    here.storage.close()
    (path,) = here.files("mcap")
    (tmp_path / "torn.tlog").write_bytes(bytes(4096))
    result = CliRunner().invoke(command, ["--orders", str(tmp_path / "torn.tlog"), "--orders", str(path)])
    assert result.exit_code == 0, result.output
    assert "left out:" in result.output and "torn.tlog holds no MAVLink" in result.output
    (row,) = [line for line in result.output.splitlines() if "takeoff" in line]
    assert "anna@10.0.0.7" in row and "quad1" in row and "done (2 more before)" in row
    assert "1 orders" in result.output


@pytest.mark.parametrize("verb", [["record", "--orders"], ["replay"]], ids=" ".join)
def test_what_is_no_recording_is_said(tmp_path: Path, verb: list[str], net: Net) -> None:
    notes = tmp_path / "notes.txt"
    notes.write_text("hello world, this is no recording")
    folder = tmp_path / "folder"
    (folder / "quad1.tlog").mkdir(parents=True)
    told = ((tmp_path, "no .mcap and no .tlog"), (notes, f"{notes} holds no MAVLink"), (folder, "cannot play"))
    for path, words in told:
        result = CliRunner().invoke(cli.zmav, [*verb, str(path), "-e", net.router()[1]])
        assert result.exit_code != 0 and words in f"{result.output}{result.exception}"
