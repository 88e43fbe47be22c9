"""What the gateway's benchmark runs, each a process of its own until killed; frames carry the time at which they left.

_http_sides.py zenoh ENDPOINT RATE            a router that puts GPS_RAW_INT on its key, RATE a second
_http_sides.py udp PORT RATE                  the same frames by UDP
_http_sides.py pymavlink PORT_IN PORT_WS      pymavlink, json and websockets, as one would write it in an afternoon
_http_sides.py clients URL COUNT SECONDS      WebSocket clients; prints their latencies in µs as JSON
"""

from __future__ import annotations

import asyncio
import json
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from websockets.asyncio.client import connect
from websockets.asyncio.server import ServerConnection, broadcast, serve

from zmav import keys
from zmav.mavlink import Packer, load_dialect
from zmav.session import SessionSettings, open_session

MESSAGE = "GPS_RAW_INT"


def frames(rate: float) -> Iterator[bytes]:
    """Evenly, for ever; ``time_usec`` is the monotonic clock in ns."""
    packer = Packer(load_dialect(), 1, 1)
    start = time.monotonic()
    number = 0
    while True:
        number += 1
        time.sleep(max(start + number / rate - time.monotonic(), 0.0))
        yield packer.pack(
            MESSAGE,
            time_usec=time.monotonic_ns(),
            fix_type=3,
            lat=-353632610,
            lon=1491652300,
            alt=584090,
            eph=121,
            epv=200,
            vel=10,
            cog=18000,
            satellites_visible=10,
        )


def zenoh(endpoint: str, rate: str) -> None:
    with open_session(SessionSettings(mode="router", listen=[endpoint])) as session:
        key = keys.RX.key("demo", "quad1", sys=1, comp=1, msg=MESSAGE)
        publisher = session.declare_publisher(key, **keys.RX.qos.options())
        _send(publisher.put, rate)


def udp(port: str, rate: str) -> None:
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    target = ("127.0.0.1", int(port))
    _send(lambda frame: out.sendto(frame, target), rate)


def _send(put: Callable[[bytes], object], rate: str) -> None:
    for frame in frames(float(rate)):
        put(frame)


def pymavlink(port_in: str, port_ws: str) -> None:
    from pymavlink import mavutil

    clients: set[ServerConnection] = set()

    async def handle(client: ServerConnection) -> None:
        clients.add(client)
        try:
            await client.wait_closed()
        finally:
            clients.discard(client)

    async def run() -> None:
        loop = asyncio.get_running_loop()

        def receive() -> None:
            source: Any = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port_in}", dialect="ardupilotmega")
            while True:
                message = source.recv_match(blocking=True)
                if message is not None and message.get_type() != "BAD_DATA":
                    text = json.dumps({"message": message.to_dict()})
                    loop.call_soon_threadsafe(broadcast, clients, text)

        threading.Thread(target=receive, daemon=True).start()
        async with serve(handle, "127.0.0.1", int(port_ws), compression=None):
            await asyncio.Event().wait()

    asyncio.run(run())


def clients(url: str, count: str, seconds: str) -> None:
    latencies: list[float] = []

    async def read() -> None:
        async with connect(url, compression=None) as socket:
            await socket.recv()
            end = time.monotonic() + float(seconds)
            while time.monotonic() < end:
                document = json.loads(await socket.recv())
                latencies.append((time.monotonic_ns() - document["message"]["time_usec"]) / 1e3)

    async def run() -> None:
        await asyncio.gather(*(read() for _ in range(int(count))))

    asyncio.run(run())
    print(json.dumps(latencies))


if __name__ == "__main__":
    sides: dict[str, Callable[..., None]] = {"zenoh": zenoh, "udp": udp, "pymavlink": pymavlink, "clients": clients}
    sides[sys.argv[1]](*sys.argv[2:])
