"""docs/vehicle-setup.md: its parameters are the autopilots', and its example file is one that can be loaded."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from zmav.autopilots.safety import SAFETY
from zmav.formats import paramfile
from zmav.sim.protocol.params import defaults

PAGE = (Path(__file__).resolve().parent.parent.parent / "docs" / "vehicle-setup.md").read_text()
PARAMETER = re.compile(r"[A-Z][A-Z0-9]+_[A-Z0-9_]+$")
SITL = {"ArduPilot": ("arducopter", "arduplane", "ardurover"), "PX4": ("px4",)}


def section(name: str) -> str:
    return PAGE.split(f"\n## {name}\n")[1].split("\n## ")[0]


def table(name: str) -> list[tuple[str, list[str]]]:
    """The first cell and the parameters named in it, of each row under that heading."""
    cells = [line.split(" | ")[0] for line in section(name).splitlines() if line.startswith("| `")]
    return [(cell, [each for each in re.findall(r"`([^`]+)`", cell) if PARAMETER.match(each)]) for cell in cells]


def known(name: str) -> set[str]:
    return {param for kind in SITL[name] for param, _, _ in defaults(kind)}


ROWS = [(name, cell, params) for name in SITL for cell, params in table(name)]


def test_there_are_rows() -> None:
    assert len(ROWS) > 20


@pytest.mark.parametrize(("name", "cell", "params"), ROWS, ids=lambda value: value if isinstance(value, str) else "")
def test_each_is_the_simulated_autopilots_or_says_that_documents_alone_know_it(
    name: str, cell: str, params: list[str]
) -> None:
    there = [param for param in params if param in known(name)]
    old = {each for safeties in SAFETY.values() for safety in safeties for each in safety.names[1:]} | {"SYSID_THISMAV"}
    assert params
    if "(docs)" in cell:
        assert not there, f"{there} are known to the simulation: they need no excuse"
    else:
        assert set(params) - set(there) <= old


@pytest.mark.parametrize("name", SITL)
def test_what_the_text_names_is_known_too(name: str) -> None:
    excused = {param for row, cell, params in ROWS if row == name and "(docs)" in cell for param in params}
    old = {"SYSID_THISMAV", "SYSID_MYGCS"}
    named = {each for each in re.findall(r"`([^`]+)`", section(name)) if PARAMETER.match(each)}
    assert named - known(name) - excused - old <= {"MAV_2_CONFIG"}  # of PX4's documents, as its first instance


def test_the_file_is_one_and_fits_a_copter() -> None:
    text = PAGE.split("```params\n")[1].split("```")[0]
    found = {each.name for each in paramfile.read(text.encode(), "companion.params").params}
    assert found
    assert found <= {name for name, _, _ in defaults("arducopter")}
