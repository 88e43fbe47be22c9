"""A setpoint stream that is torn: does the vehicle hold in time, and does the next lease fly?

    python tests/bench/torn_stream.py [LINK] [--torn agent,companion] [--gaps 0.3,0.7,1.5,5] [--rounds 10] [--json]

LINK is an autopilot's, as for ``zmav up``, ready to fly and with room around it; without it a simulated PX4 flies.
The stream is torn in two ways: the agent says nothing for so long, and the companion is stopped (SIGSTOP), ladder and
all, so that the autopilot itself misses the stream. After each gap the agent goes on where its lease still stands, and
then a new lease flies.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import signal
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import zmav
from tests.bench._load import end
from zmav import wire
from zmav.errors import ZmavError
from zmav.process import free_port
from zmav.sim import VehicleSpec, World

HEIGHT, SPEED = 12.0, 1.5
STREAM, RATE = 1.5, 20.0
SETTLED = 3.0
"""s in which a vehicle that was stopped has come to rest"""
MOVES = 0.5
"""m/s from which it flies what it is told"""


class Flight:
    """One vehicle in the air, and its companion's process."""

    def __init__(self, vehicle: zmav.Vehicle, companion: subprocess.Popen[bytes]) -> None:
        self.vehicle, self.companion = vehicle, companion
        self.modes: list[tuple[float, str | None]] = []
        self.way = 1.0
        self.lowest = HEIGHT

    @property
    def state(self) -> wire.VehicleState:
        """The last one, however old: a stopped companion says nothing."""
        state = self.vehicle.last_state
        assert state is not None
        return state

    def watch(self) -> None:
        """Note each mode and when it came, and the lowest height."""
        state = self.state
        if not self.modes or self.modes[-1][1] != state.mode:
            self.modes.append((time.monotonic(), state.mode))
        if state.position is not None:
            self.lowest = min(self.lowest, state.position.alt_rel)

    async def _for(self, seconds: float, act: Callable[[], object] = lambda: None) -> None:
        end_at = time.monotonic() + seconds
        while time.monotonic() < end_at:
            act()
            self.watch()
            await asyncio.sleep(1.0 / RATE)

    async def stream(self, lease: zmav.Lease, seconds: float) -> tuple[float | None, float]:
        """ms until the mode follows, and the greatest speed over the ground; None: it does not."""
        begun, guided, speeds = time.monotonic(), list[float](), [0.0]

        def put() -> None:
            if lease.lost is None:
                lease.setpoint(vel=(SPEED * self.way, 0.0, 0.0))
            if self.state.mode in ("OFFBOARD", "GUIDED"):
                guided.append(1e3 * (time.monotonic() - begun))
            north, east, _ = self.state.velocity or (0.0, 0.0, 0.0)
            speeds.append(abs(complex(north, east)))

        await self._for(seconds, put)
        return (guided[0] if guided else None), max(speeds)

    async def silence(self, gap: float) -> None:
        await self._for(gap)

    async def freeze(self, gap: float) -> None:
        os.kill(self.companion.pid, signal.SIGSTOP)
        try:
            await asyncio.sleep(gap)
        finally:
            os.kill(self.companion.pid, signal.SIGCONT)

    async def round(self, tear: Callable[[float], Awaitable[None]], gap: float) -> dict[str, Any]:
        """One torn stream; what came of it."""
        vehicle, found = self.vehicle, dict[str, Any]()
        self.lowest = height = self.state.position.alt_rel if self.state.position else HEIGHT
        stopped = time.monotonic()
        with contextlib.suppress(ZmavError):
            async with vehicle.lease("torn", ttl=30.0) as lease:
                found["engaged_ms"], _ = await self.stream(lease, STREAM)
                torn = time.monotonic()
                await tear(gap)
                went_on, _ = await self.stream(lease, STREAM)
                found["went_on"] = went_on is not None and lease.lost is None
                left = [t for t, mode in self.modes if t > torn and mode not in ("OFFBOARD", "GUIDED")]
                found["left_ms"] = 1e3 * (left[0] - torn) if left else None
                stopped = time.monotonic()
        await self._for(SETTLED)
        found["held_ms"] = next((1e3 * (t - stopped) for t, m in self.modes if t > stopped and m == "HOLD"), None)
        north, east, down = self.state.velocity or (0.0, 0.0, 0.0)
        found["still"] = self.state.mode in ("HOLD", "GUIDED") and abs(complex(north, east)) + abs(down) < MOVES
        self.way = -self.way
        try:
            async with vehicle.lease("next", ttl=30.0) as lease:
                found["next_ms"], speed = await self.stream(lease, STREAM)
                found["next_flew"] = lease.lost is None and speed > MOVES
                if not found["next_flew"]:
                    found["why"] = str(lease.lost)
        except ZmavError as e:
            found |= {"next_flew": False, "why": str(e)}
        await self._for(SETTLED)
        found["sank"] = height - self.lowest
        return found


