"""(b) The round trip: from the pilot's stick at the autopilot's link to its effect on the controller's output, in the
key space and all the way back at the link. The paper has 1235 µs on the mean for a pilot's command to its effect.
"""

from __future__ import annotations

import asyncio
import math
import time
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from agents.controllers.bench import echo
from agents.controllers.bench.fake import FakeAutopilot, stick_of
from agents.controllers.bench.processes import FLEET, VEHICLE, Processes, Rig, fleet_file, free_port, rig
from zmav import keys, wire
from zmav.mavlink import decode, parse_frame

import socket

AGENT = "echo"
FULL_DPS = 220.0
"""deg/s of the full stick, the supervisor's own default"""
ECHO = echo.__file__


class Spread(msgspec.Struct):
    """Of times in µs."""

    count: int
    median: float
    mean: float
    p99: float
    most: float


class Trip(msgspec.Struct):
    """Each from the moment in which the autopilot's stick went out."""

    output: Spread
    """to the output in the key space, as a subscriber hears it"""
    back: Spread
    """to the frame at the autopilot's link"""
    waits: Spread
    """as ``back``, where the stick moves at any moment of a cycle"""
    split: dict[str, Spread]
    """stage by stage, each from the one before; from an attitude to the frame at the link"""


def spread(times: list[float]) -> Spread:
    """Of seconds."""
    row = np.array(times) * 1e6
    return Spread(
        len(row), float(np.median(row)), float(row.mean()), float(np.quantile(row, 0.99)), float(row.max())
    )


class Taps:
    """Subscribers of ours that note when what passes in the key space, by the roll stick it was made from."""

    def __init__(self, run: Rig) -> None:
        session, self._dialect = run.z.session, run.z.dialect
        self.heard: dict[int, float] = {}
        """RC_CHANNELS"""
        self.attitudes: dict[int, float] = {}
        """by time_boot_ms"""
        self.controller: dict[int, tuple[float, float]] = {}
        """when the controller began, and µs from its cycle's beginning to the put"""
        self.put: dict[int, float] = {}
        fields = {"fleet": FLEET, "vehicle": VEHICLE}
        self._subscribers = [
            session.declare_subscriber(keys.SETPOINT.key(FLEET, VEHICLE, agent=AGENT), self._on_setpoint),
            session.declare_subscriber(keys.AGENT_OUT.key(FLEET, VEHICLE, agent=AGENT, topic="signals"), self._on_signals),
            session.declare_subscriber(keys.RX.key(FLEET, VEHICLE, sys="*", comp="1", msg="RC_CHANNELS"), self._on_rc),
        ]

    def close(self) -> None:
        for each in self._subscribers:
            each.undeclare()

    def _on_setpoint(self, sample: Any) -> None:
        now = time.monotonic()
        point = wire.decode(sample.payload.to_bytes(), wire.Setpoint, "setpoint")
        if point.rates is not None:
            self.put[stick_of(point.rates[0], math.radians(FULL_DPS))] = self.put.get(
                stick_of(point.rates[0], math.radians(FULL_DPS)), now)

    def _on_signals(self, sample: Any) -> None:
        values = wire.decode(sample.payload.to_bytes(), wire.Signals, "signals").values
        roll = round(1500 + 500 * values["roll"])
        self.controller.setdefault(roll, (values["begun"], values["took_us"]))

    def _on_rc(self, sample: Any) -> None:
        now = time.monotonic()
        frame = parse_frame(sample.payload.to_bytes(), self._dialect)
        self.heard.setdefault(decode(frame, self._dialect)["chan1_raw"], now)
