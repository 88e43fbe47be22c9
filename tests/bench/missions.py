"""A mission's upload: zmav, which reads back what the autopilot keeps, beside pymavlink, which does not and which does.

    python tests/bench/missions.py [--link URL] [--items 100] [--rounds 5] [--delay 20] [--px4]

Without a link a simulated vehicle in a process of its own; with one, any autopilot's that takes missions on the ground:
its mission is replaced. TCP on loopback, in turns: medians, and the quickest, which are what a busy machine leaves to
compare. Ours is from the order to its outcome, by one hop. What was there is read first, so that a failed upload can be
undone: "download" is both readings.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import multiprocessing
import queue
import socket
import statistics
import tempfile
import threading
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection
from typing import Any

from pymavlink import mavutil

import zmav
from zmav import wire
from zmav.onboard import Onboard, OnboardSettings
from zmav.process import free_port
from zmav.session import SessionSettings, open_session
from zmav.sim import World

HOME = (-35.363261, 149.165230, 584.0)
WAYPOINT = 16


def serve(pipe: Connection, px4: bool) -> None:
    """A simulated vehicle, until the other end of ``pipe`` says so."""
    with World(copters=not px4, px4=px4, endpoint="tcp:0", ready_s=0.5) as world:
        pipe.send(world.urls[0])
        pipe.recv()


def places(items: int, moved: float) -> list[tuple[float, float, float]]:
    return [(HOME[0] + 1e-5 * n, HOME[1] + moved, 20.0) for n in range(items)]


def theirs(url: str, items: int, moved: float, *, read_back: bool) -> float:
    """Seconds by the protocol as pymavlink's users write it."""
    link: Any = mavutil.mavlink_connection(url, source_system=250)
    link.wait_heartbeat(timeout=30)
    where = (link.target_system, link.target_component)
    plan = (
        [(*HOME[:2], HOME[2]), *places(items, moved)]
        if link.messages["HEARTBEAT"].autopilot == 3
        else places(items, moved)
    )
    begun = time.monotonic()
    link.mav.mission_count_send(*where, len(plan), 0)
    while True:
        heard = link.recv_match(
            type=["MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK"], blocking=True, timeout=5
        )
        if heard is None or heard.get_type() == "MISSION_ACK":
            break
        lat, lon, alt = plan[heard.seq]
        link.mav.mission_item_int_send(
            *where, heard.seq, 3, WAYPOINT, 0, 1, 0, 0, 0, 0, round(lat * 1e7), round(lon * 1e7), alt, 0
        )
    assert heard is not None and heard.type == 0, heard
    if read_back:
        link.mav.mission_request_list_send(*where, 0)
        count = link.recv_match(type="MISSION_COUNT", blocking=True, timeout=5).count
        assert count == len(plan)
        for seq in range(count):
            link.mav.mission_request_int_send(*where, seq, 0)
            assert link.recv_match(type="MISSION_ITEM_INT", blocking=True, timeout=5).seq == seq
        link.mav.mission_ack_send(*where, 0, 0)
    took = time.monotonic() - begun
    link.close()
    return took


class Timed:
    """A transfer that notes how long each of its transactions takes."""

    def __init__(self, transfer: Any, phases: dict[str, list[float]]) -> None:
        self._transfer, self._phases = transfer, phases

    def __getattr__(self, name: str) -> Any:
        async def timed(*args: Any) -> Any:
            begun = time.monotonic()
            try:
                return await getattr(self._transfer, name)(*args)
            finally:
                self._phases.setdefault(name, []).append(time.monotonic() - begun)

        return timed


