"""One recording against the flight of its counterpart."""

from __future__ import annotations

from pathlib import Path

from tests.sim.yardstick.compare import Difference, Flight, compare
from tests.sim.yardstick.flights import Yardstick
from tests.sim.yardstick.reading import from_tlog


def measure(yardstick: Yardstick, data: Path) -> list[Difference]:
    """Every difference. Raises FileNotFoundError where the recording is absent."""
    dialect = yardstick.dialect()
    real = Flight(list(from_tlog(data / yardstick.tlog, dialect, yardstick.sysid)))
    return list(compare(real, Flight(yardstick.fly()), dialect, yardstick.states))
