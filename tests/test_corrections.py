"""What travels on @fleet/rtcm, and which source is in charge."""

from __future__ import annotations

import contextlib
import os

import pytest

from tests.rtcm import base_at, message
from zmav.corrections import HEADER, MOST, PATIENCE_S, ROOM, Batch, Charge, batches, unpack
from zmav.errors import BadMessage
from zmav.formats.rtcm3 import Message

pytestmark = pytest.mark.unit


def batch(*, instance: int = 1, since: int = 100, priority: int = 0, t: int = 1_000_000, source: str = "gs") -> Batch:
    return Batch(priority, instance, since, t, 0, source, (Message(base_at()), Message(message(1077))))


def test_it_is_read_as_it_was_packed() -> None:
    one = batch(source="ground-1")
    assert unpack(one.pack()) == one


def test_anything_else_is_refused() -> None:
    good = batch().pack()
    for wrong in (
        b"",
        good[:20],
        good[:-1],
        good + b"\0",
        b"xx" + good[2:],
        good[:2] + b"\2" + good[3:],
        good[: HEADER.size + 2],
        good[: HEADER.size - 1] + b"\xff" + good[HEADER.size :],
        good[:8] + b"\xff" * 8 + good[16:],
        bytes(MOST + 1),
    ):
        with pytest.raises(BadMessage):
            unpack(wrong)
    for _ in range(300):
        mixed = bytearray(good)
        mixed[os.urandom(1)[0] % len(good)] ^= 1 + os.urandom(1)[0] % 255
        with contextlib.suppress(BadMessage):
            assert unpack(bytes(mixed)).messages == batch().messages  # the header alone was touched


def test_batches_fit_into_datagrams() -> None:
    messages = [Message(message(1077, size=size)) for size in (400, 500, 300, 1023, 20, 20)]
    found = batches(messages)
    assert [each for part in found for each in part] == messages
    assert [len(part) for part in found] == [2, 1, 1, 2]
    assert all(sum(len(m.data) for m in part) <= ROOM or len(part) == 1 for part in found)


def test_who_has_been_in_charge_for_longest_stays() -> None:
    charge: Charge[Batch] = Charge()
    assert charge.hear(batch(instance=1, since=200), 0.0)
    assert not charge.hear(batch(instance=2, since=300), 0.1)
    assert charge.hear(batch(instance=1, since=200), 1.0)
    assert charge.hear(batch(instance=3, since=100), 1.1), "it was there before, and was not heard"
    assert not charge.hear(batch(instance=1, since=200), 1.2)


def test_a_higher_priority_takes_it_at_once() -> None:
    charge: Charge[Batch] = Charge()
    assert charge.hear(batch(instance=1, since=100), 0.0)
    assert charge.hear(batch(instance=2, since=900, priority=1), 0.1)
    assert not charge.hear(batch(instance=1, since=100), 0.2)


def test_another_takes_over_from_who_is_silent() -> None:
    charge: Charge[Batch] = Charge()
    assert charge.hear(batch(instance=1, since=100), 0.0)
    assert not charge.hear(batch(instance=2, since=200), PATIENCE_S - 0.1)
    assert charge.of(PATIENCE_S - 0.1) is not None
    assert charge.of(PATIENCE_S + 0.1) is None
    assert charge.hear(batch(instance=2, since=200), PATIENCE_S + 0.1)
    assert not charge.hear(batch(instance=1, since=999), PATIENCE_S + 0.2), "it comes back as the younger one"
