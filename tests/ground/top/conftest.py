"""Reports as the screen gets them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from ground.top.report import LeaseReport, NetworkReport, Report, VehicleReport
from zmav import wire
from zmav.doctor.facts import AgentReport, Happening
from zmav.doctor.rules import LEVELS, Reason

Make = Callable[..., VehicleReport]
MakeReport = Callable[..., Report]


@pytest.fixture
def make() -> Make:
    """A vehicle that is well, but for what is given; ``why``: reasons as (level, text)."""

    def make(name: str = "quad1", why: tuple[tuple[Any, str], ...] = (), **more: Any) -> VehicleReport:
        found = [Reason(rule="x", level=level, text=text) for level, text in why]
        usual: dict[str, Any] = {
            "fleet": "demo",
            "presence": "ok",
            "age": 0.2,
            "sysid": 1,
            "kind": "copter",
            "autopilot": "ardupilot",
            "mode": "GUIDED",
            "armed": True,
            "speed": 1.5,
            "battery": 0.9,
            "local": (1.0, 2.0, -10.0),
            "position": wire.GlobalPosition(lat_deg=-35.363261, lon_deg=149.16523, alt_amsl=594.0, alt_rel=10.0),
            "gps": wire.Gps(fix="3D_FIX", satellites=14, hdop=0.8),
            "lease": LeaseReport(holder="planner", ends_in=2.6, priority=0),
            "network": NetworkReport(rtt=0.0021, hops=2, way=["quad0", "x", name], complete=True, weakest=None),
            "events": [Happening(age=3.0, kind="mode", severity="info", text="mode GUIDED")],
        }
        level = LEVELS[max((LEVELS.index(reason.level) for reason in found), default=0)]
        return VehicleReport(name=name, level=level, reasons=found, **(usual | more))

    return make


@pytest.fixture
def report() -> MakeReport:
    def report(*vehicles: VehicleReport, agents: tuple[AgentReport, ...] = ()) -> Report:
        return Report(t=1_800_000_000.0, fleet="demo", router=True, vehicles=list(vehicles), agents=list(agents))

    return report
