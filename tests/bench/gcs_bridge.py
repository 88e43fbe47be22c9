"""Adapters -> Zenoh -> 'zmav gcs' -> UDP, for 1, 10 and 50 vehicles, beside a pymavlink forwarder in the same run.

    python tests/bench/gcs_bridge.py [--rounds 3] [--seconds 1] [--rate 100] [--vehicles 1,10,50] [--json]

Every vehicle sends its own frames to an adapter of its own (all of them in one process); the forwarder gets the same
frames on one socket, receives each with pymavlink and sends its bytes on. Medians over the rounds, in which the sides
take turns. CPU is the scheduler's, of every thread of a process: of the bridge's alone, and of all the adapters.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import socket
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from fastcrc import crc16

from tests.bench._load import _STAMP, MIX, Run, Sink, _cpu_ns, end
from tests.ports import free_udp_ports
from zmav.bus import Bus
from zmav.mavlink import load_dialect
from zmav.process import free_port

HERE = str(Path(__file__).resolve())
PEERS = str(Path(HERE).parent / "_peers.py")


def fleet(first: int, count: int, endpoint: str) -> None:
    """The adapters of ``count`` vehicles, each on a UDP port of its own from ``first`` on, beside one router."""
    from zmav.adapter import Adapter
    from zmav.links import open_link
    from zmav.session import SessionSettings, open_session

    with open_session(SessionSettings(mode="router", listen=[endpoint])) as session:
        for number in range(count):
            link = open_link(f"udpin:127.0.0.1:{first + number}")
            Adapter(session, "bench", f"v{number}", link, load_dialect(), Bus()).start()
        threading.Event().wait()


def send(first: int, step: int, count: int, rate: float, seconds: float) -> None:
    """Send each vehicle's frames, ``rate`` a second, to its port; all to one port where ``step`` is 0."""
    types = [load_dialect().by_name[name] for name in MIX]
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    fill = [bytes([7] * (kind.base_length - _STAMP.size)) for kind in types]
    period, start, total = 1e9 / (rate * count), time.monotonic_ns(), int(rate * count * seconds)
    for number in range(total):
        left = start + number * period - time.monotonic_ns()
        if left > 50_000:
            time.sleep(left / 1e9)
        turn, vehicle = divmod(number, count)
        kind = types[turn % len(types)]
        head = bytes((kind.base_length, 0, 0, turn & 255, vehicle + 1, 1)) + kind.id.to_bytes(3, "little")
        body = head + _STAMP.pack(number, time.monotonic_ns()) + fill[turn % len(types)]
        check = crc16.mcrf4xx(body + bytes((kind.crc_extra,))).to_bytes(2, "little")
        out.sendto(b"\xfd" + body + check, ("127.0.0.1", first + step * vehicle))
    print(total, (time.monotonic_ns() - start) / 1e9)


class Side:
    """One way from UDP to UDP."""

    def __init__(self, name: str, port: int, step: int, processes: list[subprocess.Popen[bytes]]) -> None:
        self.name, self.port, self.step, self.processes = name, port, step, processes
        self.runs: list[Run] = []

    def measure(self, sink: Sink, count: int, rate: float, seconds: float) -> Run:
        sink.take()
        before = [_cpu_ns(process.pid) for process in self.processes]
        arguments = map(str, (self.port, self.step, count, rate, seconds))
        command = [sys.executable, HERE, "send", *arguments]
        sent, took = map(float, subprocess.run(command, check=True, capture_output=True, text=True).stdout.split())
        while time.monotonic() - sink.last < 0.3:
            time.sleep(0.05)
        got = sink.take()
        after = [_cpu_ns(process.pid) for process in self.processes]
        cpu = [(b - a) / 1e3 / max(len(got), 1) for a, b in zip(before, after, strict=True)]
        return Run(int(sent), len(got), sent / took, got, cpu)


