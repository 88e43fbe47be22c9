"""What a viewer costs everybody else: when it paints, when the viewer is stopped, and when its painter is.

    python tests/bench/viewer_stall.py [--rounds 2] [--seconds 4] [--vehicles 50] [--json]

One simulated copter behind 'zmav up', and made-up vehicles that say their states five times a second through the same
router. A third party reads ATTITUDE at 50 Hz and all states, and pings the vehicle. Four sides take turns: no viewer,
'zmav view --web' that paints, the same with Rerun's server stopped (SIGSTOP), and with its painter stopped. Ratios are
to no viewer. The memory of 'zmav view' (and of its painter) is its resident set at the end of each turn.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import itertools
import json
import os
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import zenoh

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import zmav
from tests.ports import free_udp_ports
from zmav import keys, wire
from zmav.errors import ZmavError
from zmav.process import free_port
from zmav.vehicle.rates import want_key

ZMAV = [sys.executable, "-m", "zmav"]
SIDES = ("no viewer", "painting", "viewer stopped", "painter stopped")


class Turn(msgspec.Struct):
    """One side's turn."""

    attitude_hz: float
    longest_gap: float
    """s between two frames of ATTITUDE"""
    state_delay: float
    """s, median, of the made-up vehicles' states"""
    state_p99: float
    ping: float
    """s, median round trip to the vehicle"""
    vehicle_hz: float
    """frames a second that the vehicle's own adapter takes from its autopilot"""
    view_mb: float = 0.0
    painter_mb: float = 0.0


class Measure:
    """What the third party sees."""

    def __init__(self, z: zmav.Client, others: int) -> None:
        self._z = z
        self._others = [f"made{i}" for i in range(others)]
        self._frames: list[float] = []
        self._delays: list[float] = []
        self._vehicle_hz = 0.0

    async def start(self) -> None:
        session, fleet = self._z.session, self._z.fleet_name
        key = keys.RX.key(fleet, "quad1", sys="*", comp="*", msg="ATTITUDE")
        session.declare_subscriber(key, lambda _: self._frames.append(time.monotonic()))
        self._token = session.liveliness().declare_token(want_key(key, 50.0, "bench"))
        session.declare_subscriber(keys.STATE.key(fleet, "*"), self._on_state)
        session.declare_subscriber(keys.LINK.key(fleet, "quad1", link="autopilot"), self._on_link)
        self._publishing = asyncio.create_task(self._publish())

    def _on_state(self, sample: zenoh.Sample) -> None:
        now, payload = time.time(), sample.payload.to_bytes()
        if "/made" in str(sample.key_expr):
            self._delays.append(now - float(json.loads(payload)["t"]))

    def _on_link(self, sample: zenoh.Sample) -> None:
        self._vehicle_hz = float(json.loads(sample.payload.to_bytes()).get("rx_rate", 0.0))

    async def _publish(self) -> None:
        step, fleet = 0, self._z.fleet_name
        while True:
            for i, name in enumerate(self._others):
                state = wire.VehicleState(
                    t=time.time(),
                    fleet=fleet,
                    name=name,
                    instance="bench",
                    connected=True,
                    kind="copter",
                    mode="GUIDED",
                    local=(10.0 * i, step % 300, -10.0),
                    velocity=(0.0, 5.0, 0.0),
                    attitude=wire.Attitude(roll=0.0, pitch=0.1, yaw=1.6),
                )
                self._z.put(keys.STATE, keys.STATE.key(fleet, name), state)
            step += 1
            await asyncio.sleep(0.2)

    async def turn(self, seconds: float) -> Turn:
        self._frames.clear()
        self._delays.clear()
        start, pings = time.monotonic(), []
        while time.monotonic() - start < seconds:
            with contextlib.suppress(ZmavError):
                pings.append(await self._z.vehicle("quad1").ping())
            await asyncio.sleep(0.05)
        took, frames, delays = time.monotonic() - start, list(self._frames), sorted(self._delays)
        gaps = [b - a for a, b in itertools.pairwise(frames)]
        return Turn(
            len(frames) / took,
            max(gaps, default=took),
            statistics.median(delays or [0.0]),
            delays[int(0.99 * len(delays))] if delays else 0.0,
            statistics.median(pings or [0.0]),
            self._vehicle_hz,
        )


