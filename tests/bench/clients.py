"""A message's way into a Python program: by zmav's stream, by MAVSDK's telemetry, by pymavlink's recv_match.

    python tests/bench/clients.py [--rounds 3] [--seconds 4] [--rate 100] [--json]

ATTITUDE comes by UDP, its time_boot_ms holding the microsecond at which it left; the sides take turns, medians over
rounds. CPU is the scheduler's, of every thread of a process: of the program, and with zmav also of 'zmav up', which is
what lets others read the same vehicle, and which is paid once.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import socket
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import zmav
from tests.ports import free_udp_ports
from zmav.mavlink import Packer, load_dialect
from zmav.process import free_port

WRAP = 1 << 32
SIDES = ("pymavlink", "MAVSDK", "zmav")


def age(stamp: int) -> int:
    """µs since that stamp."""
    return (time.monotonic_ns() // 1000 - stamp) % WRAP


def by_pymavlink(where: str, ages: list[int]) -> None:
    from pymavlink import mavutil

    source = mavutil.mavlink_connection(f"udpin:127.0.0.1:{where}", dialect="ardupilotmega")
    while True:
        message = source.recv_match(type="ATTITUDE", blocking=True, timeout=2.0)
        if message is None and ages:
            return
        if message is not None:
            ages.append(age(message.time_boot_ms))


async def by_mavsdk(where: str, ages: list[int]) -> None:
    from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
    from mavsdk.asyncio.plugins.telemetry import TelemetryAsync

    mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    await mavsdk.add_any_connection(f"udpin://127.0.0.1:{where}")
    attitudes = TelemetryAsync(await mavsdk.first_autopilot(30.0)).subscribe_attitude_euler()
    while True:
        try:
            attitude = await asyncio.wait_for(attitudes.__anext__(), 2.0 if ages else 30.0)
        except asyncio.TimeoutError:
            mavsdk.destroy()
            return
        ages.append(age(attitude.timestamp_us // 1000))


async def by_zmav(where: str, ages: list[int]) -> None:
    async with zmav.open(connect=[where]) as z:
        (vehicle,) = await z.wait_for("quad1", timeout=30.0)
        async with vehicle.stream("ATTITUDE") as stream:
            while True:
                try:
                    message = await asyncio.wait_for(stream.get(), 2.0 if ages else 30.0)
                except asyncio.TimeoutError:
                    return
                ages.append(age(int(message.fields["time_boot_ms"])))


def side(name: str, where: str) -> None:
    """One program: reads until nothing comes for two seconds, then says what it saw."""
    ages: list[int] = []
    if name == "pymavlink":
        by_pymavlink(where, ages)
    else:
        asyncio.run((by_mavsdk if name == "MAVSDK" else by_zmav)(where, ages))
    print(json.dumps(ages), flush=True)
    os._exit(0)  # MAVSDK's threads do not end by themselves


def cpu_us(process: subprocess.Popen[str]) -> float:
    tasks = Path(f"/proc/{process.pid}/task").glob("*/schedstat")
    return sum(int(task.read_text().split()[0]) for task in tasks) / 1e3


def run(name: str, rate: float, seconds: float) -> dict[str, Any]:
    port = free_udp_ports(1)
    where, others = str(port), []
    if name == "zmav":
        where = f"tcp/127.0.0.1:{free_port()}"
        up = ("-m", "zmav", "up", "--link", f"udpin:127.0.0.1:{port}", "-l", where)
        others = [subprocess.Popen([sys.executable, *up], stderr=subprocess.DEVNULL, text=True)]
    command = [sys.executable, __file__, "--side", name, where]
    program = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    sides = [program, *others]
    try:
        sent, used = _send(port, rate, seconds, sides)
        told = program.communicate(timeout=30.0)[0]
    finally:
        for each in sides:
            each.kill()
            each.wait()
    ages = sorted(json.loads(told.splitlines()[-1])[-sent:])
    return {
        "p50": statistics.median(ages),
        "p99": ages[int(0.99 * (len(ages) - 1))],
        "came": len(ages) / sent,
        "cpu": [each / sent for each in used],
    }


def _send(port: int, rate: float, seconds: float, sides: list[subprocess.Popen[str]]) -> tuple[int, list[float]]:
    """Heartbeats and attitudes, five seconds of them for who must find a vehicle first; what the rest of them cost."""
    packer, out = Packer(load_dialect(), 1, 1), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    out.connect(("127.0.0.1", port))
    before: list[float] = []
    sent, begun, head = 0, time.monotonic(), 5.0
    for number in range(int(rate * (head + seconds))):
        time.sleep(max(0.0, begun + number / rate - time.monotonic()))
        if number >= rate * head:
            before = before or [cpu_us(each) for each in sides]
            sent += 1
        try:
            if number % int(rate) == 0:
                out.send(
                    packer.pack("HEARTBEAT", type=2, autopilot=12, base_mode=81, system_status=3, mavlink_version=3)
                )
            out.send(packer.pack("ATTITUDE", time_boot_ms=time.monotonic_ns() // 1000 % WRAP))
        except ConnectionRefusedError:
            continue
    return sent, [cpu_us(each) - at for each, at in zip(sides, before, strict=True)]


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--rounds", type=int, default=3)
    options.add_argument("--seconds", type=float, default=4.0)
    options.add_argument("--rate", type=float, default=100.0)
    options.add_argument("--json", action="store_true")
    options.add_argument("--side", nargs=2, help=argparse.SUPPRESS)
    given = options.parse_args()
    if given.side:
        side(*given.side)
    rounds: dict[str, list[dict[str, Any]]] = {name: [] for name in SIDES}
    for _ in range(given.rounds):
        for name in SIDES:
            rounds[name].append(run(name, given.rate, given.seconds))
    for name, found in rounds.items():
        row: dict[str, Any] = {key: statistics.median(each[key] for each in found) for key in ("p50", "p99", "came")}
        row["cpu"] = [statistics.median(each) for each in zip(*(each["cpu"] for each in found), strict=True)]
        if given.json:
            print(json.dumps({"side": name, "rate": given.rate, **row}))
        else:
            cpu = " + ".join(f"{each:.0f}" for each in row["cpu"])
            print(f"{name:10} p50 {row['p50']:7.0f} µs  p99 {row['p99']:7.0f} µs  came {row['came']:.1%}  CPU {cpu} µs")


if __name__ == "__main__":
    main()
