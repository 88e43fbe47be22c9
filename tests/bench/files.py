"""Files and logs: how fast they come from an autopilot, here and by pymavlink's own clients.

    python tests/bench/files.py [URL PATH LOG]

Without arguments a simulated vehicle in a process of its own holds a file and a log of a megabyte each. With them: any
autopilot's link (tcp:127.0.0.1:5760), a file on it and the number of one of its logs; nothing is written there. Each is
fetched to this machine by one hop, over TCP on loopback, by one client at a time, in turns; the best of three counts.
Bytes a second, and milliseconds of CPU a megabyte (with us: adapter, services, router and ground together); the ratio
is ours to pymavlink's.
"""

from __future__ import annotations

import asyncio
import multiprocessing
import sys
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple

from pymavlink import mavftp, mavutil

import zmav
from zmav.mavlink.ftp import MOST_DATA
from zmav.onboard import Onboard, OnboardSettings
from zmav.session import SessionSettings, open_session
from zmav.sim import World
from zmav.sim.protocol.ardupilot.node import MavNode

SIZE = 1_000_000
FILE, UPLOAD = "/APM/bench.bin", "/APM/scripts/bench.bin"
UPLOADED = 200_000
ROUNDS = 3
SPEED = 8.0
"""of the simulated vehicle, so that its own pace is not what is measured"""


class Best(NamedTuple):
    """Bytes a second, and s of CPU a byte."""

    rate: float
    cpu: float


class Stopwatch:
    """Notes the best of several runs of each kind."""

    def __init__(self) -> None:
        self.best: dict[str, Best] = {}
        self._start = self._cpu = 0.0

    def start(self) -> None:
        self._start, self._cpu = time.monotonic(), time.process_time()

    def stop(self, what: str, count: int) -> None:
        found = Best(count / (time.monotonic() - self._start), (time.process_time() - self._cpu) / max(count, 1))
        if what not in self.best or found.rate > self.best[what].rate:
            self.best[what] = found


def serve(pipe: Connection) -> None:
    """A simulated vehicle, until the other end of ``pipe`` says so."""
    data = bytes(range(250)) * (SIZE // 250)
    with World(copters=1, endpoint="tcp:0", ready_s=0.5, speed=SPEED) as world:
        node = world.vehicles[0].node
        assert isinstance(node, MavNode)
        storage = node.storage

        def fill() -> None:
            storage.files.create(FILE)
            storage.files.write(FILE, 0, data)
            storage.logs.begin(bytearray(data), time.time())

        world.call(fill)
        pipe.send(world.urls[0])
        pipe.recv()


def theirs(watch: Stopwatch, url: str, path: str, log: int, upload: bytes) -> None:
    """pymavlink's MAVFTP with full packets, and the log protocol as its users write it."""
    link = mavutil.mavlink_connection(url, source_system=250)
    link.wait_heartbeat(timeout=30)
    with tempfile.TemporaryDirectory() as folder:
        target, source = Path(folder, "got"), Path(folder, "source")
        source.write_bytes(upload)
        ftp = mavftp.MAVFTP(link, link.target_system, link.target_component)
        ftp.ftp_settings.burst_read_size = ftp.ftp_settings.write_size = MOST_DATA
        watch.start()
        ftp.cmd_get([path, str(target)])
        if ftp.process_ftp_reply("get", timeout=600).error_code == 0:
            watch.stop("get a file", target.stat().st_size)
        if upload:
            watch.start()
            ftp.cmd_put([str(source), UPLOAD])
            if ftp.process_ftp_reply("put", timeout=600).error_code == 0:
                watch.stop("put a file", len(upload))
    where = (link.target_system, link.target_component)
    link.mav.log_request_list_send(*where, 0, 0xFFFF)
    entry = link.recv_match(type="LOG_ENTRY", blocking=True, timeout=10, condition=f"LOG_ENTRY.id=={log}")
    came = 0
    watch.start()
    link.mav.log_request_data_send(*where, log, 0, 0xFFFFFFFF)
    while entry is not None and came < entry.size:
        message = link.recv_match(type="LOG_DATA", blocking=True, timeout=10)
        if message is None:
            break
        came += message.count
    watch.stop("get a log", came)
    link.close()


async def ours(watch: Stopwatch, url: str, path: str, log: int, upload: bytes) -> None:
    """From the order to the file's last byte on the ground's disk, checksums included."""
    with (
        tempfile.TemporaryDirectory() as folder,
        open_session(SessionSettings(mode="router", listen=["tcp/127.0.0.1:17953"])) as session,
    ):
        settings = OnboardSettings(link=url, name="quad1", cache=folder)
        async with Onboard(session, settings), zmav.open(connect=["tcp/127.0.0.1:17953"]) as z:
            v = z.vehicle("quad1")
            await v.wait_until(lambda s: s.connected, 30.0)
            watch.start()
            watch.stop("get a file", (await v.files.get(path, Path(folder, "file"))).stat().st_size)
            if upload:
                watch.start()
                await v.files.put_bytes(upload, UPLOAD)
                watch.stop("put a file", len(upload))
            watch.start()
            watch.stop("get a log", (await v.logs.get(log, Path(folder, "log"))).stat().st_size)


def compare(url: str, path: str, log: int, upload: bytes) -> None:
    their, our = Stopwatch(), Stopwatch()
    for _ in range(ROUNDS):
        theirs(their, url, path, log, upload)
        asyncio.run(ours(our, url, path, log, upload))
    print(f"{'':14}{'zmav B/s':>12}{'ms CPU/MB':>11}{'pymavlink B/s':>15}{'ms CPU/MB':>11}{'ratio':>7}")
    for what, mine in our.best.items():
        other = their.best.get(what, Best(0.0, 0.0))
        ratio = f"{mine.rate / other.rate:7.2f}" if other.rate else ""
        print(f"{what:14}{mine.rate:12,.0f}{mine.cpu * 1e9:11.0f}{other.rate:15,.0f}{other.cpu * 1e9:11.0f}{ratio}")


def main() -> None:
    if len(sys.argv) == 4:
        compare(sys.argv[1], sys.argv[2], int(sys.argv[3]), b"")
        return
    here, there = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(target=serve, args=(there,), daemon=True)
    process.start()
    compare(here.recv(), FILE, 1, bytes(UPLOADED))
    here.send(None)
    process.join(10.0)


if __name__ == "__main__":
    main()
