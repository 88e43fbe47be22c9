"""What the recorder keeps in memory for questions."""

from __future__ import annotations

from ground.record.decoder import Decoder
from ground.record.history import RING, ROOM, History
from ground.record.part import Route, asked_of
from zmav.mavlink import load_dialect

LATER = 1 << 62
"""ns UTC, after the memory's own beginning"""


def ms(number: int) -> int:
    """ns UTC of an entry."""
    return LATER + number * 1_000_000


def test_as_many_entries_of_a_key_are_kept_as_it_says_however_large_they_are() -> None:
    dialect, key = load_dialect(), "zmav/demo/quad1/event"
    history = History(Decoder(dialect))
    route = Route(key, dialect)
    history.add_all([(route, ms(at), b'"%s"' % (b"x" * 1000)) for at in range(1, RING + 11)])
    entries, whole_from = history.newest(asked_of(key), 0, ms(RING + 11), 2 * RING)
    assert len(entries) == RING
    assert entries[0].t == ms(11) / 1e9
    assert whole_from == ms(10) + 1


def test_large_values_under_many_keys_take_no_more_than_the_room() -> None:
    dialect, large = load_dialect(), bytes(4 << 20)
    history = History(Decoder(dialect))
    routes = [Route(f"zmav/demo/quad{n}/event", dialect) for n in range(2 * ROOM // len(large))]
    small = Route("zmav/demo/small/event", dialect)
    history.add_all([(route, ms(1), large) for route in routes])
    history.add_all([(small, ms(at), b"1") for at in (2, 3)])
    held = [history.newest(asked_of(route.key), 0, ms(1), 1) for route in routes]
    assert (ROOM // len(large)) - 1 <= sum(bool(entries) for entries, _ in held) <= ROOM // len(large)
    assert all(entries or whole_from > ms(1) for entries, whole_from in held), "what was let go is told"
    (last,), _ = history.newest(asked_of(small.key), 0, ms(3), 1)
    assert (last.t, last.value) == (ms(3) / 1e9, 1), "there is room for what is small"


def test_a_full_memory_keeps_the_last_of_new_and_of_rare_keys() -> None:
    dialect, size = load_dialect(), 1 + ROOM // RING // 4
    history = History(Decoder(dialect))
    rare, *busy, new = [Route(f"zmav/demo/quad{n}/event", dialect) for n in range(6)]

    def put(route: Route, size: int, at: int) -> None:
        history.add_all([(route, ms(at), bytes(size))])

    def held(route: Route) -> list[int]:
        entries, _ = history.newest(asked_of(route.key), 0, ms(10 * RING), RING)
        return [round((entry.t - LATER / 1e9) * 1e3) for entry in entries]

    put(rare, 1, 1)
    for at in range(1, RING + 1):
        for route in busy:
            put(route, size, at)
    put(new, 5 * size, RING + 1)
    assert held(new) == [RING + 1]
    put(rare, 9 * size, RING + 2)
    assert held(rare)[-1] == RING + 2
    assert all(held(route)[-1] == RING for route in busy)
    for at in range(RING + 3, 3 * RING):
        put(new, size, at)
    assert len(held(new)) > RING // 2, "those of a vehicle that is gone make room"
    assert min(len(held(route)) for route in busy) > RING // 2
    assert all(history.newest(asked_of(route.key), 0, ms(1), 1)[1] > ms(1) for route in busy), "what was let go is told"
