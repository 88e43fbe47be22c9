"""Channels, on a clock of the test's own: what is lost, when what is not arrives, and in which order."""

from __future__ import annotations

import itertools
import statistics
from typing import Any

import pytest

from mesh.lab.channel import Agenda, Air, Channel, Conditions

SEED = 7


class Wire:
    """A channel, what arrived by it, and when."""

    def __init__(self, **conditions: Any) -> None:
        self.agenda, self.air = Agenda(), Air()
        self.arrived: list[tuple[float, bytes]] = []
        self.channel = Channel(Conditions(**conditions), self.air, self.agenda, self._on_frame, SEED)

    def _on_frame(self, frame: bytes, now: float) -> None:
        self.arrived.append((now, frame))

    def run(self) -> None:
        """Let everything under way arrive, each frame at its moment."""
        while (due := self.agenda.next()) is not None:
            self.agenda.run(due)

    def stream(self, count: int, every: float = 0.01, size: int = 100, begin: float = 1.0) -> None:
        for i in range(count):
            now = begin + i * every
            while (due := self.agenda.next()) is not None and due <= now:
                self.agenda.run(due)
            self.channel.send(i.to_bytes(4, "big").ljust(size), now)
        self.run()

    def numbers(self) -> list[int]:
        return [int.from_bytes(frame[:4], "big") for _, frame in self.arrived]


def test_without_conditions_frames_arrive_at_once() -> None:
    wire = Wire()
    wire.channel.send(b"a", 5.0)
    assert wire.arrived == [(5.0, b"a")]
    assert wire.agenda.next() is None


def test_delay_and_jitter_stay_within_what_was_asked() -> None:
    wire = Wire(delay=0.1, jitter=0.03)
    wire.stream(2000)
    delays = [now - (1.0 + 0.01 * n) for (now, _), n in zip(wire.arrived, wire.numbers(), strict=True)]
    assert 0.07 <= min(delays) < 0.075
    # A frame waits for the one before it, so that none overtakes: the mean is above the delay, never beyond the rest.
    assert 0.1 < statistics.mean(delays) < 0.12
    assert max(delays) <= 0.1301
    assert wire.numbers() == list(range(2000))


def test_frames_overtake_each_other_only_where_that_is_asked_for() -> None:
    wire = Wire(delay=0.1, jitter=0.03, ordered=False)
    wire.stream(2000)
    assert wire.numbers() != list(range(2000))
    assert sorted(wire.numbers()) == list(range(2000))
    delays = [now - (1.0 + 0.01 * n) for (now, _), n in zip(wire.arrived, wire.numbers(), strict=True)]
    assert statistics.mean(delays) == pytest.approx(0.1, abs=0.002)
    assert statistics.stdev(delays) == pytest.approx(0.03 / 3**0.5, rel=0.05)  # every value as likely as any other


@pytest.mark.parametrize("loss", [0.01, 0.2, 0.7])
def test_loss_by_chance(loss: float) -> None:
    wire = Wire(loss=loss)
    wire.stream(20_000)
    counters = wire.channel.counters
    assert counters.lost / counters.frames == pytest.approx(loss, rel=0.2)
    assert counters.lost + counters.arrived == counters.frames == 20_000
    assert runs_of_loss(wire.numbers()) == pytest.approx(1.0 / (1.0 - loss), rel=0.1)


@pytest.mark.parametrize(("loss", "burst"), [(0.1, 5.0), (0.3, 20.0), (0.6, 3.0)])
def test_loss_in_bursts(loss: float, burst: float) -> None:
    wire = Wire(loss=loss, burst=burst)
    wire.stream(60_000)
    assert 1.0 - len(wire.arrived) / 60_000 == pytest.approx(loss, rel=0.15)
    assert runs_of_loss(wire.numbers()) == pytest.approx(burst, rel=0.15)


def runs_of_loss(arrived: list[int]) -> float:
    """Frames lost in a row, on average."""
    return statistics.mean(b - a - 1 for a, b in itertools.pairwise(arrived) if b > a + 1)


def test_all_is_lost_and_nothing_is_lost() -> None:
    for loss, count in ((1.0, 0), (0.0, 100)):
        wire = Wire(loss=loss, burst=4.0)
        wire.stream(100)
        assert len(wire.arrived) == count


def test_a_rate_spaces_frames_and_its_queue_is_bounded() -> None:
    wire = Wire(rate=80_000.0, queue=1050)  # a frame of 100 B takes 10 ms
    for i in range(30):
        wire.channel.send(bytes([i]) * 100, 1.0)
    wire.run()
    assert [now for now, _ in wire.arrived] == pytest.approx([1.01 + 0.01 * i for i in range(11)])
    assert wire.channel.counters.queue_full == 19
    assert wire.channel.counters.bytes == 3000
    assert wire.channel.counters.arrived_bytes == 1100


def test_a_rate_holds_for_long() -> None:
    wire = Wire(rate=1e6, queue=20_000)
    wire.stream(5000, every=0.0005, size=1000)  # 16 times what fits
    seconds = wire.arrived[-1][0] - 1.0
    assert 8 * wire.channel.counters.arrived_bytes / seconds == pytest.approx(1e6, rel=0.001)


def test_what_waits_is_retimed_when_the_rate_changes() -> None:
    """A second's worth of frames at 80 kbit/s is gone in a tenth of it at ten times the rate, in order."""
    wire = Wire(rate=80_000.0, delay=0.5)
    for i in range(100):
        wire.channel.send(bytes([i]) * 100, 1.0)
    wire.channel.set(Conditions(rate=800_000.0, delay=0.1), 1.0)
    wire.channel.send(bytes([100]) * 100, 1.0)
    wire.run()
    assert [frame[0] for _, frame in wire.arrived] == list(range(101))
    assert wire.arrived[0][0] == pytest.approx(1.101)
    assert wire.arrived[99][0] == pytest.approx(1.2)
    assert wire.arrived[100][0] == pytest.approx(1.201)


def test_no_limit_any_more_lets_go_what_waits() -> None:
    wire = Wire(rate=8000.0)
    for _ in range(10):
        wire.channel.send(bytes(1000), 1.0)
    wire.channel.set(Conditions(), 1.5)
    wire.channel.send(b"last", 1.5)
    wire.run()
    assert wire.arrived[-1] == (1.5, b"last")
    assert len(wire.arrived) == 11


def test_an_outage_takes_what_is_under_way() -> None:
    wire = Wire(delay=1.0)
    wire.channel.send(b"before", 1.0)
    wire.channel.set(Conditions(delay=1.0, up=False), 1.5)
    wire.channel.send(b"during", 1.6)
    wire.channel.set(Conditions(delay=1.0), 1.7)
    wire.channel.send(b"after", 1.8)
    wire.run()
    assert wire.arrived == [(2.8, b"after")]
    assert wire.channel.counters.down == 2


def test_two_channels_that_share_the_air_wait_for_each_other() -> None:
    wire = Wire(rate=80_000.0)
    other = Channel(Conditions(rate=80_000.0), wire.air, wire.agenda, lambda *_: None, SEED)
    other.send(bytes(200), 1.0)
    wire.channel.send(bytes(100), 1.0)
    wire.run()
    assert [now for now, _ in wire.arrived] == pytest.approx([1.03])
    # Both are told of the new rate at one moment, which changes what waits once.
    other.send(bytes(200), 2.0)
    for each in (other, wire.channel):
        each.set(Conditions(rate=160_000.0), 2.0)
    wire.channel.send(bytes(100), 2.0)
    wire.run()
    assert wire.arrived[-1][0] == pytest.approx(2.015)
