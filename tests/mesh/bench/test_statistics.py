"""What the receiver counts, against datagrams whose times and numbers are known."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mesh.bench.pinger import Clock
from mesh.bench.statistics import SECOND, Samples, Tally
from zmav.wire.bench import Pong

MS = 1_000_000
PERIOD = 10 * MS
START = 5 * SECOND


def tally(total: int = 1000, gap: int = 100 * MS) -> Tally:
    return Tally(total, PERIOD, gap)


def send(to: Tally, number: int, transit: int = 3 * MS) -> None:
    """The datagram of that number, sent at its time."""
    sent = START + number * PERIOD
    to.take(number, sent, 100, sent + transit)


def test_seconds_and_the_whole_of_a_steady_stream() -> None:
    found = tally()
    for number in range(250):
        send(found, number)
    seconds = found.intervals(START + 3 * MS + 3 * SECOND, 0)
    assert [(each.start, each.end, each.received, each.expected, each.bytes) for each in seconds] == [
        (0.0, 1.0, 100, 100, 10_000),
        (1.0, 2.0, 100, 100, 10_000),
        (2.0, 3.0, 50, 50, 5_000),
    ]
    whole = found.total()
    assert whole is not None
    assert (whole.end, whole.bytes, whole.received, whole.lost, whole.jitter) == (2.5, 25_000, 250, 0, 0.0)
    assert whole.transit is not None
    assert whole.transit.median == pytest.approx(0.003)
    assert found.intervals(START + 3 * SECOND, 2) == seconds[2:]


def test_a_silent_second_is_a_second_of_nothing() -> None:
    found = tally()
    send(found, 0)
    send(found, 250)
    seconds = found.intervals(START + 3 * MS + 3 * SECOND, 0)
    assert [(each.received, each.expected) for each in seconds] == [(1, 1), (0, 0), (1, 250)]


def test_jitter_is_that_of_rfc_3550() -> None:
    found, expected, before = tally(), 0.0, None
    for number, transit in enumerate((3, 7, 4, 4, 20, 1)):
        send(found, number, transit * MS)
        if before is not None:
            expected += (abs(transit - before) - expected) / 16
        before = transit
    whole = found.total()
    assert whole is not None
    assert whole.jitter == pytest.approx(expected / 1000)
    assert expected > 1


def test_lost_and_overtaken_are_told_apart() -> None:
    found = tally()
    for number in (0, 1, 4, 2, 5):  # 3 is lost, 2 was overtaken
        send(found, number, (9 - number) * PERIOD)  # whatever the order says, they come one after another
    whole = found.total()
    assert whole is not None
    assert (whole.received, whole.expected, whole.lost) == (5, 6, 1)
    assert whole.bytes == 500


def test_what_cannot_be_of_the_run_costs_no_memory() -> None:
    found = tally(total=10)
    send(found, 10)
    found.take(2**32 - 1, START, 100, START)
    assert found.total() is None


def test_outages_have_a_start_a_length_and_what_was_lost() -> None:
    found = tally()
    for number in (*range(100), *range(150, 200), 205, 206):
        send(found, number)
    (outage,) = found.outages(0)
    assert outage.start == pytest.approx(0.99)
    assert outage.length == pytest.approx(0.51)
    assert outage.lost == 50
    assert found.outages(1) == []


def test_of_very_many_durations_the_last_are_kept_and_the_spread_is_theirs() -> None:
    samples = Samples(most=1000)
    for value in range(100_000):
        samples.add(value * MS)
    spread = samples.spread()
    assert spread is not None
    assert spread.count == 1000
    assert [spread.min, spread.max] == pytest.approx([99.0, 99.999])
    assert spread.median == pytest.approx(99.5, rel=0.001)
    assert Samples().spread() is None


def pong(came: int, left: int, t: float = 0.0) -> Pong:
    return Pong(host="quad2", zid="1", came_ns=came, left_ns=left, t=t)


def test_clocks_are_compared_by_the_quickest_exchange() -> None:
    clock, ahead = Clock(), 100 * SECOND
    for there, back in ((40, 2), (3, 3), (2, 30)):  # ms; only the second way is even
        left = START
        came = left + there * MS
        answered = came + 5 * MS
        trip = clock.add(left, pong(came + ahead, answered + ahead), answered + back * MS, 0.0)
        assert trip == pytest.approx((there + back) / 1000)
    found = clock.read()
    assert found is not None
    assert found.offset == pytest.approx(100.0)
    assert found.within >= 0.003


@settings(max_examples=40)
@given(there=st.integers(0, SECOND), back=st.integers(0, SECOND), ahead=st.integers(-(10**15), 10**15))
def test_the_stated_error_holds_however_uneven_the_ways_are(there: int, back: int, ahead: int) -> None:
    clock = Clock()
    came = START + there
    clock.add(START, pong(came + ahead, came + ahead), came + back, 0.0)
    found = clock.read()
    assert found is not None
    assert abs(found.offset - ahead / SECOND) <= found.within + 1e-6


def test_a_clock_of_the_day_that_jumps_changes_no_delay() -> None:
    clock = Clock()
    clock.add(START, pong(START + MS, START + MS, t=1e9), START + 2 * MS, 1e9)
    before = clock.read()
    clock.add(START + SECOND, pong(START + SECOND + MS, START + SECOND + MS, t=2e9), START + SECOND + 2 * MS, 1e9)
    after = clock.read()
    assert before is not None and after is not None
    assert after.offset == before.offset == 0.0
    assert after.utc_offset == pytest.approx(1e9)