class View:
    """A ``zmav view --web`` with its painter and Rerun's server."""

    def __init__(self, endpoint: str) -> None:
        command = [*ZMAV, "view", "--web", "--port", str(free_port()), "-e", endpoint]
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE)
        assert self.process.stderr is not None
        if not self.process.stderr.readline().startswith(b"open"):
            raise SystemExit("zmav view did not start")
        (self.painter,) = _children(self.process.pid)
        (self.server,) = _children(self.painter)

    @contextlib.contextmanager
    def stopped(self, side: str) -> Iterator[None]:
        pid = {"viewer stopped": self.server, "painter stopped": self.painter}.get(side)
        if pid:
            os.kill(pid, signal.SIGSTOP)
        try:
            yield
        finally:
            if pid:
                os.kill(pid, signal.SIGCONT)

    def close(self) -> None:
        self.process.terminate()
        self.process.wait()


def _children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def _mb(pid: int) -> float:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


async def run(rounds: int, seconds: float, vehicles: int, endpoint: str) -> dict[str, list[Turn]]:
    turns: dict[str, list[Turn]] = {side: [] for side in SIDES}
    async with zmav.open(connect=[endpoint]) as z:
        await z.wait_for("quad1", timeout=40.0)
        measure = Measure(z, vehicles)
        await measure.start()
        await asyncio.sleep(2.0)
        for number in range(rounds):
            turns[SIDES[0]].append(await measure.turn(seconds))
            view = await asyncio.to_thread(View, endpoint)
            await asyncio.sleep(2.0)
            for side in (SIDES[1:], SIDES[:0:-1])[number % 2]:  # what comes last must not always be the same
                with view.stopped(side):
                    turn = await measure.turn(seconds)
                    turn.view_mb, turn.painter_mb = _mb(view.process.pid), _mb(view.painter)
                    turns[side].append(turn)
            await asyncio.to_thread(view.close)
    return turns


def table(turns: dict[str, list[Turn]]) -> None:
    head = (
        "ATTITUDE Hz",
        "longest gap ms",
        "state ms",
        "state p99 ms",
        "ping ms",
        "vehicle Hz",
        "view MB",
        "painter MB",
    )
    print(f"{'':>22}" + "".join(f"{name:>15}" for name in head))
    rows = {
        side: [statistics.median(values) for values in zip(*map(msgspec.structs.astuple, found), strict=True)]
        for side, found in turns.items()
    }
    for side, row in rows.items():
        scale = (1.0, 1e3, 1e3, 1e3, 1e3, 1.0, 1.0, 1.0)
        print(f"{side:>22}" + "".join(f"{x * k:15.2f}" for x, k in zip(row, scale, strict=True)))
    base = rows[SIDES[0]][:6]
    for side in SIDES[1:]:
        ratios = [b / a if a else 0.0 for a, b in zip(base, rows[side][:6], strict=True)]
        print(f"{'ratio ' + side:>22}" + "".join(f"{x:15.2f}" for x in ratios))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--vehicles", type=int, default=50)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    endpoint, port = f"tcp/127.0.0.1:{free_port()}", free_udp_ports(1)
    quiet = subprocess.DEVNULL
    up = subprocess.Popen(
        [*ZMAV, "up", "--link", f"udpin:127.0.0.1:{port}", "-l", endpoint], stdout=quiet, stderr=quiet
    )
    sim = subprocess.Popen([*ZMAV, "sim", "--endpoint", f"udp:127.0.0.1:{port}+1"], stdout=quiet, stderr=quiet)
    try:
        deadline = time.monotonic() + 30.0
        while True:
            try:
                turns = asyncio.run(run(args.rounds, args.seconds, args.vehicles, endpoint))
                break
            except zmav.errors.SessionError:
                if time.monotonic() > deadline:
                    raise
    finally:
        for process in (sim, up):
            process.terminate()
            process.wait()
    if args.json:
        print(json.dumps({side: [msgspec.to_builtins(turn) for turn in found] for side, found in turns.items()}))
    else:
        table(turns)


if __name__ == "__main__":
    main()
