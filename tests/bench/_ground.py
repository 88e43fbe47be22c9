"""The ground's side of the setpoint benchmark, a process of its own: streams numbered velocities and prints when.

_ground.py zmav ENDPOINT RATE SECONDS      under a lease, through routers
_ground.py udp PORT RATE SECONDS           MAVLink straight to the autopilot's port
_ground.py zenoh ENDPOINT RATE SECONDS     the same frames over a bare Zenoh key, to _ground.py hop

_ground.py hop ENDPOINT PORT               that key to UDP: the least a Zenoh hop can cost from Python
"""

from __future__ import annotations

import asyncio
import json
import socket
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import zenoh

import zmav
from zmav.mavlink import Packer, load_dialect
from zmav.session import SessionSettings, open_session

STEP = 1e-3
"""m/s: setpoint number n asks for n times this to the north"""
KEY = "bench/setpoint"


def paced(rate: float, seconds: float, put: Callable[[int], None]) -> None:
    """Call ``put(n)`` evenly and print the monotonic time of each."""
    times, start = [], time.monotonic()
    for n in range(1, int(rate * seconds) + 1):
        time.sleep(max(start + n / rate - time.monotonic(), 0.0))
        times.append(time.monotonic())
        put(n)
    print(json.dumps(times), flush=True)


async def stream(endpoint: str, rate: float, seconds: float) -> None:
    async with zmav.open(connect=[endpoint]) as client:
        (vehicle,) = await client.wait_for("quad1", timeout=20.0)
        await vehicle.wait_until(lambda s: s.armed is True, 20.0)
        async with vehicle.lease("bench") as lease:
            lease.setpoint(vel=(0.0, 0.0, 0.0))
            await vehicle.wait_until(lambda s: s.setpoints.get("flown", 0) > 0, 20.0)
            print("ready", flush=True)
            times, start = [], time.monotonic()
            for n in range(1, int(rate * seconds) + 1):
                await asyncio.sleep(max(start + n / rate - time.monotonic(), 0.0))
                times.append(time.monotonic())
                lease.setpoint(vel=(n * STEP, 0.0, 0.0))
            print(json.dumps(times), flush=True)


def frames() -> Callable[[int], bytes]:
    packer = Packer(load_dialect(), 1, 191)
    return lambda n: packer.pack(
        "SET_POSITION_TARGET_LOCAL_NED",
        target_system=1,
        target_component=1,
        coordinate_frame=1,
        type_mask=0x0DC7,
        vx=n * STEP,
    )


def udp(port: str, rate: float, seconds: float) -> None:
    out, frame = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), frames()
    out.connect(("127.0.0.1", int(port)))
    print("ready", flush=True)
    paced(rate, seconds, lambda n: void(out.send(frame(n))))


def bare(endpoint: str, rate: float, seconds: float) -> None:
    frame = frames()
    with open_session(SessionSettings(connect=[endpoint])) as session:
        publisher = session.declare_publisher(KEY, congestion_control=zenoh.CongestionControl.DROP)
        while not _matched(publisher):
            time.sleep(0.05)
        print("ready", flush=True)
        paced(rate, seconds, lambda n: publisher.put(frame(n)))


def _matched(publisher: zenoh.Publisher) -> bool:
    status: Any = publisher.matching_status  # its stubs say bool, and its truth value means nothing
    return bool(status.matching)


def hop(endpoint: str, port: str) -> None:
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    out.connect(("127.0.0.1", int(port)))
    with open_session(SessionSettings(mode="router", listen=[endpoint])) as session:
        session.declare_subscriber(KEY, lambda sample: void(out.send(sample.payload.to_bytes())))
        threading.Event().wait()


def void(_: object) -> None:
    return None


if __name__ == "__main__":
    side, *rest = sys.argv[1:]
    if side == "hop":
        hop(rest[0], rest[1])
    elif side == "zmav":
        asyncio.run(stream(rest[0], float(rest[1]), float(rest[2])))
    else:
        {"udp": udp, "zenoh": bare}[side](rest[0], float(rest[1]), float(rest[2]))
