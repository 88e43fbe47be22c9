"""Quality of service over 1 Mbit/s: what setpoints, orders, telemetry and video take to cross, and in which order.

Everything goes one way, from the vehicle's router to the ground's: 50 setpoints, 10 orders, 5 states, 200 raw messages
a second (45 kB/s on the wire), and 4 Mbit/s of video. First through a radio's own queue, then behind bearers that keep
the budget themselves; then what a bearer costs. Prints tables; asserts nothing.
"""

from __future__ import annotations

import argparse
import itertools
import json
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from mesh.bearer.bearer import Bearer, Far
from mesh.bearer.bearers import BATCH
from tests.ports import free_udp_ports
from zmav.config import Radio

PROCESSES = Path(__file__).with_name("_qos.py")
RATE = 125_000.0
"""bytes/s"""
OURS = [f"transport/link/tx/batch_size:{BATCH}"]
VIDEO = 500_000.0
"""bytes/s"""


def start(*arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, str(PROCESSES), *arguments]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline()


def measure(seconds: float, queue: float, credentials: list[str] | None, **more: Any) -> dict[str, Any]:
    """One run; what was sent and heard."""
    config: dict[str, Any] = {
        "local": [free_udp_ports(1), free_udp_ports(1)],
        "router": free_udp_ports(1),
        "air": free_udp_ports(1),
        "radios": [free_udp_ports(1), free_udp_ports(1)],
        "budget": None,
        "video": VIDEO,
        "chunk": 1100,
        "best_effort": False,
        "cfg": [],
        "seconds": seconds,
        "credentials": credentials,
        **more,
    }
    running = []
    try:
        if not config["budget"]:
            running.append(start("air", str(RATE), str(queue), str(config["air"]), str(config["router"])))
            line(running[-1])
        running.append(start("far", json.dumps(config)))
        line(running[-1])
        running.append(start("near", json.dumps(config)))
        result: dict[str, Any] = json.loads(line(running[-1]))
        time.sleep(0.5)
        ground = running[-2]
        assert ground.stdin is not None
        ground.stdin.write("\n")
        ground.stdin.flush()
        return {**result, "heard": json.loads(line(ground))}
    finally:
        for process in running:
            try:
                process.wait(0.0 if process is running[0] and not config["budget"] else 15.0)
            except subprocess.TimeoutExpired:
                process.kill()
            process.communicate()


def at(values: list[float], part: float) -> str:
    found = sorted(values)
    return f"{1e3 * found[min(int(part * len(found)), len(found) - 1)]:.0f}" if found else "-"


def row(what: str, result: dict[str, Any]) -> None:
    """Median/p99 of the delays in ms, and how many of each class came; the order of each stream is checked."""
    sent, heard, cells, disorder = result["sent"], result["heard"], [], 0
    for kind in ("setpoint", "do", "state", "raw", "camera"):
        names = [name for name in sent if name.startswith("M")] if kind == "raw" else [kind]
        delays = [delay for name in names for _, delay in heard.get(name, ())]
        given = result["orders"]["given"] if kind == "do" else sum(sent.get(name, 0) for name in names)
        for name in names:
            numbers = [number for number, _ in heard.get(name, ())]
            disorder += sum(later <= earlier for earlier, later in itertools.pairwise(numbers))
        came = f"{100 * len(delays) / given:.0f}%" if given else "-"
        cells.append(f"{at(delays, 0.5)}/{at(delays, 0.99)} {came}")
    trips = result["orders"]["times"]
    cells[1] = f"{at(trips, 0.5)}/{at(trips, 0.99)} {result['orders']['missed']} lost"
    print(f"{what:52}" + "".join(f"{cell:>18}" for cell in cells) + f"{disorder:>9}{_busiest(result):>12}", flush=True)


def _busiest(result: dict[str, Any]) -> str:
    """The most bytes of any second through the radio, of what the budget allows."""
    wire, most, first = result["wire"], 0.0, 0
    for when, total in wire:
        while when - wire[first][0] > 1.0:
            first += 1
        most = max(most, (total - wire[first][1]) / result["rate"])
    return f"{100 * most:.0f}%" if wire else "-"


