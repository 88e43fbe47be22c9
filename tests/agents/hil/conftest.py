"""A fleet file for the stages, and boards on pseudo-terminals."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Protocol

import pytest

from agents.hil import bench, checkflight, steps
from tests.agents.hil.board import Px4Board
from zmav.sim.spec import Home

HOME = Home(47.3977, 8.5456, 488.0)
FLEET = """
fleet = "alpha"

[origin]
lat_deg = 47.3977
lon_deg = 8.5456
alt_amsl = 488.0

[geofence]
radius = 8.0
ceiling = 40.0

[limits]
speed = 8.0

[vehicles.quad1]
link = "/dev/ttyACM0"
sysid = 1
[vehicles.quad1.pilot_switch]
channel = 7
[vehicles.quad1.sim]

[vehicles.px1]
link = "/dev/ttyACM0"
[vehicles.px1.sim]
autopilot = "px4"
"""
SAFE = {"COM_OBL_RC_ACT": 3.0, "RTL_RETURN_ALT": 6.0, "RTL_DESCEND_ALT": 6.0, "RTL_LAND_DELAY": 0.0}
"""PX4's parameters as 'zmav doctor' wants them, and for a short way home"""


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the stages expect of time, a busy machine that runs the tests need not keep; flights are hurried."""
    for module, name, value in (
        (steps, "HOLD_SLACK", 10.0),
        (steps, "PILOT_S", 10.0),
        (checkflight, "SILENT_S", 15.0),
        (checkflight, "LINK_LOSS", 0.5),
        (checkflight, "PACE", 3.0),
        (bench, "LEAST_SHARE", 0.05),
        (bench, "LEAST_SPEED", 0.1),
    ):
        monkeypatch.setattr(module, name, value)


@pytest.fixture
def fleet(tmp_path: Path) -> Path:
    path = tmp_path / "fleet.toml"
    path.write_text(FLEET, encoding="utf-8")
    return path


class MakeBoard(Protocol):
    def __call__(self, *, hitl: int = 1, speed: float = 1.0, **params: float) -> Px4Board: ...


@pytest.fixture
def make_board(tmp_path: Path) -> Iterator[MakeBoard]:
    """A PX4 on a pseudo-terminal that is gone at the test's end."""
    with ExitStack() as stack:

        def make(*, hitl: int = 1, speed: float = 1.0, **params: float) -> Px4Board:
            board = Px4Board(tmp_path / "ttyACM0", HOME, hitl=hitl, speed=speed, **{**SAFE, **params})
            return stack.enter_context(board)

        yield make
