"""One router of :mod:`tests.bench.mesh_bench`, which can also do the same without our measuring, for comparison.

    python tests/bench/_bench_node.py NAME LISTEN [CONNECT]

A line on standard input is a task with its numbers (zsend, zreceive, usend, ureceive, zping, zecho, uping, uecho);
a line of JSON on standard output is what came of it.
"""

from __future__ import annotations

import asyncio
import json
import socket
import statistics
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import zenoh

from mesh.bench.responder import Responder
from mesh.plan import RouterPlan
from mesh.router import Router
from zmav import keys
from zmav.config import Host
from zmav.session import SessionSettings

KEY, BACK = "zmav/raw/there", "zmav/raw/back"
QUIET = 0.5
"""s without a datagram after which a receiver has all it will get"""
BUFFER = 4 << 20


class Raw:
    """Zenoh and UDP as bare as Python has them."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session

    def zsend(self, seconds: float, size: int) -> dict[str, float]:
        """As fast as it goes, in the class that the measurement has."""
        publisher = self._session.declare_publisher(KEY, **keys.Qos.LATEST_WINS.options())
        found = _send(publisher.put, seconds, size)
        publisher.undeclare()
        return found

    def zreceive(self) -> dict[str, float]:
        counter = _Counter()
        subscriber = self._session.declare_subscriber(KEY, lambda sample: counter.take(len(sample.payload)))
        found = counter.wait()
        subscriber.undeclare()
        return found

    def usend(self, port: int, seconds: float, size: int) -> dict[str, float]:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            out.connect(("127.0.0.1", port))
            return _send(out.send, seconds, size)

    def ureceive(self) -> dict[str, float]:
        with _listening() as listen:
            counter = _Counter()
            print(json.dumps({"port": listen.getsockname()[1]}), flush=True)
            threading.Thread(target=_pump, args=(listen, counter), daemon=True).start()
            return counter.wait()

    def zping(self, count: int, hz: float) -> dict[str, float]:
        publisher = self._session.declare_publisher(KEY, **keys.Qos.REALTIME.options())
        back, at = threading.Event(), [0]

        def take(sample: zenoh.Sample) -> None:
            at[0] = time.monotonic_ns()
            back.set()

        subscriber = self._session.declare_subscriber(BACK, take)
        found = _ping(lambda: publisher.put(bytes(64)), back, at, count, hz)
        subscriber.undeclare()
        publisher.undeclare()
        return found

    def zecho(self, seconds: float) -> dict[str, float]:
        publisher = self._session.declare_publisher(BACK, **keys.Qos.REALTIME.options())
        subscriber = self._session.declare_subscriber(KEY, lambda sample: publisher.put(sample.payload))
        time.sleep(seconds)
        subscriber.undeclare()
        publisher.undeclare()
        return {}

    def uping(self, port: int, count: int, hz: float) -> dict[str, float]:
        back, at = threading.Event(), [0]
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            out.connect(("127.0.0.1", port))
            out.settimeout(0.2)
            over = False

            def receive() -> None:
                while not over:
                    try:
                        out.recv(100)
                    except OSError:
                        continue
                    at[0] = time.monotonic_ns()
                    back.set()

            thread = threading.Thread(target=receive)
            thread.start()
            found = _ping(lambda: out.send(bytes(64)), back, at, count, hz)
            over = True
            thread.join()
        return found

    def uecho(self, seconds: float) -> dict[str, float]:
        with _listening() as listen:
            print(json.dumps({"port": listen.getsockname()[1]}), flush=True)
            listen.settimeout(0.2)
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                try:
                    data, peer = listen.recvfrom(100)
                except OSError:
                    continue
                listen.sendto(data, peer)
        return {}


class _Counter:
    """What came, and when the first and the last of it."""

    def __init__(self) -> None:
        self.count = self.bytes = 0
        self.first = self.last = 0.0

    def take(self, size: int) -> None:
        self.last = time.monotonic()
        self.first = self.first or self.last
        self.count += 1
        self.bytes += size

    def wait(self) -> dict[str, float]:
        while not self.count or time.monotonic() - self.last < QUIET:
            time.sleep(0.05)
        span = max(self.last - self.first, 1e-9)
        return {"count": self.count, "per_second": self.count / span, "bits": 8.0 * self.bytes / span}


def _listening() -> socket.socket:
    listen = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    listen.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
    listen.bind(("127.0.0.1", 0))
    return listen


def _pump(listen: socket.socket, counter: _Counter) -> None:
    while True:
        try:
            counter.take(len(listen.recv(65_536)))
        except OSError:
            return


def _send(put: Callable[[bytes], Any], seconds: float, size: int) -> dict[str, float]:
    payload, count, start = bytes(size), 0, time.monotonic()
    while time.monotonic() - start < seconds:
        put(payload)
        count += 1
    return {"count": count, "per_second": count / (time.monotonic() - start)}


def _ping(send: Callable[[], Any], back: threading.Event, at: list[int], count: int, hz: float) -> dict[str, float]:
    trips: list[float] = []
    for _ in range(count):
        back.clear()
        left = time.monotonic_ns()
        send()
        if back.wait(1.0):
            trips.append((at[0] - left) / 1e9)
        time.sleep(1.0 / hz)
    return {"median": statistics.median(trips), "p99": statistics.quantiles(trips, n=100)[98], "count": len(trips)}


async def main() -> None:
    name, listen, *connect = sys.argv[1:]
    plan = RouterPlan(fleet="demo", name=name, profile="lan", host=Host(), settings={})
    settings = SessionSettings(listen=listen.split(","), connect=connect)
    async with Router(plan, settings, parts=(Responder,)) as router:
        raw = Raw(router.session)
        print(json.dumps({"up": name}), flush=True)
        while line := await asyncio.to_thread(sys.stdin.readline):
            task, *numbers = line.split()
            values = [float(n) if "." in n else int(n) for n in numbers]
            print(json.dumps(await asyncio.to_thread(getattr(raw, task), *values)), flush=True)


if __name__ == "__main__":
    asyncio.run(main())
