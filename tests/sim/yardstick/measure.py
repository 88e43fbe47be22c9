"""One recording against the flight of its counterpart."""

from __future__ import annotations

from pathlib import Path

from tests.sim.yardstick.compare import Difference, Flight, compare
from tests.sim.yardstick.explained import reason_for
from tests.sim.yardstick.flights import YARDSTICKS, Yardstick
from tests.sim.yardstick.reading import Message, from_tlog


def measure(yardstick: Yardstick, data: Path) -> list[Difference]:
    """Every difference. Raises FileNotFoundError where the recording is absent."""
    real = list(from_tlog(data / yardstick.tlog, yardstick.dialect(), yardstick.sysid))
    return differences(yardstick, real, yardstick.fly())


def differences(yardstick: Yardstick, real: list[Message], ours: list[Message]) -> list[Difference]:
    """Every difference of two flights that there are already."""
    return list(compare(Flight(real), Flight(ours), yardstick.dialect(), yardstick.states))


def only_what_is_explained_differs(name: str, real: list[Message], ours: list[Message]) -> None:
    """Assert it of two flights of the yardstick ``name``."""
    rows = differences(YARDSTICKS[name], real, ours)
    assert [row for row in rows if reason_for(name, row) is None] == []
    assert rows  # an empty table would mean that nothing was compared
