"""Reports of health and arming checks, of autopilots whose file of events says what it likes."""

from __future__ import annotations

import json
import lzma
import math
import struct

import pytest

from zmav.mavlink.event import Event, EventWords, Worded
from zmav.services.status.px4_events import Checks

ARMING, HEALTH, CHECK = 1, 2, 3


def words() -> EventWords:
    """Of a file whose summaries and checks are all floats."""

    def template(name: str, kind: str, floats: int) -> dict[str, object]:
        return {"name": name, "message": name, "type": kind, "arguments": [{"type": "float"}] * floats}

    groups = {
        "arming_check": {"events": {str(ARMING): template("arming", "summary", 5), str(CHECK): template("bad", "", 1)}},
        "health": {"events": {str(HEALTH): template("health", "summary", 1)}},
    }
    component = {"namespace": "px4", "event_groups": groups}
    return EventWords.unpack(lzma.compress(json.dumps({"version": 2, "components": {"1": component}}).encode()))


def heard(number: int, *values: float) -> Worded:
    worded = words().of(Event(1 << 24 | number, 0, 0, 3, 3, struct.pack(f"<{len(values)}f", *values)))
    assert worded is not None
    return worded


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_report_of_no_numbers_is_whole_and_stands_against_nothing(value: float) -> None:
    checks = Checks()
    checks.hear(heard(ARMING, *[value] * 5))
    assert checks.hear(heard(CHECK, value))
    checks.hear(heard(HEALTH, value))
    assert checks.known
    assert checks.against(1) == []
    assert checks.against(None) == ["bad"]
