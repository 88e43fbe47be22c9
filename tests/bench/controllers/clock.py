"""(c) How the controller's clock goes beside the autopilot's: what it integrates by, and what it calls time."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np

from tests.bench.controllers import clocked
from tests.bench.controllers.flight import airborne
from tests.bench.controllers.processes import frames_key, signals_key, signals_of
from zmav.errors import Stale
from zmav.mavlink import decode, parse_frame

AGENT = "clocked"
SIGNALS_HZ = 250.0
SETTLE = 0.5
"""s after the engagement, and after the orders before it"""


class Clock(msgspec.Struct):
    """Ratios to the autopilot's clock, one a run: 1 where a second of the one is a second of the other."""

    integrated: list[float]
    """of the sum of the controller's dt"""
    stated: list[float]
    """of State.t"""
    host: list[float]
    """of this machine's monotonic clock"""
    seconds: float
    """of a run"""
    broken: int = 0
    """runs that ended before half of their time, and are left out"""


def ratio(ours: Sequence[float], theirs: Sequence[float]) -> float:
    """How fast ``ours`` goes when ``theirs`` goes at one: the slope of the line through all samples (least squares)."""
    x, y = np.array(theirs) - theirs[0], np.array(ours) - ours[0]
    return float(np.polyfit(x, y, 1)[0])


class _Clocks:
    """What the clocks show: whenever the controller tells its signals, and whenever an attitude comes."""

    def __init__(self, dialect: Any) -> None:
        self._dialect = dialect
        self.rows: list[tuple[float, float, float]] = []
        """the sum of dt, State.t, and the autopilot's time since its boot, at each signal"""
        self.boots: list[tuple[float, float]] = []
        """monotonic s at which each attitude came, and the autopilot's time"""
        self.listened = {signals_key(AGENT): self._on_signals, frames_key("ATTITUDE_QUATERNION"): self._on_attitude}

    def _on_signals(self, sample: Any) -> None:
        values = signals_of(sample).values
        if "clock" in values:
            self.rows.append((values["clock"], values["state_t"], self.boots[-1][1] if self.boots else 0.0))

    def _on_attitude(self, sample: Any) -> None:
        now = time.monotonic()
        frame = parse_frame(sample.payload.to_bytes(), self._dialect)
        self.boots.append((now, decode(frame, self._dialect)["time_boot_ms"] * 1e-3))


async def measure(runs: int, seconds: float) -> Clock:
    """Of so many engagements of :class:`~tests.bench.controllers.clocked.Clocked` in one flight."""
    found = Clock([], [], [], seconds)
    async with airborne() as run:
        run.run_controller(clocked.__file__, AGENT)
        await run.ready(AGENT)
        await run.vehicle.tell(AGENT, "set", name="signals_hz", value=SIGNALS_HZ)
        for _ in range(runs):
            await run.engage(AGENT)
            await asyncio.sleep(SETTLE)
            clocks = _Clocks(run.z.dialect)
            with run.listening(clocks.listened):
                await asyncio.sleep(seconds)
            await run.vehicle.tell(AGENT, "release")
            rows = [row for row in clocks.rows if row[2] > 0.0]
            if len(rows) < seconds * SIGNALS_HZ / 2:
                found.broken += 1  # the guard ended it on a machine that stood still
                continue
            sums, stated, boots = zip(*rows, strict=True)
            came, theirs = zip(*clocks.boots, strict=True)
            found.integrated.append(ratio(sums, boots))
            found.stated.append(ratio(stated, boots))
            found.host.append(ratio(came, theirs))
    if not found.host:
        raise Stale(f"none of {runs} engagements lasted half of {seconds:g} s")
    return found
