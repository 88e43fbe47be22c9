"""What a start costs: verbs, and what they stand on, are loaded when they are used."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click
import pytest

from zmav import cli
from zmav.cli.common import Verbs

if TYPE_CHECKING:
    from tests.cli.conftest import Vehicle

HEAVY = ("asyncio", "cryptography", "msgspec", "numpy", "pymavlink", "rich", "zenoh")
VEHICLES_OWN = ("serial", "zmav.autopilots", "zmav.links", "zmav.services.companion", "zmav.services.orders")
"""what stands beside an autopilot"""


def loaded(code: str, names: tuple[str, ...] = HEAVY) -> set[str]:
    """Which of the heavy ones a program has loaded in the end."""
    told = f"{code}\nimport sys\nprint('loaded', *(name for name in {names} if name in sys.modules))"
    done = subprocess.run([sys.executable, "-c", told], check=True, capture_output=True, text=True)
    return set(done.stdout.splitlines()[-1].split()[1:])


def test_help_loads_no_verb() -> None:
    assert loaded("from zmav.cli import zmav\nzmav(['--help'], standalone_mode=False)") == set()


@pytest.mark.parametrize("module", ["agents.vehicle.cli", "agents.vehicle.run", "mesh.cli.router"])
def test_what_runs_all_day_loads_what_it_uses(module: str) -> None:
    assert loaded(f"import {module}") == {"asyncio", "msgspec", "zenoh"}


@pytest.mark.parametrize("verb", ["do", "ls", "goto"])
def test_a_verb_that_asks_vehicles_loads_nothing_of_what_runs_on_them(verb: str) -> None:
    assert loaded(f"import zmav.client, zmav.cli.{verb}", VEHICLES_OWN) == set()


def test_to_find_up_takes_no_more_than_up() -> None:
    """importlib.metadata and what it stands on are 1.6 MB, for as long as the agent runs."""
    find = "cli.zmav.get_command(click.Context(cli.zmav), 'up')"
    code = f"import sys, click; from zmav import cli; assert {find}; assert 'importlib.metadata' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_up_reads_the_dialect_before_the_services_are_there() -> None:
    code = "import sys, agents.vehicle.cli; assert 'zmav.onboard' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_simulator_draws_no_tables() -> None:
    assert "rich" not in loaded("import zmav.cli.sim")


@pytest.mark.parametrize("name", cli.zmav.list_commands(click.Context(cli.zmav)))
def test_help_says_of_a_verb_what_the_verb_says(name: str) -> None:
    assert isinstance(cli.zmav, Verbs)
    about = cli.zmav.about(name)
    command = cli.zmav.get_command(click.Context(cli.zmav), name)
    assert about is not None
    assert command is not None
    assert click.Command(name, help=about).get_short_help_str(300) == command.get_short_help_str(300)


def test_of_verbs_of_one_name_ours_is_told_of_and_found_beside_folders_that_cannot_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = tmp_path / "other-1.dist-info"
    other.mkdir()
    (other / "METADATA").write_text("Name: other\nVersion: 1\n")
    (other / "entry_points.txt").write_text("[zmav.verbs]\nup = json.tool:main\n")
    monkeypatch.setattr(sys, "path", ["x" * 300, *sys.path, str(tmp_path)])  # the first: OSError, whoever reads it
    verbs = Verbs("zmav", points="zmav.verbs")
    assert verbs.get_command(click.Context(verbs), "up") is cli.zmav.get_command(click.Context(cli.zmav), "up")
    assert verbs.about("up") == cli.zmav.about("up") is not None


def test_ls_ends_once_all_have_answered(vehicle: Vehicle) -> None:
    (row,) = vehicle.zmav("ls", "--json", "--wait", "100000").lines
    assert (row["name"], row["present"]) == ("quad1", True)
