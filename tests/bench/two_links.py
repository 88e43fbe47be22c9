"""A link of 200 ms that loses 10 % each way: one link for all, and a second one for what is sent once.

    python tests/bench/two_links.py [SECONDS]

Two routers in this process, a relay between them. "one": UDP with QUIC's repeats for what is reliable, and its
datagrams for the rest (?rel=1;mixed_rel=1). "two": the same for what is reliable, and plain UDP beside it (?rel=0, with
transport/unicast/max_links 2). Sent are 10 states a second, 55 kB/s of pictures in chunks (both best effort), and two
reliable messages a second. Printed is what came of each, and how late.
"""

from __future__ import annotations

import contextlib
import socket
import statistics
import struct
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import zenoh

from tests.bench._relay import Relay
from zmav.process import free_port
from zmav.session import SessionSettings, open_session

TICK, CHUNKS = 0.1, 5
AFTER = 10.0
"""s until the plain link opens: alone at first, it would lose declarations, which nobody repeats"""
SIZES = {"state": 200, "picture": 1100, "reliable": 100}
LINKS = {"one": ["?rel=1;mixed_rel=1"], "two": ["?rel=1", "?rel=0"]}


def router(listen: list[str], connect: list[str], links: int) -> zenoh.Session:
    # Opening takes two round trips of 0.4 s, and what is lost on them.
    values = {"max_links": links, "open_timeout": 3000, "accept_timeout": 3000}
    cfg = tuple(f"transport/unicast/{name}:{value}" for name, value in values.items())
    return open_session(SessionSettings(mode="router", listen=tuple(listen), connect=tuple(connect), cfg=cfg))


def run(name: str, seconds: float) -> None:
    kinds, came = LINKS[name], {what: list[float]() for what in SIZES}
    with contextlib.ExitStack() as stack:
        ports = [free_port(socket.SOCK_DGRAM) for _ in kinds]
        relays = [Relay(port, 0.2, 0.1, seed=i, after=AFTER * i) for i, port in enumerate(ports)]
        far = [stack.enter_context(relay).port for relay in relays]
        near = stack.enter_context(
            router([f"udp/127.0.0.1:{p}{k}" for p, k in zip(ports, kinds, strict=True)], [], len(kinds))
        )
        away = stack.enter_context(
            router([], [f"udp/127.0.0.1:{p}{k}" for p, k in zip(far, kinds, strict=True)], len(kinds))
        )
        puts = {}
        for what in SIZES:

            def take(sample: zenoh.Sample, what: str = what) -> None:
                (sent,) = struct.unpack_from("d", sample.payload.to_bytes())
                came[what].append(1e3 * (time.time() - sent))

            away.declare_subscriber(f"bench/{what}", take)
            lane = zenoh.Reliability.RELIABLE if what == "reliable" else zenoh.Reliability.BEST_EFFORT
            priority = zenoh.Priority.BACKGROUND if what == "picture" else zenoh.Priority.INTERACTIVE_HIGH
            puts[what] = near.declare_publisher(f"bench/{what}", reliability=lane, priority=priority)
        deadline = time.monotonic() + 60.0
        # Zenoh's stub says that it is a bool.
        while not all(put.matching_status.matching for put in puts.values()):  # type: ignore[attr-defined]
            if time.monotonic() > deadline:
                raise SystemExit(f"{name}: the two have not met within 60 s")
            time.sleep(0.1)
        time.sleep(AFTER + 3.0)
        sent = dict.fromkeys(SIZES, 0)
        for tick in range(round(seconds / TICK)):
            for what, count in (("state", 1), ("picture", CHUNKS), ("reliable", int(tick % 5 == 0))):
                for _ in range(count):
                    puts[what].put(struct.pack("d", time.time()).ljust(SIZES[what], b"x"))
                    sent[what] += 1
            time.sleep(TICK)
        time.sleep(2.0)
    for what, delays in came.items():
        middle, most = (statistics.median(delays), max(delays)) if delays else (float("nan"), float("nan"))
        share = 100.0 * len(delays) / sent[what]
        print(f"{name:4} {what:9} {share:5.1f} % of {sent[what]:4} came, {middle:6.0f} ms median, {most:6.0f} at most")


if __name__ == "__main__":
    for each in LINKS:
        run(each, float(sys.argv[1]) if len(sys.argv) > 1 else 15.0)
