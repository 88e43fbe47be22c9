"""A scene painted into a file step by step, and the file read back."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import pytest

pytest.importorskip("rerun", reason="needs the viz extra")

import rerun as rr
from rerun.chunk import RrdReader

from ground.view.canvas import Canvas
from ground.view.painter import Painting
from ground.view.scene import Scene
from ground.view.table import Batch, Item
from zmav import wire

T0 = 1.8e9
HOME = (52.756, -1.246, 60.0)


class Row(NamedTuple):
    """What was logged on a path at a time: components by their names, without lists around single values."""

    t: float | None
    """UTC seconds; None: at all times"""
    values: dict[str, Any]


def rows_of(path: Path) -> dict[str, list[Row]]:
    """Every row of a recording, by path, in order of time."""
    found: dict[str, list[Row]] = {}
    for chunk in RrdReader(str(path)).stream():
        batch = chunk.to_record_batch()
        times: list[float | None] = [None] * batch.num_rows
        if "time" in batch.schema.names:
            index = batch.schema.get_field_index("time")  # nanoseconds, which a datetime does not hold
            times = [ns / 1e9 for ns in batch.column(index).cast("int64").to_pylist()]
            batch = batch.remove_column(index)
        for t, line in zip(times, batch.to_pylist(), strict=True):
            values = {name: value for name, value in line.items() if ":" in name and value is not None}
            found.setdefault(chunk.entity_path, []).append(Row(t, values))
    return {name: sorted(rows, key=lambda row: row.t or 0.0) for name, rows in found.items()}


class Painted:
    """``step(kind, place, payload...)`` paints one step a tenth of a second after the last one."""

    def __init__(self, path: Path, several: bool = False) -> None:
        self.path = path
        self._recording = rr.RecordingStream("test")
        self._recording.set_log_tick_enabled(False)
        self._recording.set_log_time_enabled(False)
        self._recording.save(str(path))
        self.canvas = Canvas(self._recording)
        self.scene = Scene(self.canvas, several)
        self._painting = Painting(self._recording, self.canvas, self.scene)
        self.now = 0.0

    def step(self, *items: tuple[str, tuple[str, ...], msgspec.Struct | bytes], after: float = 0.1) -> None:
        self.now += after
        batch = [
            Item(kind, place, T0 + self.now, self.now, what if isinstance(what, bytes) else wire.encode(what))
            for kind, place, what in items
        ]
        self._painting.step(Batch(batch), self.now, T0 + self.now)

    def rows(self) -> dict[str, list[Row]]:
        """End the recording and read it."""
        self._recording.flush()
        self._recording.disconnect()
        return rows_of(self.path)


@pytest.fixture
def read() -> Callable[[Path], dict[str, list[Row]]]:
    """Every row of a recording by path; it may still be written to."""
    return rows_of


@pytest.fixture
def paint(tmp_path: Path) -> Iterator[Callable[..., Painted]]:
    made: list[Painted] = []

    def make(**options: Any) -> Painted:
        made.append(Painted(tmp_path / f"{len(made)}.rrd", **options))
        return made[-1]

    yield make
    for painted in made:
        painted._recording.disconnect()


@pytest.fixture
def state() -> Callable[..., wire.VehicleState]:
    """``state(local=(n, e, d), ...)``: a vehicle's state."""

    def make(name: str = "quad1", **values: Any) -> wire.VehicleState:
        return wire.VehicleState(
            **{
                "t": T0,
                "fleet": "demo",
                "name": name,
                "instance": "i",
                "connected": True,
                "kind": "copter",
                "mode": "GUIDED",
                "armed": True,
                "local": (10.0, 20.0, -5.0),
                "velocity": (1.0, 2.0, -0.5),
                "position": wire.GlobalPosition(lat_deg=HOME[0], lon_deg=HOME[1], alt_amsl=65.0, alt_rel=5.0),
                **values,
            }
        )

    return make
