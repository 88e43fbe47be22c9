"""Radio channels without a kernel: frames are pushed into taps whose other ends are pipes."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from mesh.lab.channel import Agenda, Air, Channel, Conditions, Deliver
from mesh.lab.relay import Ether, Tap

EVERYBODY = b"\xff" * 6


class Bench:
    """Taps and channels as the relay has them."""

    def __init__(self, count: int) -> None:
        self.agenda, self.channels = Agenda(), dict[int, Channel]()
        self.pipes = [os.pipe2(os.O_NONBLOCK) for _ in range(count)]
        self.taps = [Tap(write, bytes([2, 0, 0, 0, 0, i]), 1518) for i, (_, write) in enumerate(self.pipes)]

    def make(self, number: int, air: Air, deliver: Deliver) -> Channel:
        self.channels[number] = Channel(Conditions(), air, self.agenda, deliver, number)
        return self.channels[number]

    def send(self, sender: int, to: int | None, text: bytes = b"") -> None:
        target = EVERYBODY if to is None else self.taps[to].mac
        self.taps[sender].send(target + self.taps[sender].mac + text, 1.0)

    def heard(self) -> list[int]:
        """Who got a frame since; with a number more than once for each."""
        found = []
        while (due := self.agenda.next()) is not None:
            self.agenda.run(due)
        for i, (read, _) in enumerate(self.pipes):
            try:
                data = os.read(read, 4096)
            except BlockingIOError:
                continue
            found += [i] * (len(data) // 12)
        return found


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench(4)
    yield bench
    for pipe in bench.pipes:
        for fd in pipe:
            os.close(fd)


def ether(bench: Bench, pairs: list[tuple[int, int]], shared: bool = False) -> Ether:
    made = Ether({str(i): tap for i, tap in enumerate(bench.taps)}, shared)
    for i, (a, b) in enumerate(pairs):
        made.add(str(a), str(b), 2 * i, 2 * i + 1, bench.make)
    made.changed()
    return made


def test_only_those_in_range_hear_each_other(bench: Bench) -> None:
    made = ether(bench, [(0, 1), (1, 2), (2, 3)])
    bench.send(1, None)
    assert bench.heard() == [0, 2]
    bench.send(1, 2)
    assert bench.heard() == [2]
    bench.send(0, 3)
    assert bench.heard() == []
    bench.channels[0].set(Conditions(up=False), 1.0)  # 0 is not heard by 1, and hears it
    made.changed()
    bench.send(0, None)
    assert bench.heard() == []
    bench.send(1, None)
    assert bench.heard() == [0, 2]


@pytest.mark.parametrize("shared", [True, False])
def test_a_broadcast_takes_the_air_once_and_at_the_slowest_rate(bench: Bench, shared: bool) -> None:
    made = ether(bench, [(0, 1), (1, 2)], shared)
    for number, rate in ((0, 8000.0), (1, 8000.0), (2, 4000.0), (3, 4000.0)):
        bench.channels[number].set(Conditions(rate=rate), 1.0)
    made.changed()
    bench.send(1, None, bytes(3))  # 15 B to both: 30 ms at 4 kbit/s
    bench.send(0, 1)  # 12 B: 12 ms at 8 kbit/s, after that where the air is one
    dues = bench.agenda.dues()
    assert dues == pytest.approx([1.012, 1.03, 1.03] if not shared else [1.03, 1.03, 1.042])
