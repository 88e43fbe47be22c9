"""What 'zmav mesh bench' says against what is known, and what its own measuring costs.

    python tests/bench/mesh_bench.py [accuracy] [cost] [--rounds 3] [--json]

accuracy (needs root): two hosts of the lab whose link has a rate, a delay, a loss and cuts that are set here; measured
and expected side by side. cost: two routers on loopback; our stream against a bare Zenoh publisher between the same two
routers and against plain UDP sockets of Python between the same two processes, which take turns; and the same for round
trips.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import msgspec

import zmav
from mesh.bench.asker import Bench
from mesh.bench.flow import Stream
from mesh.lab.lab import Lab
from mesh.lab.scenario import Scenario, check
from tests.bench._load import _cpu_ns, end
from zmav.process import free_port

NODE = [sys.executable, str(Path(__file__).resolve().parent / "_bench_node.py")]
LINK = "a-b"


class Table:
    """Rows of what was measured and what was to be expected; each is printed when it is there."""

    def __init__(self, quiet: bool) -> None:
        self.rows: list[dict[str, Any]] = []
        self._quiet = quiet
        if not quiet:
            print(f"{'':78} {'expected':>10} {'measured':>10} {'ratio':>7}", flush=True)

    def add(self, what: str, unit: str, expected: float | None, measured: float) -> None:
        ratio = measured / expected if expected else None
        self.rows.append({"what": what, "unit": unit, "expected": expected, "measured": measured, "ratio": ratio})
        if not self._quiet:
            cells = f"{_cell(expected, 10)} {_cell(measured, 10)} {_cell(ratio, 7)}"
            print(f"{what + ', ' + unit:78} {cells}", flush=True)


def _cell(value: float | None, width: int) -> str:
    return f"{value:{width}.2f}" if value is not None else f"{'-':>{width}}"


# Accuracy.


async def accuracy(table: Table, credentials: bool) -> None:
    tables = {
        "hosts": {"a": {}, "b": {}},
        "credentials": credentials,
        "media": [{"kind": "link", "between": ["a", "b"], "name": LINK}],
    }
    label = "quic, credentials" if credentials else "udp"
    async with Lab(check(msgspec.convert(tables, Scenario))) as lab:
        await lab.ready()
        folder = str(lab.credentials("a")) if credentials else None
        async with zmav.open(fleet=lab.fleet, connect=[await lab.endpoint("a")], credentials=folder) as z:
            bench = Bench(z)
            await _linked(bench)
            await _rate(table, lab, bench, label)
            await _loss(table, lab, bench, label)
            await _delay(table, lab, bench, label)
            await _cuts(table, lab, bench, label)


async def _linked(bench: Bench) -> None:
    while len(await bench.everyone()) < 2:
        await asyncio.sleep(0.1)


async def _rate(table: Table, lab: Lab, bench: Bench, label: str) -> None:
    lab.set(LINK, rate="2 Mbit/s")
    before = lab.counters(LINK)[0]
    flood = Stream(seconds=5.0, hz=375.0, size=1000, qos="bulk")
    flow = await bench.stream("a", "b", flood)
    after = lab.counters(LINK)[0]
    frame = (after.arrived_bytes - before.arrived_bytes) / max(after.arrived - before.arrived, 1)
    most = 2.0 * flow.total.bytes / max(after.arrived_bytes - before.arrived_bytes, 1)
    table.add(
        f"{label}: 3 Mbit/s of bulk into 2 Mbit/s ({frame:.0f} B a frame), payload",
        "Mbit/s",
        most,
        flow.bandwidth / 1e6,
    )
    lab.set(LINK, rate=None)


async def _loss(table: Table, lab: Lab, bench: Bench, label: str) -> None:
    lab.set(LINK, loss=0.1)
    for qos, expected in (("bulk", 10.0), ("realtime", None)):
        stream = Stream(seconds=10.0, hz=200.0, size=500, qos=qos)  # type: ignore[arg-type]
        flow = await bench.stream("a", "b", stream)
        table.add(f"{label}: {qos} over a link that loses 10 %", "% lost", expected, 100.0 * flow.loss)
    lab.set(LINK, loss=0.0)


async def _delay(table: Table, lab: Lab, bench: Bench, label: str) -> None:
    report = await bench.round_trips("a", "b", Stream(seconds=5.0, hz=50.0, size=64, qos="realtime"))
    idle = report.rtt
    assert idle is not None
    table.add(f"{label}: round trip, bare link", "ms", None, 1e3 * idle.median)
    lab.set(LINK, delay="50 ms")
    await asyncio.sleep(1.0)
    report = await bench.round_trips("a", "b", Stream(seconds=5.0, hz=50.0, size=64, qos="realtime"))
    found = report.rtt
    assert found is not None
    table.add(f"{label}: round trip, 50 ms each way", "ms", 100.0 + 1e3 * idle.median, 1e3 * found.median)
    flow = await bench.stream("a", "b", Stream(seconds=5.0, hz=50.0, size=500))
    delay = flow.delay(flow.total.transit)
    assert delay is not None and flow.clock is not None and flow.total.transit is not None
    # Both hosts of the lab read one clock, so the true delay is known.
    true = 1e3 * flow.total.transit.median
    table.add(f"{label}: one way, ± {1e3 * flow.clock.within:.0f} ms stated", "ms", true, 1e3 * delay[0])
    lab.set(LINK, delay="20 ms", jitter="10 ms", ordered=False)
    flow = await bench.stream("a", "b", Stream(seconds=10.0, hz=50.0, size=500, qos="bulk"))
    table.add(f"{label}: jitter, 20 ± 10 ms evenly spread", "ms", 20.0 / 3.0, 1e3 * flow.total.jitter)
    lab.set(LINK, delay=0.0, jitter=0.0, ordered=True)


async def _cuts(table: Table, lab: Lab, bench: Bench, label: str) -> None:
    """The link is cut twice for 0.5 s, and what the stream saw of it."""
    seconds = 8.0
    stream = Stream(seconds=seconds, hz=50.0, size=100, qos="realtime", guard=0.0)
    task = asyncio.ensure_future(bench.stream("a", "b", stream))
    for _ in range(2):
        await asyncio.sleep(2.0)
        lab.cut(LINK)
        await asyncio.sleep(0.5)
        lab.heal(LINK)
    flow = await task
    lengths = [outage.length for outage in flow.outages]
    table.add(f"{label}: outages of two cuts", "count", 2.0, float(len(lengths)))
    if lengths:
        table.add(f"{label}: their median length, cut for 0.5 s", "s", 0.5, statistics.median(lengths))


# Cost.


class Node:
    """One router in a process of its own."""

    def __init__(self, stack: contextlib.ExitStack, name: str, listen: str, *connect: str) -> None:
        self._process = subprocess.Popen(
            [*NODE, name, listen, *connect], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        stack.callback(end, self._process)
        self.pid = self._process.pid
        self.read()

    def read(self) -> dict[str, float]:
        assert self._process.stdout is not None
        found: dict[str, float] = json.loads(self._process.stdout.readline())
        return found

    def do(self, *task: object) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(" ".join(map(str, task)) + "\n")
        self._process.stdin.flush()


@contextlib.contextmanager
def nodes() -> Iterator[tuple[Node, Node, str]]:
    tcp = [f"tcp/127.0.0.1:{free_port()}" for _ in range(2)]
    udp = f"udp/127.0.0.1:{free_port()}?rel=1;mixed_rel=1"
    with contextlib.ExitStack() as stack:
        first = Node(stack, "a", f"{tcp[0]},{udp}")
        second = Node(stack, "b", tcp[1], udp)
        yield first, second, tcp[0]


async def cost(table: Table, rounds: int) -> None:
    with nodes() as (a, b, endpoint):
        async with zmav.open(fleet="demo", connect=[endpoint]) as z:
            bench = Bench(z)
            await _linked(bench)
            for size in (64, 1000):
                await _throughput(table, bench, a, b, size, rounds)
            for hz, size in ((10_000.0, 64), (6_250.0, 1000)):
                await _paced(table, bench, a, b, hz, size, rounds)
            await _trips(table, bench, a, b, rounds)


async def _throughput(table: Table, bench: Bench, a: Node, b: Node, size: int, rounds: int) -> None:
    """As many as come through, in thousands a second."""
    rates: dict[str, list[float]] = {"UDP": [], "Zenoh": [], "bench": []}
    for _ in range(rounds):
        b.do("ureceive")
        a.do("usend", int(b.read()["port"]), 2.0, size)
        rates["UDP"].append(b.read()["per_second"] / 1e3)
        a.read()
        b.do("zreceive")
        await asyncio.sleep(0.3)
        a.do("zsend", 2.0, size)
        rates["Zenoh"].append(b.read()["per_second"] / 1e3)
        a.read()
        stream = Stream(seconds=2.0, hz=50_000.0, size=size, guard=0.0)
        total = (await bench.stream("a", "b", stream)).total
        rates["bench"].append(total.received / total.end / 1e3)
    medians = {name: statistics.median(found) for name, found in rates.items()}
    table.add(f"{size} B as fast as it goes: bench against plain UDP", "k/s", medians["UDP"], medians["bench"])
    table.add(f"{size} B as fast as it goes: bench against bare Zenoh", "k/s", medians["Zenoh"], medians["bench"])


async def _paced(table: Table, bench: Bench, a: Node, b: Node, hz: float, size: int, rounds: int) -> None:
    """At a rate that was asked for: what was kept of it, how evenly, and the CPU at both ends."""
    sent, lost, late, jitter, cpu = [], [], [], [], [[], []]  # type: ignore[var-annotated]
    for _ in range(rounds):
        before, begun = [_cpu_ns(node.pid) for node in (a, b)], time.monotonic()
        flow = await bench.stream("a", "b", Stream(seconds=3.0, hz=hz, size=size, guard=0.0))
        assert flow.sender.lateness is not None and time.monotonic() > begun
        sent.append(flow.sender.sent / flow.sender.send_seconds)
        lost.append(100.0 * flow.loss)
        late.append(1e6 * flow.sender.lateness.median)
        jitter.append(1e6 * flow.total.jitter)
        for side, node, was in zip(cpu, (a, b), before, strict=True):
            side.append((_cpu_ns(node.pid) - was) / 1e3 / max(flow.sender.sent, 1))
    what = f"{hz:.0f} Hz of {size} B ({hz * size * 8e-6:.1f} Mbit/s)"
    table.add(f"{what}: sent", "Hz", hz, statistics.median(sent))
    for name, unit, values in (
        ("lost", "%", lost),
        ("sender behind its times, median", "µs", late),
        ("jitter", "µs", jitter),
        ("CPU of the sender's router a datagram", "µs", cpu[0]),
        ("of the receiver's", "µs", cpu[1]),
    ):
        table.add(f"{what}: {name}", unit, None, statistics.median(values))


async def _trips(table: Table, bench: Bench, a: Node, b: Node, rounds: int) -> None:
    medians: dict[str, list[float]] = {"UDP": [], "Zenoh": [], "bench": []}
    for _ in range(rounds):
        b.do("uecho", 4.0)
        a.do("uping", int(b.read()["port"]), 150, 50.0)
        medians["UDP"].append(1e6 * a.read()["median"])
        b.read()
        b.do("zecho", 5.0)
        await asyncio.sleep(0.5)
        a.do("zping", 150, 50.0)
        medians["Zenoh"].append(1e6 * a.read()["median"])
        b.read()
        stream = Stream(seconds=3.0, hz=50.0, size=64, qos="realtime")
        found = (await bench.round_trips("a", "b", stream)).rtt
        assert found is not None
        medians["bench"].append(1e6 * found.median)
    trips = {name: statistics.median(found) for name, found in medians.items()}
    table.add("round trip, 64 B at 50 Hz: bench against plain UDP", "µs", trips["UDP"], trips["bench"])
    table.add("round trip, 64 B at 50 Hz: bench against bare Zenoh", "µs", trips["Zenoh"], trips["bench"])


async def measure(parts: list[str], rounds: int, quiet: bool) -> Table:
    table = Table(quiet)
    if "cost" in parts:
        await cost(table, rounds)
    if "accuracy" in parts and os.geteuid() != 0:
        print("accuracy: left out, it needs root", file=sys.stderr)
    elif "accuracy" in parts:
        for credentials in (False, True):
            await accuracy(table, credentials)
    return table


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("parts", nargs="*", choices=["accuracy", "cost", []])
    options.add_argument("--rounds", type=int, default=3)
    options.add_argument("--json", action="store_true")
    args = options.parse_args()
    table = asyncio.run(measure(args.parts or ["cost", "accuracy"], args.rounds, args.json))
    if args.json:
        print(json.dumps(table.rows))


if __name__ == "__main__":
    main()
