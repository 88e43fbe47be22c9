"""What the recorder keeps in memory for questions."""

from __future__ import annotations

from ground.record.decoder import Decoder
from ground.record.history import RING, History
from ground.record.part import Route, asked_of
from zmav.mavlink import load_dialect


def test_as_many_entries_of_a_key_are_kept_as_it_says_however_large_they_are() -> None:
    dialect, key = load_dialect(), "zmav/demo/quad1/event"
    history = History(Decoder(dialect))
    route = Route(key, dialect)
    history.add_all([(route, at, b'"%s"' % (b"x" * 1000)) for at in range(1, RING + 11)])
    entries, whole_from = history.newest(asked_of(key), 0, RING + 11, 2 * RING)
    assert len(entries) == RING
    assert entries[0].t == 11 / 1e9
    assert whole_from >= 11
