"""Callbacks on the thread that reads the network."""

from __future__ import annotations

import os
import threading
from typing import TYPE_CHECKING

import pytest
import zenoh

from zmav.direct import direct
from zmav.session import RUNTIME

if TYPE_CHECKING:
    from tests.conftest import Net

COUNT = 200
PATIENCE_S = 30.0
KEY = "zmav/raw/direct"


async def test_samples_come_in_order_on_threads_whose_state_is_kept(net: Net) -> None:
    """What a thread remembers goes with its Python state: that is not made again for each sample."""
    router, endpoint = net.router()
    session = net.ground(endpoint).session
    local, over = threading.local(), threading.Event()
    came: list[int] = []
    threads: set[int] = set()
    states = 0

    def take(sample: zenoh.Sample) -> None:
        nonlocal states
        states += not hasattr(local, "known")
        local.known = True
        threads.add(threading.get_ident())
        came.append(int(sample.payload.to_string()))
        if len(came) == COUNT:
            over.set()

    subscriber = session.declare_subscriber(KEY, direct(take))
    await net.linked(router, KEY)
    for number in range(COUNT):
        router.put(KEY, str(number), congestion_control=zenoh.CongestionControl.BLOCK)
    assert over.wait(PATIENCE_S)
    subscriber.undeclare()
    assert came == list(range(COUNT))
    assert states <= 2 * len(threads)  # the first call on a thread still had one of its own


def test_the_end_is_told(net: Net) -> None:
    _, endpoint = net.router()
    over = threading.Event()
    net.ground(endpoint).session.declare_subscriber(KEY, direct(lambda sample: None, over.set)).undeclare()
    assert over.wait(PATIENCE_S)


def test_a_client_s_threads_are_not_left_for_processes_that_it_starts(
    net: Net, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(RUNTIME, raising=False)
    _, endpoint = net.router()
    net.ground(endpoint)
    assert RUNTIME not in os.environ
    monkeypatch.setenv(RUNTIME, "(rx: (worker_threads: 1))")
    net.ground(endpoint)
    assert os.environ[RUNTIME] == "(rx: (worker_threads: 1))"