@contextlib.contextmanager
def delayed(url: str, delay: float) -> Iterator[str]:
    """A link of its own to ``url``, whose bytes come ``delay`` s late in both directions."""
    if not delay:
        yield url
        return
    _, host, port = url.split(":")
    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection((host, int(port))) as far:

        def serve() -> None:
            near, _ = server.accept()
            for source, sink in ((near, far), (far, near)):
                late: queue.SimpleQueue[tuple[float, bytes]] = queue.SimpleQueue()
                threading.Thread(target=_take, args=(source, late, delay), daemon=True).start()
                threading.Thread(target=_give, args=(late, sink), daemon=True).start()

        threading.Thread(target=serve, daemon=True).start()
        yield f"tcp:127.0.0.1:{server.getsockname()[1]}"
        with contextlib.suppress(OSError):  # the other side was faster
            far.shutdown(socket.SHUT_RDWR)


def _take(source: socket.socket, late: queue.SimpleQueue[tuple[float, bytes]], delay: float) -> None:
    with contextlib.suppress(OSError):
        source.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        while data := source.recv(65536):
            late.put((time.monotonic() + delay, data))
    late.put((0.0, b""))


def _give(late: queue.SimpleQueue[tuple[float, bytes]], sink: socket.socket) -> None:
    with contextlib.suppress(OSError):
        while (due := late.get())[1]:
            time.sleep(max(due[0] - time.monotonic(), 0.0))
            sink.sendall(due[1])
        sink.shutdown(socket.SHUT_RDWR)


async def ours(url: str, items: int, moved: float, phases: dict[str, list[float]]) -> float:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with (
        tempfile.TemporaryDirectory() as folder,
        open_session(SessionSettings(mode="router", listen=[endpoint])) as session,
    ):
        settings = OnboardSettings(link=url, name="quad1", cache=folder)
        async with Onboard(session, settings) as onboard, zmav.open(connect=[endpoint]) as z:
            v = z.vehicle("quad1")
            await v.wait_until(lambda s: s.connected and s.uid is not None, 30.0)  # it has said what it is
            plan = [
                wire.MissionItem(command="MAV_CMD_NAV_WAYPOINT", x=lat, y=lon, z=alt)
                for lat, lon, alt in places(items, moved)
            ]
            missions: Any = onboard.missions
            transfer = missions._transfer
            missions._transfer = lambda kind: Timed(transfer(kind), phases)
            begun = time.monotonic()
            await v.missions.upload(plan)
            return time.monotonic() - begun


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--link")
    options.add_argument("--items", type=int, default=100)
    options.add_argument("--rounds", type=int, default=5)
    options.add_argument("--delay", type=float, default=0.0, help="ms each way")
    options.add_argument("--px4", action="store_true")
    args = options.parse_args()
    here, there = multiprocessing.Pipe()
    url, process = args.link, None
    if url is None:
        process = multiprocessing.get_context("spawn").Process(target=serve, args=(there, args.px4), daemon=True)
        process.start()
        url = here.recv()
    found: dict[str, list[float]] = {}
    phases: dict[str, list[float]] = {}
    for n in range(args.rounds):
        for name, back in (("pymavlink", False), ("pymavlink, read back", True)):
            with delayed(url, args.delay / 1e3) as late:
                found.setdefault(name, []).append(theirs(late, args.items, 1e-4 * (n + 1), read_back=back))
        with delayed(url, args.delay / 1e3) as late:
            found.setdefault("zmav", []).append(asyncio.run(ours(late, args.items, -1e-4 * (n + 1), phases)))
    for words, which in (("median", statistics.median), ("quickest", min)):
        took = {name: which(each) for name, each in found.items()}
        for name, seconds in took.items():
            each = f"{1e3 * seconds:8.0f} ms  {1e3 * seconds / args.items:6.2f} ms an item"
            print(f"{name:22} {words:9} {each}  x{took['zmav'] / seconds:.2f}")
    parts = (f"{name} {1e3 * sum(each) / args.rounds:.0f} ms" for name, each in phases.items())
    print("of which, in the mean:", ", ".join(parts))
    if process is not None:
        here.send(None)
        process.join(10.0)


if __name__ == "__main__":
    main()
