"""What ``zmav top`` costs: its CPU on a terminal of 160 by 50 beside 1, 10 and 50 vehicles, and the parts of a frame.

The vehicles only speak: a state of the usual size at 5 Hz, and answers to the monitor's queries.
"""

from __future__ import annotations

import asyncio
import fcntl
import os
import pty
import signal
import socket
import statistics
import struct
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import zenoh

import zmav
from ground.top.cli import Painter
from ground.top.screen import Ui, draw
from ground.top.watch import Watch
from zmav import keys, wire
from zmav.session import SessionSettings, open_session

SIZE = (160, 50)
SECONDS = 8.0
ROUNDS = 30


class Fleet:
    """So many vehicles in a router of this process."""

    def __init__(self, count: int) -> None:
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
        self.session = open_session(SessionSettings(mode="router", listen=[self.endpoint], cfg=("scouting/delay:0",)))
        self._names = [f"quad{i:02d}" for i in range(count)]
        self._kept: list[Any] = [self._answer(name) for name in self._names]
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._speak)
        self._thread.start()

    def _answer(self, name: str) -> Any:
        key = keys.LINK.key("demo", name, link="autopilot")
        link = wire.LinkQuality(
            t=0.0, name="autopilot", url="/dev/ttyACM0", state="up", age=0.1, rx_rate=90.0, rx_bytes_rate=4e3, loss=0.01
        )

        def answer(query: zenoh.Query) -> None:
            with query:
                query.reply(key, wire.encode(link))

        return self.session.declare_queryable(key, answer)

    def _speak(self) -> None:
        while not self._over.wait(0.2):
            now = time.time()
            for i, name in enumerate(self._names):
                self.session.put(keys.STATE.key("demo", name), wire.encode(_state(name, i, now)))

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        self.session.close()


def _state(name: str, i: int, now: float) -> wire.VehicleState:
    return wire.VehicleState(
        t=now,
        fleet="demo",
        name=name,
        instance="a",
        connected=True,
        sysid=i + 1,
        compid=1,
        autopilot="ardupilot",
        kind="copter",
        firmware="4.7.0",
        mode="GUIDED",
        armed=True,
        status="ACTIVE",
        link="up",
        position=wire.GlobalPosition(lat_deg=-35.3, lon_deg=149.1, alt_amsl=600.0 + now % 7.0, alt_rel=now % 7.0),
        local=(1.0 * i, now % 5.0, -10.0),
        velocity=(1.0, 0.5, 0.0),
        attitude=wire.Attitude(roll=0.0, pitch=0.1, yaw=1.0),
        battery=wire.Battery(voltage=12.1, current=9.0, remaining=0.8),
        gps=wire.Gps(fix="3D_FIX", satellites=14, hdop=0.8),
        ages={"position": 0.1},
        setpoints={"flown": int(now)},
        lease=wire.LeaseInfo(holder="planner", expires=now + 2.5, number=1),
    )


def cpu(endpoint: str) -> float:
    """Share of one core that the live screen takes once it is up."""
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", SIZE[1], SIZE[0], 0, 0))
    process = subprocess.Popen(
        [sys.executable, "-m", "zmav", "top", "-e", endpoint],
        stdin=slave,
        stdout=slave,
        stderr=slave,
        env={**os.environ, "TERM": "xterm-256color"},
        start_new_session=True,
    )
    written = 0

    def drain() -> None:
        nonlocal written
        while data := os.read(master, 65536):
            written += len(data)

    threading.Thread(target=drain, daemon=True).start()
    while written < 5000:
        time.sleep(0.1)
    time.sleep(1.0)
    before, begun = _used(process.pid), time.monotonic()
    time.sleep(SECONDS)
    share = (_used(process.pid) - before) / (time.monotonic() - begun)
    process.send_signal(signal.SIGTERM)
    process.wait()
    return share


def _used(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


async def parts(endpoint: str) -> tuple[float, float, float, int]:
    """Milliseconds of CPU for a report, drawing it and painting it, medians; and the bytes of a frame."""
    async with zmav.open(connect=[endpoint]) as z:
        watch, ui, painter = Watch(z), Ui(), Painter()
        watching = asyncio.create_task(watch.run())
        await watch.settle(2.0)
        report = watch.report()
        lines = draw(ui, report, *SIZE)
        size = len(painter.paint(lines, SIZE[0]))
        found = (
            _median(watch.report),
            _median(lambda: draw(ui, report, *SIZE)),
            _median(lambda: painter.paint(lines, SIZE[0])),
        )
        watching.cancel()
        return (*found, size)


def _median(work: Callable[[], object]) -> float:
    taken = []
    for _ in range(ROUNDS):
        before = time.thread_time()
        work()
        taken.append(time.thread_time() - before)
    return 1e3 * statistics.median(taken)


def main() -> None:
    print(f"zmav top, {SIZE[0]} by {SIZE[1]}, four frames a second")
    print(f"{'vehicles':>8} {'CPU':>7} {'report':>10} {'draw':>10} {'paint':>10} {'frame':>9}")
    for count in (1, 10, 50):
        fleet = Fleet(count)
        try:
            report, drawing, painting, size = asyncio.run(parts(fleet.endpoint))
            share = cpu(fleet.endpoint)
        finally:
            fleet.close()
        print(f"{count:>8} {share:>7.1%} {report:>7.2f} ms {drawing:>7.2f} ms {painting:>7.2f} ms {size:>7} B")


if __name__ == "__main__":
    main()