@contextlib.contextmanager
def sides(sink: Sink, count: int) -> Iterator[list[Side]]:
    """Both ways for so many vehicles, each once it carries frames."""
    endpoint, ports = f"tcp/127.0.0.1:{free_port()}", free_udp_ports(count)
    forwarder = free_port(socket.SOCK_DGRAM)
    plan: list[tuple[str, int, int, list[list[str]]]] = [
        ("pymavlink", forwarder, 0, [[sys.executable, PEERS, "pymavlink", str(forwarder), str(sink.port)]]),
        (
            "zmav gcs",
            ports,
            1,
            [
                [sys.executable, HERE, "fleet", str(ports), str(count), endpoint],
                [sys.executable, "-m", "zmav", "gcs", "--udp", str(sink.port), "--fleet", "bench", "-e", endpoint],
            ],
        ),
    ]
    with contextlib.ExitStack() as stack:
        found = [Side("direct", sink.port, 0, [])]
        for name, port, step, commands in plan:
            processes = []
            for command in commands:
                process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
                stack.callback(end, process)
                processes.append(process)
                time.sleep(2.0)
            found.append(Side(name, port, step, processes))
        for side in found:
            if not any(side.measure(sink, count, 20.0, 0.3).received for _ in range(20)):
                raise SystemExit(f"{side.name} carries nothing")
        yield found


def row(side: Side, count: int) -> dict[str, Any]:
    def median(values: list[float]) -> float:
        return round(statistics.median(values), 1)

    cpu = [median([run.cpu[i] for run in side.runs]) for i in range(len(side.processes))]
    return {
        "vehicles": count,
        "side": side.name,
        "rate": round(median([run.rate for run in side.runs])),
        "p50_us": median([run.p50 for run in side.runs]),
        "p99_us": median([run.quantile(0.99) for run in side.runs]),
        "lost": sum(run.lost for run in side.runs),
        "cpu_us": cpu[-1:],
        "adapters_cpu_us": cpu[:-1],
        "core": [round(each * median([run.rate for run in side.runs]) / 1e6, 3) for each in cpu[-1:]],
    }


def shown(line: dict[str, Any]) -> str:
    text = (
        f"{line['vehicles']:3} vehicles {line['rate']:6} msg/s  {line['side']:10} p50 {line['p50_us']:7.1f} µs  "
        f"p99 {line['p99_us']:8.1f} µs  lost {line['lost']}"
    )
    if line["cpu_us"]:
        text += f"  CPU {line['cpu_us'][0]:6.1f} µs a message: {line['core'][0]:.1%} of a core"
    if line["adapters_cpu_us"]:
        text += f" (adapters {line['adapters_cpu_us'][0]:.1f} µs)"
    return text


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--rounds", type=int, default=3)
    options.add_argument("--seconds", type=float, default=1.0)
    options.add_argument("--rate", type=float, default=100.0, help="messages a second of each vehicle")
    options.add_argument("--vehicles", default="1,10,50")
    options.add_argument("--json", action="store_true")
    args = options.parse_args()
    sink, lines = Sink(), []
    for count in map(int, args.vehicles.split(",")):
        with sides(sink, count) as compared:
            for _ in range(args.rounds):
                for side in compared:
                    side.runs.append(side.measure(sink, count, args.rate, args.seconds))
            rows = [row(side, count) for side in compared]
        lines += rows
        if not args.json:
            print("\n".join(map(shown, rows)))
            named = {line["side"]: line for line in rows}
            ours, theirs = named["zmav gcs"], named["pymavlink"]
            print(
                f"    zmav gcs / pymavlink: latency p50 ×{ours['p50_us'] / theirs['p50_us']:.2f}, "
                f"CPU a message ×{ours['cpu_us'][0] / theirs['cpu_us'][0]:.2f}",
                flush=True,
            )
    if args.json:
        print(json.dumps(lines))


if __name__ == "__main__":
    if sys.argv[1:2] == ["fleet"]:
        fleet(int(sys.argv[2]), int(sys.argv[3]), sys.argv[4])
    elif sys.argv[1:2] == ["send"]:
        send(*map(int, sys.argv[2:5]), *map(float, sys.argv[5:7]))
    else:
        main()
