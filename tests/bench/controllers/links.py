"""(a) The quality of each stream between the autopilot and the controller: bandwidth, jitter and loss, as the paper's
Table 2 has them (1 Mb/s, jitter 0.49 to 1.37 ms, none of 1785 lost over 20 s).

All is measured where it is used: at a client of the vehicle's router, as the supervisor is one.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import msgspec
import numpy as np

from tests.bench.controllers.flight import airborne, follow
from tests.bench.controllers.processes import FLEET, VEHICLE, Rig, frames_key, signals_key, signals_of
from zmav import keys, wire
from zmav.errors import Stale
from zmav.mavlink import decode, parse_frame

AGENT = "ev1"
NOMINAL = {"ATTITUDE_QUATERNION": 250.0, "LOCAL_POSITION_NED": 250.0, "RC_CHANNELS": 50.0}
"""Hz"""
SETPOINTS, SIGNALS = "setpoints", "signals"
SIGNALS_HZ = 50.0
PAPER = "1 Mb/s, 0.49 to 1.37 ms, 0 of 1785"
SMOOTHING = 16.0
"""RFC 3550, section 6.4.1"""


class Sample(NamedTuple):
    """One that came."""

    at: float
    """monotonic s"""
    sent: float
    """s by the source's clock"""
    size: int
    """bytes, as published"""
    seq: int


class Stream(msgspec.Struct):
    """One stream's figures."""

    count: int
    hz: float
    kbps: float
    """thousand bits a second of what is published, without what carries it"""
    jitter_ms: float
    """by RFC 3550, at the end"""
    late_ms: float
    """p99 of how far an interval is from its nominal one"""
    lost: int | None
    """by sequence numbers; None: it has none of its own"""
    gaps: list[float]
    """ms, the intervals themselves"""


class Links(msgspec.Struct):
    """``frames``, ``frames_lost``: of all the autopilot's frames, which share one sequence (mod 256)."""

    streams: dict[str, Stream]
    seconds: float
    frames: int
    frames_lost: int
    mbps: float
    """million bits a second of all the autopilot's frames and the setpoints"""


def jitter(samples: Sequence[Sample]) -> float:
    """s: RFC 3550's interarrival jitter, J += (|D| - J) / 16, after the last of them."""
    found = 0.0
    for before, now in pairwise(samples):
        change = (now.at - before.at) - (now.sent - before.sent)
        found += (abs(change) - found) / SMOOTHING
    return found


def lost(numbers: Sequence[int], modulus: int = 0) -> int:
    """How many of a sequence did not come: ``modulus`` at which it begins again, 0: never. One out of order counts as
    none where it does not wrap.
    """
    if not modulus:
        return 0 if not numbers else max(numbers) - min(numbers) + 1 - len(set(numbers))
    return sum((now - before - 1) % modulus for before, now in pairwise(numbers))


def stream(samples: Sequence[Sample], nominal_hz: float, numbered: bool) -> Stream:
    """Of samples in the order they came; raises :class:`~zmav.errors.Stale` where there are less than two."""
    if len(samples) < 2:
        raise Stale(f"{len(samples)} of a stream of {nominal_hz:g} Hz came")
    at = np.array([each.at for each in samples])
    gaps = np.diff(at)
    lasted = float(at[-1] - at[0])
    return Stream(
        count=len(samples),
        hz=(len(samples) - 1) / lasted,
        kbps=sum(each.size for each in samples[1:]) * 8e-3 / lasted,
        jitter_ms=1e3 * jitter(samples),
        late_ms=1e3 * float(np.quantile(np.abs(gaps - 1.0 / nominal_hz), 0.99)),
        lost=lost([each.seq for each in samples]) if numbered else None,
        gaps=[round(1e3 * float(gap), 3) for gap in gaps],
    )


class Ear:
    """Hears everything that passes between autopilot and controller."""

    def __init__(self, run: Rig) -> None:
        self._dialect = run.z.dialect
        self.raw: list[tuple[float, bytes]] = []
        """the autopilot's frames"""
        self.samples: dict[str, list[Sample]] = {SETPOINTS: [], SIGNALS: []}
        self.listened = {
            frames_key("*"): self._on_frame,
            keys.SETPOINT.key(FLEET, VEHICLE, agent=AGENT): self._on_setpoint,
            signals_key(AGENT): self._on_signals,
        }

    def _on_frame(self, sample: Any) -> None:
        self.raw.append((time.monotonic(), sample.payload.to_bytes()))

    def _on_setpoint(self, sample: Any) -> None:
        now, data = time.monotonic(), sample.payload.to_bytes()
        point = wire.decode(data, wire.Setpoint, "setpoint")
        # Each is valid for the same time, so that its deadline tells when it was put.
        self.samples[SETPOINTS].append(Sample(now, point.deadline, len(data), point.seq))

    def _on_signals(self, sample: Any) -> None:
        self.samples[SIGNALS].append(Sample(time.monotonic(), signals_of(sample).t, len(sample.payload), 0))

    def links(self) -> Links:
        """What was heard so far."""
        numbers = []
        found = {name: list[Sample]() for name in NOMINAL}
        for at, data in self.raw:
            frame = parse_frame(data, self._dialect)
            numbers.append(frame.seq)
            name = self._dialect.name_of(frame.msgid)
            if name in found:
                sent = decode(frame, self._dialect)["time_boot_ms"] * 1e-3
                found[name].append(Sample(at, sent, len(data), frame.seq))
        streams = {name: stream(rows, NOMINAL[name], False) for name, rows in found.items()}
        streams[SETPOINTS] = stream(self.samples[SETPOINTS], NOMINAL["ATTITUDE_QUATERNION"], True)
        streams[SIGNALS] = stream(self.samples[SIGNALS], SIGNALS_HZ, False)
        seconds = self.raw[-1][0] - self.raw[0][0]
        carried = sum(len(data) for _, data in self.raw) + sum(each.size for each in self.samples[SETPOINTS])
        return Links(
            streams=streams,
            seconds=seconds,
            frames=len(numbers),
            frames_lost=lost(numbers, 256),
            mbps=carried * 8e-6 / seconds,
        )


async def measure(seconds: float) -> Links:
    """Over a flight of EV1 along the lemniscate."""
    async with airborne() as run:
        await run.fly_by("ev1", AGENT)
        await follow(run, AGENT, seconds + 6.0)
        await asyncio.sleep(2.0)
        ear = Ear(run)
        with run.listening(ear.listened):
            await asyncio.sleep(seconds)
        return ear.links()
