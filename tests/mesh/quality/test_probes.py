"""What probes carry, and what is reckoned from those that come."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mesh.quality.meter import (
    CLOCK,
    LEAST,
    MOST_RTT,
    WINDOW,
    LossWindow,
    Meter,
    Stamp,
    clock,
    unpack,
)
from mesh.quality.probe import STAMP_BYTES, Pace
from mesh.quality.publisher import SENDING, UNUSABLE, cost
from zmav import wire
from zmav.errors import BadInput

A, B = b"aaaaaaaa", b"bbbbbbbb"
U32 = st.integers(0, (1 << 32) - 2)


@given(
    st.builds(
        Stamp,
        source=st.just(A),
        period=st.sampled_from([0.02, 0.25, 5.0]),
        number=U32,
        sent=U32,
        echo=U32,
        held=st.none() | U32,
        loss=st.none() | st.sampled_from([0.0, 0.5, 0.1234, 1.0]),
    )
)
def test_a_stamp_is_read_back_as_it_was_written(stamp: Stamp) -> None:
    assert unpack(stamp.pack()) == stamp


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x51",
        Stamp(A, 0.0, 1, 2).pack(),
        Stamp(A, 0.1, 1, 2).pack() + b"x",
        Stamp(A, 0.1, 1, 2).pack()[:-1],
    ],
)
def test_probes_that_cannot_be_are_refused(data: bytes) -> None:
    with pytest.raises(BadInput):
        unpack(data)


@pytest.mark.parametrize("sent", [0, 5_000_000, CLOCK - 1000])
def test_a_round_trip_is_what_was_not_spent_there(sent: int) -> None:
    back = Stamp(B, 0.25, 1, 0, echo=sent, held=200_000)
    assert back.rtt((sent + 230_000) % CLOCK) == pytest.approx(0.03)
    assert back.rtt((sent + 100_000) % CLOCK) is None  # held for longer than it was away
    assert back.rtt((sent + 200_000 + int(MOST_RTT * 1e6)) % CLOCK) is None
    assert Stamp(B, 0.25, 1, 0).rtt(7) is None


# Loss.


@pytest.mark.parametrize("first", [0, 1, (1 << 32) - 30])
def test_loss_is_the_share_of_numbers_that_did_not_come(first: int) -> None:
    window = LossWindow()
    for n in range(120):
        if n % 4:
            window.came((first + n) % (1 << 32))
    assert window.share() == pytest.approx(0.25)


def test_what_is_late_or_comes_twice_changes_nothing() -> None:
    numbers = [n for n in range(100) if n % 5]
    mixed = LossWindow()
    shuffler = random.Random(5)
    for start in range(0, len(numbers), 8):
        part = numbers[start : start + 8] * 2
        shuffler.shuffle(part)
        for n in part:
            mixed.came(n)
    straight = LossWindow()
    for n in numbers:
        straight.came(n)
    assert mixed.share() == straight.share() == pytest.approx(0.2)


def test_a_number_counts_once_and_an_old_one_never() -> None:
    window = LossWindow()
    assert [window.came(n) for n in (100, 102, 101, 101, 102, 99, 300, 101)] == [
        True,
        True,
        True,
        False,
        False,
        False,
        True,
        False,
    ]


def test_only_the_window_counts_and_too_few_say_nothing() -> None:
    window = LossWindow()
    for n in range(LEAST - 1):
        window.came(n)
    assert window.share() is None
    for n in range(100, 100 + WINDOW):
        window.came(n)
    assert window.share() == 0.0


def test_silence_counts_as_loss_up_to_all_of_it() -> None:
    window = LossWindow()
    for n in range(WINDOW):
        window.came(n)
    assert window.share(WINDOW // 2) == pytest.approx(0.5)
    assert window.share(10 * WINDOW) == 1.0


def test_a_stream_that_begins_again_starts_over() -> None:
    window = LossWindow()
    for n in (*range(1_000_000, 1_000_050), *range(20)):
        window.came(n)
    assert window.share() == 0.0


# One neighbour's meter, against another one over a link made of numbers.


def exchange(seconds: float, lose_there: int, lose_back: int, there: float, back: float) -> tuple[Meter, Meter]:
    """Two meters that stamp each other. Every so manieth is lost (0: none); delays in s; their clocks differ."""
    a, b, ahead = Meter(A, 100.0), Meter(B, 100.0 + 7.0), 7.0
    for n in range(1, int(seconds * 4) + 1):
        now = 100.0 + (n - 1) * 0.25
        stamp = unpack(a.stamp(now, 0.25))
        if not lose_there or n % lose_there:
            b.take(stamp, now + there + ahead)
        stamp = unpack(b.stamp(now + 0.1 + ahead, 0.25))
        if not lose_back or n % lose_back:
            a.take(stamp, now + 0.1 + back)
    return a, b


def test_two_meters_agree_on_an_asymmetric_link() -> None:
    a, b = exchange(20.0, 5, 0, 0.010, 0.050)
    seen_a, seen_b = a.figures(120.0), b.figures(120.0 + 7.0)
    assert seen_a.rtt == pytest.approx(0.060, abs=1e-4)
    assert seen_b.rtt == pytest.approx(0.060, abs=1e-4)
    assert seen_a.loss_out == pytest.approx(0.2, abs=1 / WINDOW)
    assert seen_b.loss_in == pytest.approx(0.2, abs=1 / WINDOW)
    assert (seen_a.loss_in, seen_b.loss_out) == (0.0, 0.0)
    assert not seen_a.silent and not seen_b.silent


def test_a_neighbour_that_says_nothing_more_is_silent_and_its_loss_grows() -> None:
    a, _ = exchange(20.0, 0, 0, 0.01, 0.01)
    later = a.figures(125.0)
    assert later.silent
    assert later.age == pytest.approx(5.14, abs=0.01)
    assert later.loss_in == pytest.approx(20 / WINDOW)
    assert Meter(A, 100.0).figures(100.5).silent is False
    assert Meter(A, 100.0).figures(102.0).silent is True


def test_a_link_that_is_up_again_is_measured_again_and_its_numbers_go_on() -> None:
    a, b = exchange(20.0, 2, 2, 0.01, 0.01)
    a.begin(160.0)
    known = a.figures(160.5)
    assert (known.silent, known.age, known.rtt, known.loss_in, known.loss_out) == (False, None, None, None, None)
    for n in range(10):
        b.take(unpack(a.stamp(160.0 + n / 4, 0.25)), 160.01 + n / 4 + 7.0)
        a.take(unpack(b.stamp(160.1 + n / 4 + 7.0, 0.25)), 160.11 + n / 4)
    assert a.figures(162.4).loss_in == 0.0
    seen = b.figures(162.4 + 7.0)
    assert seen.age == pytest.approx(0.14) and seen.loss_in == pytest.approx(25 / WINDOW)  # it was not up again for b


def test_a_copy_or_an_overtaken_stamp_tells_nothing_new() -> None:
    a = Meter(A, 100.0)
    first, second = (Stamp(B, 0.25, n, clock(50.0 + n / 4), loss=n / 10) for n in (1, 2))
    a.take(second, 100.1)
    a.take(first, 100.2)
    a.take(second, 100.3)
    assert a.heard == 100.1
    assert a.figures(100.4).loss_out == pytest.approx(0.2)


# What it costs.


@pytest.mark.parametrize("budget", [1e3, 1e4, 6e4, 1e6])
@pytest.mark.parametrize("neighbours", [1, 5, 30])
def test_probes_keep_to_their_share_of_a_budget(budget: float, neighbours: int) -> None:
    pace = Pace()
    period = pace.every(neighbours, budget)
    assert neighbours * STAMP_BYTES / period <= 1.001 * pace.share * budget or period == pace.slowest
    assert neighbours / period <= max(pace.per_host, neighbours / pace.slowest)


def quality(**figures: object) -> wire.NeighbourQuality:
    known = {"t": 0.0, "name": "b", "router": "a", "peer": "b", "url": "udp/1.2.3.4:5", "state": "up", **figures}
    return wire.NeighbourQuality(**known)  # type: ignore[arg-type]


def test_the_better_link_costs_less() -> None:
    ethernet = cost(quality(rtt_min=0.0004, loss_in=0.0))
    wifi = cost(quality(rtt_min=0.003, loss_in=0.05, loss_out=0.02))
    lossy = cost(quality(rtt_min=0.003, loss_in=0.5, loss_out=0.02))
    lte = cost(quality(rtt_min=0.06))
    serial = cost(quality(rtt_min=0.2))
    assert 1 <= ethernet < wifi < lossy < lte < serial < UNUSABLE
    assert cost(quality(loss_in=1.0)) == cost(quality(state="down")) == cost(quality(state="silent")) == UNUSABLE


def test_the_cost_is_the_time_of_a_kilobyte_with_its_repeats() -> None:
    known = quality(rtt_min=0.02, loss_in=0.2, loss_out=0.5)
    assert cost(known) == round((0.01 + SENDING) / 0.4 / 1e-5)
