"""What probes carry, and what is reckoned from those that come."""

from __future__ import annotations

import itertools
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mesh.quality.cost import UNUSABLE, cost
from mesh.quality.loss import LEAST, WINDOW, Jitter, LossWindow
from mesh.quality.meter import Meter
from mesh.quality.pace import STAMP_BYTES, Pace
from mesh.quality.stamp import CLOCK, MOST_RTT, TRAIN_SIZE, Car, Stamp, clock, unpack
from mesh.quality.throughput import OVER, OVERHEAD, RESOLUTION, Dispersion
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
        throughput=st.none() | st.sampled_from([1.0, 60_000.0, 4e9]),
    )
)
def test_a_stamp_is_read_back_as_it_was_written(stamp: Stamp) -> None:
    assert unpack(stamp.pack()) == stamp


def test_a_trains_messages_are_read_back_and_of_one_size() -> None:
    car = Car(A, 65_535, 7, 8)
    assert len(car.pack()) == TRAIN_SIZE
    assert unpack(car.pack()) == car


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x51",
        Stamp(A, 0.0, 1, 2).pack(),
        Stamp(A, 0.1, 1, 2).pack() + b"x",
        Car(A, 1, 8, 8).pack(),
        Car(A, 1, 0, 8).pack()[:-1],
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


def test_jitter_is_that_of_rfc_3550() -> None:
    jitter, expected = Jitter(), 0.0
    transits = [5.0, 5.01, 5.0, 5.03, 5.0]
    for transit in transits:
        jitter.came(transit)
    for one, other in itertools.pairwise(transits):
        expected += (abs(other - one) - expected) / 16
    assert jitter.value == pytest.approx(expected)
    jitter.came(5.0 - CLOCK / 1e6)  # the sender's clock began again
    assert jitter.value == pytest.approx(expected)


# Throughput.


def come(dispersion: Dispersion, indices: list[int], count: int, rate: float, at: float = 10.0, train: int = 1) -> None:
    for index in indices:
        dispersion.came(Car(B, train, index, count), at + index * (TRAIN_SIZE + OVERHEAD) / rate)


@pytest.mark.parametrize("rate", [5_000.0, 125_000.0, 1_000_000.0])
def test_a_slow_link_spreads_a_train(rate: float) -> None:
    dispersion = Dispersion()
    come(dispersion, list(range(8)), 8, rate)
    assert dispersion.rate == pytest.approx(rate)


def test_lost_messages_lower_the_figure_and_a_lost_end_is_waited_for() -> None:
    dispersion = Dispersion()
    come(dispersion, [0, 2, 3, 6], 8, 60_000.0)
    assert dispersion.rate is None
    dispersion.settle(10.1 + OVER / 2)
    assert dispersion.rate is None
    dispersion.settle(10.2 + OVER)
    assert dispersion.rate == pytest.approx(30_000.0)


def test_one_message_says_nothing_and_a_fast_link_no_more_than_can_be_timed() -> None:
    dispersion = Dispersion()
    come(dispersion, [7], 8, 1e3)
    assert dispersion.rate is None
    come(dispersion, list(range(8)), 8, 1e12, train=2)
    assert dispersion.rate == pytest.approx(7 * (TRAIN_SIZE + OVERHEAD) / RESOLUTION)


def test_what_disturbed_one_train_is_forgotten_with_the_next() -> None:
    dispersion = Dispersion()
    for train, rate in enumerate([50_000.0, 20_000.0, 49_000.0, 48_000.0, 47_000.0]):
        come(dispersion, list(range(8)), 8, rate, at=10.0 * train, train=train)
    assert dispersion.rate == pytest.approx(49_000.0)


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
    period = pace.stamps(neighbours, budget)
    count, every = pace.trains(neighbours, budget)
    assert neighbours * STAMP_BYTES / period <= 1.001 * pace.share * budget or period == pace.slowest
    assert neighbours * count * (TRAIN_SIZE + OVERHEAD) / every <= 1.001 * pace.share * budget
    assert count * (TRAIN_SIZE + OVERHEAD) <= pace.train_part * budget
    assert neighbours / period <= max(pace.per_host, neighbours / pace.slowest)


def test_a_train_is_no_longer_than_a_setpoint_can_wait() -> None:
    """What a link without a budget takes is found by two messages first."""
    pace, size = Pace(), TRAIN_SIZE + OVERHEAD
    assert pace.trains(1, None) == (2, pace.train_every)
    assert pace.trains(1, None, 1e6) == (pace.train, pace.train_every)
    count, every = pace.trains(1, None, 60e3)
    assert (count, count * size <= pace.train_part * 60e3) == (5, True)
    assert every >= count * size / (pace.share * 60e3)
    count, every = pace.trains(1, None, 2e3)
    assert count == 2
    assert every == pytest.approx(2 * size / (pace.share * 2e3))
    assert pace.trains(1, 10e3, 1e6)[0] == 0  # a budget says what there is


def quality(**figures: object) -> wire.NeighbourQuality:
    known = {"t": 0.0, "name": "b", "router": "a", "peer": "b", "url": "udp/1.2.3.4:5", "state": "up", **figures}
    return wire.NeighbourQuality(**known)  # type: ignore[arg-type]


def test_the_better_link_costs_less() -> None:
    ethernet = cost(quality(rtt_min=0.0004, throughput_in=1e7, throughput_out=1e7, loss_in=0.0))
    wifi = cost(quality(rtt_min=0.003, throughput_in=2e6, throughput_out=1e6, loss_in=0.05, loss_out=0.02))
    lossy = cost(quality(rtt_min=0.003, throughput_in=2e6, throughput_out=1e6, loss_in=0.5, loss_out=0.02))
    lte = cost(quality(rtt_min=0.06, throughput_in=1e6, throughput_out=5e5))
    serial = cost(quality(rtt_min=0.2, throughput_in=5e3, throughput_out=5e3))
    assert 1 <= ethernet < wifi < lossy < lte < serial < UNUSABLE
    assert cost(quality(loss_in=1.0)) == cost(quality(state="down")) == cost(quality(state="silent")) == UNUSABLE


def test_the_cost_is_the_time_of_a_kilobyte_with_its_repeats() -> None:
    known = quality(rtt_min=0.02, throughput_in=102_400.0, throughput_out=1e6, loss_in=0.2, loss_out=0.5)
    assert cost(known) == round((0.01 + 0.01) / 0.4 / 1e-5)
