"""The HTTP gateway: from a message's leaving to its JSON at a WebSocket's client, beside pymavlink with websockets.

    python tests/bench/http_gateway.py [--rounds 3] [--seconds 2] [--rate 500] [--json]

One to ten clients at 500 messages a second, the sides in turns, medians over rounds; CPU is the scheduler's, of every
thread of the serving process. Then what a GET takes over a connection that stays open, with the messages still coming.
The way in differs: the gateway's frames come over a Zenoh router, the other's by UDP.
"""

from __future__ import annotations

import argparse
import contextlib
import http.client
import json
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.bench._load import _cpu_ns, end
from zmav.process import free_port

SIDES = [sys.executable, str(Path(__file__).resolve().parent / "_http_sides.py")]
COUNTS = (1, 10)
PATHS = (
    "/v1/mavlink/vehicles/1/components/1/messages/GPS_RAW_INT",
    "/v1/mavlink/vehicles/1/components/1/messages/GPS_RAW_INT/message/lat",
    "/last/1/1/GPS_RAW_INT",
)
REQUESTS = 300


class Side(NamedTuple):
    name: str
    pid: int
    url: str


class Run(NamedTuple):
    p50: float
    p99: float
    share: float
    """of the messages that were to come"""
    cpu: float
    """µs a message in"""


@contextlib.contextmanager
def sides(rate: float) -> Iterator[tuple[list[Side], int]]:
    """Both, with their load running; and the gateway's port."""
    endpoint, port = f"tcp/127.0.0.1:{free_port()}", free_port()
    ws, into = free_port(), free_port(socket.SOCK_DGRAM)
    gateway = [sys.executable, "-m", "zmav", "http", "--port", str(port), "-e", endpoint]
    with contextlib.ExitStack() as stack:

        def start(command: list[str]) -> int:
            process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            stack.callback(end, process)
            time.sleep(1.5)
            return process.pid

        start([*SIDES, "zenoh", endpoint, str(rate)])
        first = Side("zmav http", start(gateway), f"ws://127.0.0.1:{port}/v1/ws/mavlink?filter=GPS_RAW_INT")
        second = Side("pymavlink + json", start([*SIDES, "pymavlink", str(into), str(ws)]), f"ws://127.0.0.1:{ws}")
        start([*SIDES, "udp", str(into), str(rate)])
        for each in (port, ws):
            wait_for(each)
        yield [first, second], port


def wait_for(port: int) -> None:
    for _ in range(150):
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0):
            return
        time.sleep(0.2)
    raise SystemExit(f"nothing listens on port {port}")


def measure(side: Side, count: int, rate: float, seconds: float) -> Run:
    command = [*SIDES, "clients", side.url, str(count), str(seconds)]
    before, began = _cpu_ns(side.pid), time.monotonic()
    said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    cpu, took = _cpu_ns(side.pid) - before, time.monotonic() - began
    found = sorted(json.loads(said))
    expected = rate * seconds * count
    p99 = found[int(0.99 * len(found))]
    return Run(statistics.median(found), p99, len(found) / expected, cpu / 1e3 / (rate * took))


def idle(side: Side, rate: float, seconds: float) -> float:
    """CPU in µs a message that comes in while nobody reads it."""
    before, began = _cpu_ns(side.pid), time.monotonic()
    time.sleep(seconds)
    return (_cpu_ns(side.pid) - before) / 1e3 / (rate * (time.monotonic() - began))


def gets(port: int, path: str) -> tuple[float, float]:
    """Median and 99th percentile in µs."""
    connection, took = http.client.HTTPConnection("127.0.0.1", port, timeout=10.0), []
    for _ in range(REQUESTS):
        start = time.perf_counter()
        connection.request("GET", path)
        reply = connection.getresponse()
        reply.read()
        took.append(1e6 * (time.perf_counter() - start))
        assert reply.status == 200, (path, reply.status)
    connection.close()
    return statistics.median(took), sorted(took)[int(0.99 * REQUESTS)]


def run(rounds: int, seconds: float, rate: float) -> dict[str, Any]:
    runs: dict[tuple[str, int], list[Run]] = {}
    unread: dict[str, list[float]] = {}
    with sides(rate) as (both, port):
        for _ in range(rounds):
            for side in both:
                unread.setdefault(side.name, []).append(idle(side, rate, seconds))
            for count in COUNTS:
                for side in both:
                    runs.setdefault((side.name, count), []).append(measure(side, count, rate, seconds))
        asked = {path: gets(port, path) for path in PATHS}
    table = {
        key: Run(*(statistics.median(each[column] for each in found) for column in range(4)))
        for key, found in runs.items()
    }
    return {
        "unread": {name: statistics.median(found) for name, found in unread.items()},
        "websocket": [{"side": name, "clients": n, **each._asdict()} for (name, n), each in table.items()],
        "get": [{"path": path, "p50": p50, "p99": p99} for path, (p50, p99) in asked.items()],
    }


def show(found: dict[str, Any], rate: float) -> None:
    print(f"WebSocket, {rate:g} msg/s in: µs from leaving to JSON at the client; CPU in µs a message in\n")
    print(f"{'side':<18}{'clients':>8}{'p50':>8}{'p99':>8}{'came':>7}{'CPU':>7}")
    for row in found["websocket"]:
        came = f"{100 * row['share']:.0f} %"
        print(f"{row['side']:<18}{row['clients']:>8}{row['p50']:>8.0f}{row['p99']:>8.0f}{came:>7}{row['cpu']:>7.0f}")
    for count in COUNTS:
        ours, theirs = (row for row in found["websocket"] if row["clients"] == count)
        ratios = ", ".join(f"{what} {theirs[what] / ours[what]:.2f}" for what in ("p50", "p99", "cpu"))
        print(f"pymavlink + json against zmav http, {count} clients: {ratios}")
    unread = ", ".join(f"{name} {cpu:.0f}" for name, cpu in found["unread"].items())
    print(f"CPU in µs a message in that nobody reads: {unread}")
    print("\nGET over one connection, µs\n")
    print(f"{'p50':>6}{'p99':>7}  path")
    for row in found["get"]:
        print(f"{row['p50']:>6.0f}{row['p99']:>7.0f}  {row['path']}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--rate", type=float, default=500.0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = run(options.rounds, options.seconds, options.rate)
    if options.json:
        print(json.dumps(found, indent=2))
    else:
        show(found, options.rate)


if __name__ == "__main__":
    main()
