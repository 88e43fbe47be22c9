"""The way back to the autopilot: from what ends a controller's flight to the autopilot's being told to fly, and to the
last output that reaches it. Measured where it counts, at the autopilot's end of the link.
"""

from __future__ import annotations

import asyncio
import os
import signal
import time
from collections.abc import Callable
from typing import Any

import msgspec

from tests.bench.controllers.echo import HANGS, IS_NOT_FINITE, RAISES
from tests.bench.controllers.fake import OFFBOARD, FakeAutopilot
from tests.bench.controllers.processes import START, Rig, signals_key, signals_of
from tests.bench.controllers.spread import Spread, spread
from tests.bench.controllers.trip import AGENT, engage
from zmav.errors import TimedOut

KINDS = {"the pilot's switch": 0, "killed with -9": 0, "raises": RAISES, "hangs": HANGS, "gives nan": IS_NOT_FINITE}
SWITCH, KILLED = tuple(KINDS)[:2]
STREAM = 0.25
"""s that it flies before, at least; a random part of a cycle more by the sticks' own moments"""
QUIET = 0.3
"""s after the hand-back in which a late output would be seen"""


class Back(msgspec.Struct):
    """µs from what ended it: the pilot's or the failing RC_CHANNELS at the link, or the kill."""

    told: Spread
    """to MAV_CMD_DO_SET_MODE at the link"""
    last: Spread
    """to the last output at the link; less than nothing where none came any more"""


async def measure(run: Rig, fake: FakeAutopilot, rounds: int) -> dict[str, Back]:
    """Of each of :data:`KINDS`; before anything had the supervisor be patient."""
    found: dict[str, Back] = {}
    fake.at_once = False
    process = _Process()
    with run.listening({signals_key(AGENT): process.take}):
        for kind, fails in KINDS.items():
            await run.vehicle.tell(AGENT, "set", name="fails", value=fails)
            rows = [await _once(run, fake, process, kind) for _ in range(rounds)]
            found[kind] = Back(spread(row[0] for row in rows), spread(row[1] for row in rows))
    await run.vehicle.tell(AGENT, "set", name="fails", value=0)
    return found


async def _once(run: Rig, fake: FakeAutopilot, process: _Process, kind: str) -> tuple[float, float]:
    """s to the mode, and to the last output."""
    await _fly(run, fake, process)
    fake.modes.clear()
    if kind == KILLED:
        began = time.monotonic()
        os.kill(process.pid, signal.SIGKILL)
    else:
        before = fake.moved
        fake.switch, fake.full_yaw = kind == SWITCH, kind != SWITCH
        await _until(lambda: fake.moved > before, "the stick moves")
        began = fake.moved
    try:
        await _until(lambda: any(mode != OFFBOARD for _, mode in list(fake.modes)), f"{kind}: the autopilot is told")
        await asyncio.sleep(QUIET)
    finally:
        fake.switch = fake.full_yaw = False
    told = next(at for at, mode in fake.modes if mode != OFFBOARD)
    await run.vehicle.wait_until(lambda state: state.pilot is None and state.lease is None, START)
    return told - began, fake.came[-1].at - began


async def _fly(run: Rig, fake: FakeAutopilot, process: _Process) -> None:
    """Have it fly for a while; again where it was late by itself, as one that was just loaded is on a busy machine."""
    deadline = time.monotonic() + START
    while True:
        process.pid = 0
        await engage(run)
        await asyncio.sleep(STREAM)
        await _until(lambda: process.pid > 0, "the controller flies")
        if fake.mode == OFFBOARD:
            return
        if time.monotonic() > deadline:
            raise TimedOut(f"the controller does not fly for {STREAM:g} s without being late")


async def _until(true: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + START
    while not true():
        if time.monotonic() > deadline:
            raise TimedOut(f"{what}: not within {START:g} s")
        await asyncio.sleep(0.002)


class _Process:
    """Which process the controller is in, by its own signals."""

    pid = 0

    def take(self, sample: Any) -> None:
        self.pid = round(signals_of(sample).values.get("process", 0))
