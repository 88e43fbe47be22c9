"""What the lab itself costs and adds: bring-up, CPU a frame, delay beyond the one set, the most one hop carries.

    python tests/bench/lab.py [--rounds 3] [--seconds 3] [--routers 30]

Needs root and /dev/net/tun. One process of the lab moves all frames; its CPU time includes the kernel's work for it.
The probes are UDP sockets in namespaces, all in this process: their delay includes its thread being woken, which the
line with no delay set shows.
"""

from __future__ import annotations

import argparse
import asyncio
import socket
import statistics
import struct
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from mesh.lab.lab import Lab
from mesh.lab.network import LabError, Network, check_able
from mesh.lab.scenario import Scenario, check

PORT = 5000
HEADERS = 42
"""bytes of Ethernet, IP and UDP around a probe"""
_STAMP = struct.Struct("<d")


def scenario(**tables: Any) -> Scenario:
    return check(msgspec.convert(tables, Scenario))


def pair(**conditions: Any) -> Scenario:
    """Two hosts on one radio."""
    return scenario(hosts={"h0": {}, "h1": {}}, media=[{"kind": "radio", "name": "w", **conditions}])


@contextmanager
def ends(network: Network) -> Iterator[tuple[socket.socket, socket.socket]]:
    """A connected sender at the first host, a receiver at the last."""
    first, last = network.wiring.hosts[0], network.wiring.hosts[-1]
    with network.inside(first):
        sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with network.inside(last):
        receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with sender, receiver:
        receiver.bind(("", PORT))
        receiver.settimeout(1.0)
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        sender.connect((network.address(last), PORT))
        sender.send(bytes(_STAMP.size))
        receiver.recv(100)  # both have each other's MAC address now
        yield sender, receiver


def stream(network: Network, rate: float, size: int, seconds: float) -> tuple[int, list[float]]:
    """Send frames of ``size`` bytes at ``rate`` bit/s; how many, and the delays of those that arrived, in s."""
    delays: list[float] = []

    def receive(s: socket.socket) -> None:
        try:
            while True:
                data = s.recv(2000)
                delays.append(time.monotonic() - _STAMP.unpack_from(data)[0])
        except TimeoutError:
            return

    with ends(network) as (sender, receiver):
        thread = threading.Thread(target=receive, args=(receiver,))
        thread.start()
        filler = bytes(size - HEADERS - _STAMP.size)
        period, begun, sent = 8 * size / rate, time.monotonic(), 0
        while (now := time.monotonic()) - begun < seconds:
            if begun + sent * period > now:
                time.sleep(begun + sent * period - now)
            sender.send(_STAMP.pack(time.monotonic()) + filler)
            sent += 1
        thread.join()
    return sent, delays


def bring_up(rounds: int) -> None:
    print("hosts  up (median of rounds)  down")
    for count in (6, 30, 100):
        ups, downs = [], []
        for _ in range(rounds):
            made = scenario(hosts={f"h{i}": {} for i in range(count)}, media=[{"kind": "radio", "name": "air"}])
            begun = time.monotonic()
            with Network(made):
                ups.append(time.monotonic() - begun)
                begun = time.monotonic()
            downs.append(time.monotonic() - begun)
        print(f"{count:5}  {statistics.median(ups):8.2f} s            {statistics.median(downs):8.2f} s")


def cost(rounds: int, seconds: float) -> None:
    print("\nframe   rate        relay's CPU  a frame  arrived")
    for size, rate in ((1242, 5e6), (142, 1e6)):
        shares, each, arrived = [], [], []
        for _ in range(rounds):
            with Network(pair(delay=0.002, rate=20e6)) as network:
                before = network.counted()
                sent, delays = stream(network, rate, size, seconds)
                after = network.counted()
            cpu = after.cpu_s - before.cpu_s
            moved = sum(c.arrived for c in after.channels) - sum(c.arrived for c in before.channels)
            shares.append(cpu / seconds)
            each.append(cpu / moved)
            arrived.append(len(delays) / sent)
        print(
            f"{size:4} B  {rate / 1e6:3.0f} Mbit/s   {100 * statistics.median(shares):8.1f} %"
            f"  {1e6 * statistics.median(each):12.1f} µs  {100 * statistics.median(arrived):6.1f} %"
        )


def delay(rounds: int, seconds: float) -> None:
    print("\nset        beyond it: median      p99")
    for set_ in (0.0, 0.02):
        middle, worst = [], []
        for _ in range(rounds):
            with Network(pair(delay=set_)) as network:
                _, delays = stream(network, 100 * 8 * 200, 200, seconds)
            beyond = sorted(each - set_ for each in delays)
            middle.append(statistics.median(beyond))
            worst.append(beyond[int(0.99 * len(beyond))])
        row = f"{1e3 * statistics.median(middle):11.2f} ms  {1e3 * statistics.median(worst):6.2f} ms"
        print(f"{1e3 * set_:3.0f} ms     {row}")


def most(rounds: int, seconds: float) -> None:
    rates = []
    for _ in range(rounds):
        with Network(pair()) as network:
            stream(network, 200e6, 1242, seconds)
            rates.append(8 * network.counters("w")[0].arrived_bytes / seconds)
    print(
        f"\none hop without a rate, offered 200 Mbit/s in frames of 1242 B: {statistics.median(rates) / 1e6:.0f} Mbit/s"
    )


async def routers(count: int) -> None:
    hosts: dict[str, Any] = {f"h{i}": {} for i in range(count)}
    pairs = [[f"h{i}", f"h{i + 1}"] for i in range(count - 1)]
    begun = time.monotonic()
    async with Lab(scenario(hosts=hosts, media=[{"kind": "radio", "name": "air", "pairs": pairs}])) as lab:
        await lab.ready(timeout=600.0)
        print(
            f"\n{count} hosts with a router each, started at once, take clients after {time.monotonic() - begun:.1f} s"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--routers", type=int, default=30)
    given = parser.parse_args()
    try:
        check_able()
    except LabError as e:
        print(f"skipped: {e}")
        return
    bring_up(given.rounds)
    cost(given.rounds, given.seconds)
    delay(given.rounds, given.seconds)
    most(given.rounds, given.seconds)
    asyncio.run(routers(given.routers))


if __name__ == "__main__":
    main()
