"""The words of the simulated PX4's events: all are there, where PX4's lie, and they fit what a real one sent."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.sim.yardstick.reading import from_tlog
from zmav.mavlink.event import Event, EventWords
from zmav.sim.autopilots.px4 import event_words, events, health
from zmav.sim.protocol.px4.node import Px4Node, px4_dialect

if TYPE_CHECKING:
    from tests.sim.px4.conftest import Companion


@pytest.fixture(scope="module")
def words() -> EventWords:
    return EventWords.unpack(event_words.packed())


def event(number: int, arguments: bytes = b"", level: int = 6) -> Event:
    return Event(number, 0, 0, level, level, arguments.ljust(40, b"\0"))


def test_every_event_has_words(words: EventWords) -> None:
    sent = [each for each in vars(events).values() if isinstance(each, events.Event)]
    assert len(sent) > 20
    for each in sent:
        worded = words.of(event(each.id))
        assert worded is not None and "?" not in worded.text, each


def test_every_check_has_words(words: EventWords) -> None:
    source = Path(str(health.__file__)).read_text(encoding="utf-8")
    names = {part.split('"')[0] for part in source.split('"check_')[1:]}
    assert len(names) > 10
    for name in names:
        worded = words.of(event(events.event_id(f"check_{name}")))
        assert worded is not None and worded.group == "arming_check", name


def test_what_a_real_px4_sent_is_understood(words: EventWords, shared_data: Path) -> None:
    """Ids, arguments and their order are PX4's own; only the words are not."""
    told = [v for _, name, v in from_tlog(shared_data / "px4.tlog", px4_dialect()) if name == "EVENT"]
    found = [words.of(event(v["id"], bytes(v["arguments"]), v["log_levels"] & 15)) for v in told]
    texts = [worded.text for worded in found if worded is not None and worded.group == "default"]
    assert texts == [
        "Not armed: a health or arming check fails",
        "Armed, by a command",
        "Takeoff to the default height of 2.50 m",
        "Off the ground",
        "Failsafe: now POSCTL",
        "On the ground",
        "Disarmed, by landing",
    ]
    summaries = [w for w in found if w is not None and w.type == "summary"]
    assert [(w.group, len(w.values)) for w in summaries] == [("arming_check", 5), ("health", 4)] * 2
    assert None not in found


def test_it_lies_where_px4_has_it(companion: Companion) -> None:
    node = companion.vehicle.node
    assert isinstance(node, Px4Node)
    assert node.storage.files.open("/etc/extras/all_events.json.xz", 239) == event_words.packed()


def test_a_report_of_the_checks_can_be_asked_for(companion: Companion) -> None:
    companion.ready()
    companion.world.step(4.0)  # what has changed by then is reported
    companion.clear()
    companion.world.step(4.0)
    assert companion.events() == []
    assert companion.command(401) == [0]
    found = companion.events()
    assert (found[0], found[-1]) == (events.ARMING_SUMMARY.id, events.HEALTH_SUMMARY.id)
    assert events.event_id("check_modes_mission") in found
