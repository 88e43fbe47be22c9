"""What it costs to form a fleet and to keep it: routers on one segment, linked each with each or each with a few.

All are in one process, on addresses of loopback: as root in a namespace of its own, so that its counters hold their
bytes and nothing else; others should run it alone. With 30 routers each linked with each, two cores are too few: the
keep-alives come too late, and links come and go.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import zenoh

from mesh.lab import kernel
from mesh.neighbours import few
from zmav.session import SessionSettings, open_session

PORT = 17447
LINE = "{:>7} {:>5} {:>6} {:>6} {:>8} {:>9} {:>11} {:>10} {:>11}"
IDLE_S = 5.0
PATIENCE_S = 60.0


def main() -> None:
    """The median of three, for growing fleets."""
    print(LINE.format("routers", "kind", "links", "lease", "formed", "B/link", "idle B/s", "packets/s", "fleet kB/s"))
    for kind, number, lease in (
        ("each", 8, 1000),
        ("each", 8, 2000),
        ("few", 16, 2000),
        ("each", 16, 2000),
        ("few", 30, 2000),
    ):
        with multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1) as pool:  # ports are let go late
            runs = [pool.apply(run, (kind, number, lease, PORT)) for _ in range(3)]
        links, (formed, opening, idle, packets) = (
            runs[0][0],
            (statistics.median(row[i] for row in runs) for i in range(1, 5)),
        )
        print(
            LINE.format(
                number,
                kind,
                links,
                f"{lease / 1000:g} s",
                f"{formed:.2f} s",
                f"{opening / links:.0f}",
                f"{idle / links:.0f}",
                f"{packets / links:.1f}",
                f"{idle / 1000:.1f}",
            )
        )


def run(kind: str, number: int, lease: int, port: int) -> tuple[int, float, float, float, float]:
    """Links, seconds to form, bytes to form, bytes and packets a second when idle."""
    if os.geteuid() == 0:
        kernel.unshare(kernel.CLONE_NEWNET)
        kernel.bring_up("lo")
    names = [f"h{each:02}" for each in range(1, number + 1)]
    linked = {name: few([n for n in names if n != name], name) if kind == "few" else names for name in names}
    calls = {name: [other for other in linked[name] if name < other] for name in names}
    links = sum(map(len, calls.values()))
    before, start = counted(), time.monotonic()
    routers = [opened(names, name, calls[name], lease, port) for name in names]
    try:
        wait(lambda: sum(len(list(router.info.routers_zid())) for router in routers) == 2 * links)
        formed, then = time.monotonic() - start, counted()
        time.sleep(2.0)  # what was still under way
        idle = counted()
        time.sleep(IDLE_S)
        after = counted()
    finally:
        for router in routers:
            with contextlib.suppress(zenoh.ZError):  # it was calling somebody in vain
                router.close()
    return links, formed, then[0] - before[0], (after[0] - idle[0]) / IDLE_S, (after[1] - idle[1]) / IDLE_S


def opened(names: list[str], name: str, calls: list[str], lease: int, port: int) -> zenoh.Session:
    def place(host: str) -> str:
        return f"udp/127.0.1.{names.index(host) + 1}:{port}?rel=1;mixed_rel=1"

    cfg = [f"transport/link/tx/lease:{lease}", "scouting/delay:0"]
    listen, connect = [place(name)], [place(each) for each in calls]
    return open_session(SessionSettings(mode="router", listen=listen, connect=connect, cfg=cfg))


def counted() -> tuple[int, int]:
    """Bytes and packets that loopback has carried."""
    line = next(each for each in Path("/proc/net/dev").read_text().splitlines() if each.strip().startswith("lo:"))
    fields = line.partition(":")[2].split()
    return int(fields[0]), int(fields[1])


def wait(true: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE_S
    while not true() and time.monotonic() < end:
        time.sleep(0.02)


if __name__ == "__main__":
    main()
