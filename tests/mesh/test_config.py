"""``zmav mesh config``: what results from the fleet file, for a person and for a script."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from mesh.cli.config import command
from zmav.doctor.fleet_file import check_file
from zmav.errors import BadConfig

FLEET = """
fleet = "alpha"
[mesh]
profile = "wds"
insecure = true
lease = 3.0
[vehicles.quad1]
link = "/dev/ttyAMA0"
[[vehicles.quad1.mesh.radios]]
interface = "nosuch0"
address = "10.77.0.1"
[stations.ground.mesh]
[[stations.ground.mesh.radios]]
interface = "nosuch0"
address = "fd00::9"
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "fleet.toml"
    path.write_text(FLEET)
    return path


def told(*arguments: str) -> Result:
    return CliRunner().invoke(command, list(arguments))


def test_a_table_of_values_and_where_they_came_from(file: Path) -> None:
    said = told("--file", str(file), "--name", "ground", "-e", "tcp/127.0.0.1:9").output
    assert "alpha/ground, profile wds" in said
    rows = {row.split("│")[1].strip(): row for row in said.splitlines() if row.count("│") == 4}
    assert "3000" in rows["transport/link/tx/lease"]
    assert "fleet file: mesh.lease" in rows["transport/link/tx/lease"]
    assert "profile wds" in rows["transport/link/tx/keep_alive"]
    assert "tcp/127.0.0.1:9" in rows["connect/endpoints"]
    assert rows["connect/endpoints"].split("│")[3].strip() == "-e"
    assert "[fd00::9]:7447" in said
    assert "radio nosuch0: fd00::9/64, not there yet: it will be waited for" in said


def test_json_for_scripts(file: Path) -> None:
    body = json.loads(told("--file", str(file), "--name", "quad1", "--json").output)
    assert (body["fleet"], body["name"], body["profile"], body["neighbours"]) == ("alpha", "quad1", "wds", {})
    assert body["settings"]["transport/link/tx/lease"] == {"value": 3000, "source": "fleet file: mesh.lease"}


def test_behind_bearers_what_results_is_shown(file: Path) -> None:
    radio = '[[stations.ground.mesh.radios]]\naddress = "10.77.0.9"\nbudget = "60 kB/s"\n'
    file.write_text(FLEET.replace('address = "fd00::9"', f'address = "fd00::9"\n{radio}'))
    arguments = ("--file", str(file), "--name", "ground")
    body = json.loads(told(*arguments, "--json").output)
    assert body["bearers"] == {"quad1": [["10.77.0.9", "10.77.0.1", 7448, 40]]}
    listen, connect = (body["settings"][f"{how}/endpoints"]["value"] for how in ("listen", "connect"))
    local = "udp/127.0.0.1:0?rel=1;mixed_rel=1"
    assert listen == ["tcp/127.0.0.1:7447", "udp/[fd00::9]:7447?rel=1;mixed_rel=1", local]
    assert connect == [f"{local}#bind=127.0.0.1:0"]
    said = told(*arguments)
    assert "bearer to quad1: 10.77.0.9 > 10.77.0.1:7448 (cost 40); the link is opened by us" in said.output
    file.write_text(file.read_text().replace("budget =", "port = 65535\nbudget ="))
    for name in ("ground", "quad1"):
        refused = told("--file", str(file), "--name", name).exception
        assert isinstance(refused, BadConfig)
        assert refused.detail["field"] == "port"


def test_without_a_file_it_is_a_router_on_loopback() -> None:
    body = json.loads(told("--json", "--name", "base").output)
    assert body["name"] == "base"
    assert body["settings"]["listen/endpoints"] == {"value": ["tcp/127.0.0.1:7447"], "source": "zmav"}
    assert json.loads(told("--json").output)["name"]  # the computer's own


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--name", "quad9"], "no host 'quad9' in the fleet file; it has quad1, ground"),
        (["--name", "Quad 1"], "name 'Quad 1' cannot stand in a key"),
        (["--name", "quad1", "--cfg", "no/such:1"], "Zenoh refuses no/such"),
        (["--name", "quad1", "-l", "7447"], "<protocol>/<address>"),
        (["--name", "quad1", "--credentials", "/no/such"], "cannot read /no/such"),
    ],
)
def test_what_cannot_be_is_said(file: Path, arguments: list[str], words: str) -> None:
    assert words in str(told("--file", str(file), *arguments).exception)


def test_a_budget_that_is_none_is_said_of_every_host_on_each(tmp_path: Path) -> None:
    """By the doctor, too: who mends the file need not be at the vehicle that would not start with it."""
    file = tmp_path / "fleet.toml"
    radio = '{ address = "10.8.0.1", budget = "60" }'
    file.write_text(f'[stations.ground]\n[vehicles.quad1]\nlink = "tcp:127.0.0.1:1"\nmesh.radios = [{radio}]\n')
    words = f"{file}: vehicles.quad1.mesh.radios[0].budget is '60'; expected like '60 kB/s' or '1 Mbit/s'"
    assert words in str(told("--file", str(file), "--name", "ground").exception)
    (finding,), _ = check_file(str(file), "ground")
    assert words in finding.found