def classes(seconds: float) -> None:
    head = ("setpoint", "order (round trip)", "state", "raw", "video")
    print(
        "delay in ms, median/p99, and how much arrived".ljust(52)
        + "".join(f"{name:>18}" for name in head)
        + f"{'disorder':>9}{'busiest s':>12}"
    )
    with tempfile.TemporaryDirectory() as folder:
        members = certified(Path(folder))
        runs: list[tuple[str, float, float, list[str] | None, dict[str, Any]]] = [
            ("no video; radio with a queue of 100 ms", RATE, 0.1, None, {"video": 0.0}),
            ("video best effort; Zenoh's batches of 64 kB", RATE, 0.1, None, {"best_effort": True}),
            ("video reliable; Zenoh's batches of 64 kB", RATE, 0.1, None, {}),
            (f"video reliable; batches of {BATCH} B", RATE, 0.1, None, {"cfg": OURS}),
            ("same, the radio's queue 30 ms", RATE, 0.03, None, {"cfg": OURS}),
            ("bearers with a budget of 1 Mbit/s", RATE, 0.0, None, {"cfg": OURS, "budget": "1 Mbit/s"}),
            ("same, QUIC with TLS", RATE, 0.0, members, {"cfg": OURS, "budget": "1 Mbit/s"}),
            (
                "bearers, 1 Mbit/s, video best effort",
                RATE,
                0.0,
                None,
                {"cfg": OURS, "budget": "1 Mbit/s", "best_effort": True},
            ),
            ("bearers, 60 kB/s", 60e3, 0.0, None, {"cfg": OURS, "budget": "60 kB/s"}),
            (
                "bearers, 60 kB/s, two pictures of 5 kB a second",
                60e3,
                0.0,
                None,
                {"cfg": OURS, "budget": "60 kB/s", "video": 10e3, "chunk": 5000},
            ),
        ]
        for what, rate, queue, credentials, more in runs:
            row(what, {**measure(seconds, queue, credentials, **more), "rate": rate})


def certified(folder: Path) -> list[str]:
    """Credentials for the two, of an authority made for the occasion."""
    made = []
    command = [sys.executable, "-m", "zmav", "mesh", "ca"]
    subprocess.run([*command, "init", str(folder / "ca"), "--fleet", "demo"], check=True, capture_output=True)
    for name, role in (("near", "vehicle"), ("far", "operator")):
        out = folder / name
        issue = ["issue", name, "--role", role, "--ca", str(folder / "ca"), "--out", str(out)]
        subprocess.run([*command, *issue], check=True, capture_output=True)
        made.append(str(out))
    return made


def cost(count: int) -> None:
    """What a datagram of 1,200 bytes costs through two bearers in one process, without and with a budget."""
    print("\nthrough two bearers: CPU a datagram and bearer")
    for budget in (None, "10 MB/s"):
        ports, routers = ([free_udp_ports(1), free_udp_ports(1)], [free_udp_ports(1), free_udp_ports(1)])
        bearers = []
        for side, name in enumerate(("near", "far")):
            far = Far(("far", "near")[side], [(0, ("127.0.0.1", ports[1 - side]), 20)], opens=side == 0)
            radio = Radio(address="127.0.0.1", budget=budget)
            bearers.append(
                Bearer("demo", name, [(radio, ports[side])], [far], ("127.0.0.1", routers[side])).__enter__()
            )
        there = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        there.bind(("127.0.0.1", routers[1]))
        there.settimeout(1.0)
        mine = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        mine.connect(bearers[0].local["far"])
        spent = came = 0.0
        for _ in range(count):
            before = time.process_time()
            mine.send(bytes(1200))
            try:
                there.recv(2048)
            except TimeoutError:
                continue
            spent += time.process_time() - before
            came += 1
        before = time.process_time()
        for _ in range(count):  # what the loop itself costs: the same over a bare socket pair
            there.sendto(bytes(1200), there.getsockname())
            there.recv(2048)
        bare = time.process_time() - before
        print(f"  {'budget ' + budget if budget else 'no budget':16} {1e6 * (spent - bare) / came / 2:6.1f} µs")
        for bearer in bearers:
            bearer.__exit__()
        there.close()
        mine.close()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=6.0, help="of each run")
    chosen = parser.parse_args()
    classes(chosen.seconds)
    cost(5000)
