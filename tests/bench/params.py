"""All parameters over a slow serial line: our service beside pymavlink's own client, in one run.

    python tests/bench/params.py [--count 1000] [--baud 57600] [--loss 0.05] [--share 1.0] [--rounds 1] [--json]

A pty stands for the line; both directions are throttled to a tenth of the baud rate in bytes a second. Each side is
timed from its first PARAM_REQUEST_LIST on the line to the last parameter; the bytes in between count, the telemetry's
included. Once without loss, once with ``--loss`` of the frames lost in either direction.
``--share 0.3`` is what ArduPilot lets a stream of parameters take of its link.

pymavlink is used as MAVProxy does: param_fetch_all, and whenever no PARAM_VALUE came for a second, param_fetch_one for
ten of the missing.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import statistics
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.bench._slow_autopilot import SlowAutopilot
from zmav.onboard import Onboard, OnboardSettings
from zmav.session import SessionSettings, open_session

PATIENCE_S = 600.0
POLL_S = 0.002


class Run(NamedTuple):
    side: str
    seconds: float
    up: int
    down: int


def run_zmav(line: SlowAutopilot, baud: int) -> Run:
    return asyncio.run(_run_zmav(line, baud))


async def _run_zmav(line: SlowAutopilot, baud: int) -> Run:
    with open_session(SessionSettings(mode="peer", cfg=("scouting/multicast/enabled:false",))) as session:
        settings = OnboardSettings(link=f"serial:{line.path}:{baud}", name="bench")
        async with Onboard(session, settings) as vehicle:
            known, end = vehicle.params.known, time.monotonic() + PATIENCE_S
            while not known.complete:
                if time.monotonic() > end:
                    raise SystemExit(f"zmav: {known.received} of {known.count} parameters in {PATIENCE_S:.0f} s")
                await asyncio.sleep(POLL_S)
            done = _ended("zmav", line)
            table = {p.name: p.value for p in vehicle.params.table().params}
    assert table == line.params
    return done


def run_pymavlink(line: SlowAutopilot, baud: int) -> Run:
    from pymavlink import mavutil

    master = mavutil.mavlink_connection(line.path, baud=baud, dialect="ardupilotmega", source_system=255)
    try:
        master.wait_heartbeat(timeout=10)
        master.param_fetch_all()
        found: dict[int, tuple[str, float]] = {}
        count, last, asked = 0, time.monotonic(), time.monotonic()
        while not count or len(found) < count:
            message = master.recv_match(type="PARAM_VALUE", blocking=True, timeout=0.05)
            now = time.monotonic()
            if message is not None:
                count, last = message.param_count, now
                found[message.param_index] = (message.param_id, message.param_value)
            elif now - max(last, asked) >= 1.0:
                asked = now
                if not found:
                    master.param_fetch_all()
                for index in sorted(set(range(count)) - set(found))[:10]:
                    master.param_fetch_one(index)
        done = _ended("pymavlink", line)
    finally:
        master.close()
    assert dict(found.values()) == line.params
    return done


def _ended(side: str, line: SlowAutopilot) -> Run:
    assert line.asked_at is not None
    return Run(side, time.monotonic() - line.asked_at, line.bytes_up, line.bytes_down)


def measure(args: argparse.Namespace, loss: float) -> dict[str, Run]:
    """Each side's median run; the sides take turns and lose alike."""
    runs: dict[str, list[Run]] = {"zmav": [], "pymavlink": []}
    for seed in range(args.rounds):
        for run in (run_zmav, run_pymavlink):
            with SlowAutopilot(args.count, args.baud / 10, loss, args.share, seed) as line:
                done = run(line, args.baud)
            runs[done.side].append(done)
    medians = {}
    for side, each in runs.items():
        parts = zip(*(run[1:] for run in each), strict=True)
        medians[side] = Run(side, *(statistics.median(part) for part in parts))
    return medians


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--count", type=int, default=1000)
    options.add_argument("--baud", type=int, default=57600)
    options.add_argument("--loss", type=float, default=0.05)
    options.add_argument("--share", type=float, default=1.0)
    options.add_argument("--rounds", type=int, default=1)
    options.add_argument("--json", action="store_true")
    args = options.parse_args()
    rows: list[dict[str, Any]] = []
    for loss in (0.0, args.loss):
        found = measure(args, loss)
        rows += [{"loss": loss, **run._asdict()} for run in found.values()]
        if args.json:
            continue
        for run in found.values():
            print(f"{args.count} parameters, {args.baud} baud, {loss:.0%} loss  {run.side:10}", end="")
            print(f" {run.seconds:6.1f} s  {run.down:>7} bytes down  {run.up:>6} bytes up")
        ratio = found["pymavlink"].seconds / found["zmav"].seconds
        print(f"  pymavlink takes ×{ratio:.2f} the time of zmav")
    if args.json:
        print(json.dumps(rows))


if __name__ == "__main__":
    main()
