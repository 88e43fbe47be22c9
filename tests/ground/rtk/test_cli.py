"""``zmav rtk`` on the command line: what it prints, and what it refuses before anything is opened."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from click.testing import CliRunner

from ground.program import until_over
from ground.rtk.cli import command
from tests.rtcm import base_at, message
from zmav import keys
from zmav.corrections import unpack
from zmav.errors import BadConfig, BadInput, BadKey, BadUrl

if TYPE_CHECKING:
    from tests.conftest import Net


@pytest.mark.parametrize(
    ("words", "error", "says"),
    [
        (["nowhere"], BadUrl, "no source of corrections 'nowhere'"),
        (["tcp:h:1", "--survey", "60,2", "--at", "1,2,3"], BadInput, "--survey or --at, not both"),
        (["tcp:h:1", "--survey", "soon"], BadInput, "no survey-in 'soon'"),
        (["tcp:h:1", "--gga", "quad1"], BadInput, "only a caster is told where the rover is"),
        (["ntrip://h/M", "--gga", "Quad 1"], BadKey, "cannot stand in a key"),
        (["ntrip://h/M", "--gga", "1,2"], BadInput, "no place '1,2'"),
        (["ntrip://h/M", "--survey", "60,2"], BadInput, "only a base receiver can be told so"),
        (["tcp:h:1", "--port", "USB"], BadInput, "--port"),
    ],
)
def test_refusals(words: list[str], error: type[Exception], says: str) -> None:
    result = CliRunner().invoke(command, words)
    assert isinstance(result.exception, error)
    assert says in str(result.exception)


def test_a_file_is_played_with_its_status_as_json(net: Net, tmp_path: Path) -> None:
    _, endpoint = net.router()
    heard = net.ground(endpoint).samples(keys.RTCM)
    path = tmp_path / "base.rtcm"
    path.write_bytes(b"".join(base_at() + message(1077, seed=t) for t in range(3)))
    result = CliRunner().invoke(command, [str(path), "--json", "--name", "gs", "--priority", "7", "-e", endpoint])
    assert result.exception is None, result.output
    lines = [json.loads(line) for line in result.stdout.splitlines()]
    assert len(lines) >= 3
    assert lines[-1]["state"] == "ended"
    assert lines[-1]["messages"] == {"1005": 3, "1077": 3}
    assert "in charge: corrections go to the fleet as gs" in result.stderr
    found = [unpack(payload) for _, payload in heard.items]
    assert b"".join(each.data for batch in found for each in batch.messages) == path.read_bytes()
    assert {(batch.source, batch.priority) for batch in found} == {("gs", 7)}


def test_one_fleet_is_named(net: Net, tmp_path: Path) -> None:
    _, endpoint = net.router()
    path = tmp_path / "base.rtcm"
    path.write_bytes(base_at())
    result = CliRunner().invoke(command, [str(path), "--fleet", "*", "-e", endpoint])
    assert isinstance(result.exception, BadConfig)
    assert "name it with --fleet" in str(result.exception)


async def test_what_ends_the_work_is_raised_as_it_was_and_no_status_is_printed_then(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A status whose reader is gone would be raised in its place."""

    async def work() -> None:
        raise BadInput("no such caster", field="url", value="x", expected="another")

    with pytest.raises(BadInput, match="no such caster"):
        await until_over(lambda: ("failed", "no such caster", {}), True, work())
    assert capsys.readouterr().out == ""


async def test_the_last_status_is_printed_where_the_work_is_done(capsys: pytest.CaptureFixture[str]) -> None:
    async def work() -> None:
        return

    await until_over(lambda: ("done", "all played", {}), True, work())
    assert json.loads(capsys.readouterr().out) == {"state": "done", "text": "all played"}
