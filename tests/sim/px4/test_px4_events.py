"""The events of the simulated PX4: all have words, and so has what a real one sent."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.sim.yardstick.reading import from_tlog
from zmav.autopilots.px4_events import ARMING_SUMMARY, CHECKS, EVENTS, HEALTH_SUMMARY, MODE_BITS, event_text
from zmav.mavlink.event import event_id
from zmav.sim.autopilots.px4 import events, health
from zmav.sim.autopilots.px4.modes import MODES
from zmav.sim.protocol.px4.node import px4_dialect

if TYPE_CHECKING:
    from tests.sim.px4.conftest import Companion

SUMMARIES = {ARMING_SUMMARY, HEALTH_SUMMARY}


def test_every_event_has_words() -> None:
    sent = {each.id for each in vars(events).values() if isinstance(each, events.Event)}
    assert len(sent) > 20
    assert sent - SUMMARIES <= EVENTS.keys()


def test_every_check_has_words() -> None:
    source = Path(str(health.__file__)).read_text(encoding="utf-8")
    names = {part.split('"')[0] for part in source.split('"check_')[1:]}
    assert len(names) > 10
    assert {event_id(f"check_{name}") for name in names} <= CHECKS.keys()


def test_the_modes_have_their_bits() -> None:
    assert {mode.name: mode.number for mode in MODES}.items() <= MODE_BITS.items()


def test_what_a_real_px4_sent_has_words(shared_data: Path) -> None:
    found = [v for _, name, v in from_tlog(shared_data / "px4.tlog", px4_dialect()) if name == "EVENT"]
    ids = [v["id"] for v in found]
    said = [event_text(v["id"], bytes(v["arguments"])) for v in found if v["id"] not in SUMMARIES | CHECKS.keys()]
    assert said == [
        "Not armed: a health or arming check fails",
        "Armed",
        "Takeoff to the default height",
        "Off the ground",
        "Failsafe: now POSCTL",
        "On the ground",
        "Disarmed",
    ]
    assert [each for each in ids if each in SUMMARIES] == [ARMING_SUMMARY, HEALTH_SUMMARY] * 2


@pytest.mark.parametrize(
    ("name", "arguments", "text"),
    [
        ("", "000000000703", "Battery low: now LAND"),
        ("_hold", "0000000006050002", "Ground station lost: HOLD, and RTL in 5 s"),
        ("_warn", "0000000001", "Sticks lost; nothing is done"),
        ("_generic_hold", "00000000060300", "Failsafe: HOLD, and RTL in 3 s"),
        ("_generic", "0000000063", "Failsafe: now action 99"),
        ("", "000000000663", "Failsafe (cause 99): now RTL"),
        ("", "00", "Failsafe"),
    ],
)
def test_a_failsafe_says_why_and_what_px4_does(name: str, arguments: str, text: str) -> None:
    assert event_text(event_id(f"commander_failsafe_enter{name}"), bytes.fromhex(arguments)) == text


def test_a_report_of_the_checks_can_be_asked_for(companion: Companion) -> None:
    companion.ready()
    companion.world.step(4.0)  # what has changed by then is reported
    companion.clear()
    companion.world.step(4.0)
    assert companion.events() == []
    assert companion.command(401) == [0]
    found = companion.events()
    assert (found[0], found[-1]) == (events.ARMING_SUMMARY.id, events.HEALTH_SUMMARY.id)
    assert event_id("check_modes_mission") in found
