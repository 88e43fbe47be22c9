"""The events of the simulated PX4: all have words, and so has what a real one sent."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from tests.sim.yardstick.reading import from_tlog
from zmav.autopilots.px4_events import ARMING_SUMMARY, CHECKS, EVENTS, HEALTH_SUMMARY, MODE_BITS
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
    ids = [v["id"] for _, name, v in from_tlog(shared_data / "px4.tlog", px4_dialect()) if name == "EVENT"]
    assert [EVENTS[each][1] for each in ids if each not in SUMMARIES | CHECKS.keys()] == [
        "Not armed: a health or arming check fails",
        "Armed",
        "Takeoff to the default height",
        "Off the ground",
        "Failsafe",
        "On the ground",
        "Disarmed",
    ]
    assert [each for each in ids if each in SUMMARIES] == [ARMING_SUMMARY, HEALTH_SUMMARY] * 2


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