async def measure(
    endpoint: str, companion: subprocess.Popen[bytes], kinds: list[str], gaps: list[float], rounds: int
) -> list[dict[str, Any]]:
    await _answers(endpoint)
    async with zmav.open(connect=[endpoint]) as z:
        (vehicle,) = await z.wait_for("torn1", timeout=60.0)
        await vehicle.wait_until(lambda s: bool(s.connected and s.ready), 90.0)
        await vehicle.arm()
        await vehicle.takeoff(HEIGHT)
        flight, table = Flight(vehicle, companion), []
        tears = {"agent": flight.silence, "companion": flight.freeze}
        for what, tear in ((kind, tears[kind]) for kind in kinds):
            for gap in gaps:
                found = [await flight.round(tear, gap) for _ in range(rounds)]
                table.append(_row(what, gap, found))
                print(_line(table[-1]), file=sys.stderr, flush=True)
        await vehicle.land()
        return table


async def _answers(endpoint: str) -> None:
    """Wait for the companion's router."""
    host, port = endpoint.removeprefix("tcp/").rsplit(":", 1)
    while True:
        with contextlib.suppress(OSError):
            socket.create_connection((host, int(port))).close()
            return
        await asyncio.sleep(0.2)


def _row(what: str, gap: float, found: list[dict[str, Any]]) -> dict[str, Any]:
    def spread(name: str) -> list[int]:
        values = [each[name] for each in found if each.get(name) is not None]
        return [round(statistics.median(values)), round(max(values))] if values else []

    return {
        "torn": what,
        "gap": gap,
        "rounds": len(found),
        "engaged_ms": spread("engaged_ms"),
        "left_ms": spread("left_ms"),
        "went_on": sum(bool(each.get("went_on")) for each in found),
        "still": sum(bool(each.get("still")) for each in found),
        "held_ms": spread("held_ms"),
        "next_flew": sum(bool(each.get("next_flew")) for each in found),
        "next_ms": spread("next_ms"),
        "sank_m": round(max(each.get("sank", 0.0) for each in found), 2),
        "why": sorted({each["why"] for each in found if "why" in each}),
    }


def _line(row: dict[str, Any]) -> str:
    cells = (f"{name} {value}" for name, value in row.items() if name not in ("torn", "gap", "why") or value)
    return " | ".join(cells)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("link", nargs="?")
    parser.add_argument("--gaps", default="0.3,0.7,1.5,5")
    parser.add_argument("--torn", default="agent,companion")
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    with contextlib.ExitStack() as stack:
        link = args.link
        if link is None:
            world = World([VehicleSpec(autopilot="px4")], endpoint="tcp:127.0.0.1:0", ready_s=1.0)
            link = stack.enter_context(world).urls[0]
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        command = [sys.executable, "-m", "zmav", "up", "--link", link, "--name", "torn1", "-l", endpoint]
        companion = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        stack.callback(end, companion)
        gaps = [float(gap) for gap in args.gaps.split(",")]
        table = asyncio.run(measure(endpoint, companion, args.torn.split(","), gaps, args.rounds))
    for row in table:
        print(json.dumps(row) if args.json else _line(row))


if __name__ == "__main__":
    main()
