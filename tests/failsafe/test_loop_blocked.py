"""The event loop that everything else lives on is blocked: the watchdog is not."""

from __future__ import annotations

import time
from typing import Any

import pytest

from tests.failsafe.conftest import agent
from tests.services.conftest import StartBench
from zmav.mavlink import decode, parse_frame


def sleep(seconds: float) -> None:
    time.sleep(seconds)


def spin(seconds: float) -> None:
    """Work that never lets go of the interpreter by itself."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        sum(range(1000))


@pytest.mark.parametrize("block", [sleep, spin])
async def test_it_holds_in_time(bench: StartBench, monkeypatch: pytest.MonkeyPatch, block: Any) -> None:
    b = await bench()
    alice = await agent(b)
    sent: list[tuple[float, bytes]] = []
    send = b.vehicle.adapter.send_raw

    def record(data: bytes) -> bool:
        sent.append((time.monotonic(), data))
        return send(data)

    monkeypatch.setattr(b.vehicle.adapter, "send_raw", record)
    await alice.fly()
    block(1.5)
    free = time.monotonic()  # nothing ran on the loop between
    frames = [(at, parse_frame(data, b.peer.dialect)) for at, data in sent]
    told = [(at, decode(frame, b.peer.dialect)) for at, frame in frames if frame.msgid == 84]
    flown = next(at for at, f in told if f["vx"] != 0.0)
    stopped = next((at for at, f in told if f["vx"] == 0.0), free)
    assert stopped < free
    assert stopped - flown > 0.45
