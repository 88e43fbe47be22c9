"""The simulator's vehicles beside recordings of real autopilots on the same flights: whatever differs is explained.

``python -m tests.sim.yardstick`` prints the table.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.sim.yardstick.compare import Difference, Flight, compare
from tests.sim.yardstick.explained import reason_for
from tests.sim.yardstick.flights import YARDSTICKS
from tests.sim.yardstick.measure import only_what_is_explained_differs
from tests.sim.yardstick.reading import Message, from_tlog
from zmav.mavlink import load_dialect

RECORDINGS = {"rover", "plane", "px4"}
"""flown by tests of their own (``test_*_recording.py``), which look at these differences, too: once flown is enough"""


@pytest.mark.parametrize("name", sorted(YARDSTICKS.keys() - RECORDINGS))
def test_only_what_is_explained_differs(name: str, shared_data: Path) -> None:
    yardstick = YARDSTICKS[name]
    real = list(from_tlog(shared_data / yardstick.tlog, yardstick.dialect(), yardstick.sysid))
    only_what_is_explained_differs(name, real, yardstick.fly())


class TestTheMeasure:
    """It finds what is wrong."""

    @staticmethod
    def flight(**changes: Any) -> list[Message]:
        """Half a minute of climbing and flying north; ``changes`` go to VFR_HUD, or are None for what is not sent."""
        messages: list[Message] = []
        for i in range(300):
            at, climbs = i / 10.0, i < 150
            if i % 10 == 0:
                messages.append((at, "HEARTBEAT", {"base_mode": 209, "custom_mode": 4, "type": 2}))
            down = -2.0 - i % 7 / 10 if climbs else 0.0
            position = {"lat": 473977420, "vx": 0 if climbs else 400, "vy": 0, "vz": round(down * 100)}
            messages.append((at, "GLOBAL_POSITION_INT", position))
            messages.append((at, "ATTITUDE", {"roll": 0.0, "pitch": 0.01 * (i % 5), "yawspeed": 0.0}))
            hud = {"climb": -down, "heading": 90, "airspeed": 4.0 + i % 3, "alt": float(i)}
            hud.update({k: v(-down) if callable(v) else v for k, v in changes.items()})
            if changes.get("every", 1) and i % changes.get("every", 1) == 0:
                messages.append((at, "VFR_HUD", {k: v for k, v in hud.items() if k != "every"}))
        return messages

    def rows(self, **changes: Any) -> list[Difference]:
        states = {"HEARTBEAT": ("base_mode", "custom_mode", "type")}
        dialect = load_dialect("ardupilotmega")
        return list(compare(Flight(self.flight()), Flight(self.flight(**changes)), dialect, states))

    def test_nothing_where_nothing_is(self) -> None:
        assert self.rows() == []

    @pytest.mark.parametrize(
        ("changes", "kind", "what"),
        [
            ({"climb": lambda climb: -climb}, "sign", "VFR_HUD.climb"),
            ({"climb": 0.0}, "constant", "VFR_HUD.climb"),
            ({"climb": lambda climb: climb * 100.0}, "value", "VFR_HUD.climb"),
            ({"heading": 180}, "constant", "VFR_HUD.heading"),
            ({"alt": float("nan")}, "constant", "VFR_HUD.alt"),
            ({"every": 2}, "rate", "VFR_HUD"),
            ({"every": 0}, "message", "VFR_HUD"),
        ],
    )
    def test_what_is_wrong_is_found(self, changes: dict[str, Any], kind: str, what: str) -> None:
        assert (kind, what) in {(row.kind, row.what) for row in self.rows(**changes)}

    def test_nothing_is_explained_by_chance(self) -> None:
        assert reason_for("copter", Difference("sign", "VFR_HUD.climb", "with vz", "-1", "+1")) is None
        assert reason_for("px4", Difference("value", "HIGHRES_IMU.zacc", "landing", "-9.8", "9.8")) is None
