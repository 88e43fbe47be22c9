"""UDP -> adapter -> Zenoh -> ground -> UDP, beside a pymavlink forwarder and a bare Zenoh hop, in one run.

    python tests/bench/adapter.py [--rounds 5] [--seconds 4] [--rate 500] [--json]

Latency and CPU a message at 500 messages a second (the sides take turns, medians over rounds), then the highest rate
without loss. "direct" is the bench alone. CPU is the scheduler's, of every thread of a process.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.bench._load import Run, Sink, end, measure
from zmav.process import free_port

PEERS = [sys.executable, str(Path(__file__).resolve().parent / "_peers.py")]
ZMAV = [sys.executable, "-m", "zmav"]


class Side:
    """One way from UDP to UDP: its input port and its processes."""

    def __init__(self, name: str, port: int, processes: list[subprocess.Popen[bytes]]) -> None:
        self.name, self.port, self.processes = name, port, processes
        self.runs: list[Run] = []
        self.top: Run | None = None

    @property
    def pids(self) -> list[int]:
        return [process.pid for process in self.processes]


@contextlib.contextmanager
def sides(sink: Sink) -> Iterator[list[Side]]:
    """Start every side's processes and wait until each carries frames."""
    out = str(sink.port)
    ports = [free_port(socket.SOCK_DGRAM) for _ in range(3)]
    bare, routed = (f"tcp/127.0.0.1:{free_port()}" for _ in range(2))
    up = [*ZMAV, "up", "--link", f"udpin:127.0.0.1:{ports[2]}", "-l", routed]
    plan = [
        ("pymavlink forwarder", ports[0], [[*PEERS, "pymavlink", str(ports[0]), out]]),
        ("bare Zenoh hop", ports[1], [[*PEERS, "bare-in", str(ports[1]), bare], [*PEERS, "bare-out", bare, out]]),
        ("zmav", ports[2], [up, [*PEERS, "ground", routed, out]]),
    ]
    with contextlib.ExitStack() as stack:
        started = [Side("direct", sink.port, [])]
        for name, port, commands in plan:
            processes = []
            for command in commands:
                process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
                stack.callback(end, process)
                processes.append(process)
                time.sleep(2.0)
            started.append(Side(name, port, processes))
        for side in started:
            _until_it_carries(side, sink)
        yield started


def _until_it_carries(side: Side, sink: Sink) -> None:
    for _ in range(20):
        if measure(side.port, sink, side.pids, 200, 0.2).received:
            return
    raise SystemExit(f"{side.name} carries nothing")


def highest_rate(side: Side, sink: Sink) -> Run | None:
    """The run at the highest offered rate without loss (one retry: a neighbour's burst is no verdict), to a tenth."""
    best: Run | None = None
    low, high, rate = 0.0, 0.0, 4000.0
    while not high or high - low > 0.1 * high:
        run = min((measure(side.port, sink, side.pids, rate, 1.0) for _ in range(2)), key=lambda r: r.lost)
        if run.lost == 0:
            low, best = rate, run
        else:
            high = rate
        if run.rate < 0.9 * rate:
            break  # the generator itself can do no more
        rate = (low + high) / 2 if high else rate * 2
    return best


def row(side: Side) -> dict[str, Any]:
    def median(values: list[float]) -> float:
        return round(statistics.median(values), 1)

    line: dict[str, Any] = {
        "side": side.name,
        "p50_us": median([run.p50 for run in side.runs]),
        "p99_us": median([run.quantile(0.99) for run in side.runs]),
        "lost": sum(run.lost for run in side.runs),
        "cpu_us": [median([run.cpu[i] for run in side.runs]) for i in range(len(side.processes))],
    }
    if side.top:
        line |= {"top_rate": round(side.top.rate), "top_cpu_us": [round(c, 1) for c in side.top.cpu]}
    return line


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--rounds", type=int, default=5)
    options.add_argument("--seconds", type=float, default=4.0)
    options.add_argument("--rate", type=float, default=500.0)
    options.add_argument("--json", action="store_true")
    args = options.parse_args()
    sink = Sink()
    with sides(sink) as compared:
        for _ in range(args.rounds):
            for side in compared:
                side.runs.append(measure(side.port, sink, side.pids, args.rate, args.seconds))
        for side in compared:
            side.top = highest_rate(side, sink)
    rows = [row(side) for side in compared]
    if args.json:
        print(json.dumps(rows))
        return
    for line in rows:
        cpu = " + ".join(f"{c:.0f}" for c in line["cpu_us"]) or "-"
        top = f"{line.get('top_rate', 0):>7} /s" + (
            f" at {sum(line['top_cpu_us']):.1f} µs CPU" if line.get("top_cpu_us") else ""
        )
        print(
            f"{line['side']:20} p50 {line['p50_us']:7.1f} µs  p99 {line['p99_us']:8.1f} µs  CPU {cpu:>9} µs a message"
            f"  lost {line['lost']}  most without loss {top}"
        )
    named = {line["side"]: line for line in rows}
    ours, theirs, bare = named["zmav"], named["pymavlink forwarder"], named["bare Zenoh hop"]
    print(f"latency p50: zmav / pymavlink forwarder ×{ours['p50_us'] / theirs['p50_us']:.2f}, ", end="")
    print(f"zmav / bare Zenoh hop ×{ours['p50_us'] / bare['p50_us']:.2f}")
    print(f"CPU a message: adapter / pymavlink forwarder ×{ours['cpu_us'][0] / theirs['cpu_us'][0]:.2f}, ", end="")
    print(f"adapter / bare publisher ×{ours['cpu_us'][0] / bare['cpu_us'][0]:.2f}")


if __name__ == "__main__":
    main()
