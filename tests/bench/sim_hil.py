"""How fast the simulator answers a flight stack in lock step, against what the stack needs in real time.

    python tests/bench/sim_hil.py [SECONDS]

For each airframe, steps a second of ArduPilot's JSON exchange over a loopback UDP socket (a bare client in a process of
its own that sends the next servo packet as soon as it has the answer), at the rate that ArduPilot asks for: 1200 Hz for
multirotors and all others alike (SIM_RATE_HZ). Then the same without a socket, which is what parsing, physics and
answering cost, and PX4's exchange (250 Hz) without a socket. A vehicle in real time takes the share of a core in the
last column.
"""

from __future__ import annotations

import selectors
import struct
import subprocess
import sys
import time

from zmav.hil.ardupilot import JsonVehicle
from zmav.hil.craft import craft
from zmav.hil.json_fdm import JsonFdm
from zmav.hil.plant import Plant
from zmav.hil.stream import SENSOR_HZ, HilStream
from zmav.mavlink import load_dialect
from zmav.sim.endpoints import Wiring
from zmav.sim.environment import Environment
from zmav.sim.fleets.base import Surroundings

JSON_HZ = 1200
AIRFRAMES = ("quad", "hexa", "rover", "plane")
FLYING = [1450] * 16

CLIENT = f"""
import socket, struct, sys
line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
line.connect(("127.0.0.1", int(sys.argv[1])))
frame = 0
while True:
    line.send(struct.pack("<HHI16H", 18458, {JSON_HZ}, frame, *{FLYING}))
    line.recv(4096)
    frame += 1
"""


def plant(name: str) -> Plant:
    around = Surroundings(environment=Environment((3.0, 0.0, 0.0), gusts="light"), noise="typical")
    height = 0.0 if name == "rover" else -500.0
    return Plant(craft(name), (0.0, 0.0, height), 0.0, 1.0 / JSON_HZ, around)


def over_udp(name: str, seconds: float) -> tuple[float, float]:
    """Steps a second of wall time, and CPU seconds of the simulator per step."""
    vehicle = JsonVehicle(name, 1, plant(name), print, 0)
    with selectors.DefaultSelector() as selector:
        vehicle.open(Wiring(selector, set()))
        client = subprocess.Popen([sys.executable, "-c", CLIENT, str(vehicle.port)])
        try:
            while vehicle.protocol.frames < 100:
                serve(selector)
                vehicle.grant(1e9)  # all the time that it may want
            begun, spent, first = time.monotonic(), time.process_time(), vehicle.protocol.frames
            while time.monotonic() - begun < seconds:
                serve(selector)
            steps = vehicle.protocol.frames - first
            return steps / (time.monotonic() - begun), (time.process_time() - spent) / steps
        finally:
            client.kill()
            client.wait()
            vehicle.close()


def serve(selector: selectors.BaseSelector) -> None:
    for key, _ in selector.select(5.0):
        key.data()


def bare(name: str, seconds: float) -> float:
    """CPU seconds of a step without a socket."""
    fdm = JsonFdm(plant(name))
    begun, steps = time.process_time(), 0
    while time.process_time() - begun < seconds:
        fdm.take(struct.pack("<HHI16H", 18458, JSON_HZ, steps, *FLYING))
        fdm.answer()
        steps += 1
    return (time.process_time() - begun) / steps


def px4(seconds: float) -> float:
    """CPU seconds of one reading, with the physics that leads to it."""
    stream = HilStream(plant("sih"), load_dialect("ardupilotmega"), 1, 0)
    stream.plant.drive([0.5] * 4)
    begun, steps = time.process_time(), 0
    while time.process_time() - begun < seconds:
        stream.step()
        steps += 1
    return (time.process_time() - begun) / steps


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 3.0
    print(f"{'':>12} {'steps/s':>9} {'× real time':>12} {'us CPU a step':>14} {'without socket':>15} {'of a core':>10}")
    for name in AIRFRAMES:
        rate, cpu = over_udp(name, seconds)
        alone = bare(name, seconds / 2)
        print(
            f"{'JSON ' + name:>12} {rate:9.0f} {rate / JSON_HZ:12.1f} {cpu * 1e6:14.0f} {alone * 1e6:15.0f} "
            f"{cpu * JSON_HZ:10.0%}"
        )
    each = px4(seconds)
    print(
        f"{'PX4 sih':>12} {1 / each:9.0f} {1 / each / SENSOR_HZ:12.1f} {'':>14} {each * 1e6:15.0f} "
        f"{each * SENSOR_HZ:10.0%}"
    )


if __name__ == "__main__":
    main()
