"""'zmav ros2' for seven vehicles: the processors' share, and what the conversion adds to a message's way.

    python tests/bench/ros2.py [--vehicles 7] [--rate 100] [--seconds 10] [--json]

Each vehicle sends ``rate`` messages a second by UDP to an adapter of its own (all of them in one process, with the
router); 'zmav ros2' is one process, and one subscriber of each topic of each vehicle is a peer of the router, as ROS's
nodes are. Shares are of one core, of every thread of a process, by the scheduler. Latency is from the frame's making to
a callback of the subscriber's process: of imu/data, and of the very ATTITUDE in the key space.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.bench._load import _cpu_ns, end
from tests.ports import free_udp_ports
from zmav.process import free_port

HERE = str(Path(__file__).resolve())
FLEET = "bench"
MIX = (
    "ATTITUDE",
    "GLOBAL_POSITION_INT",
    "ATTITUDE",
    "RAW_IMU",
    "ATTITUDE",
    "GLOBAL_POSITION_INT",
    "ATTITUDE",
    "RAW_IMU",
)
SELDOM = ("GPS_RAW_INT", "SYS_STATUS")
"""sent every tenth time instead"""
HALF = 1 << 20
"""the time travels as two floats, each of them exact: µs over and modulo this"""


def fleet(first: int, count: int, endpoint: str) -> None:
    """The adapters, each on a UDP port of its own from ``first`` on, beside one router; and their states."""
    from zmav import keys, wire
    from zmav.adapter import Adapter
    from zmav.bus import Bus
    from zmav.links import open_link
    from zmav.mavlink import load_dialect
    from zmav.session import SessionSettings, open_session

    position = wire.GlobalPosition(lat_deg=0.0, lon_deg=0.0, alt_amsl=0.0, alt_rel=0.0)
    with open_session(SessionSettings(mode="router", listen=[endpoint])) as session:
        for number in range(count):
            link = open_link(f"udpin:127.0.0.1:{first + number}")
            Adapter(session, FLEET, f"v{number}", link, load_dialect(), Bus()).start()
        while True:
            for number in range(count):
                state = wire.VehicleState(
                    t=time.time(),
                    fleet=FLEET,
                    name=f"v{number}",
                    instance=f"v{number}",
                    sysid=number + 1,
                    compid=1,
                    autopilot="ardupilot",
                    connected=True,
                    position=position,
                    local=(0.0, 0.0, 0.0),
                )
                session.put(keys.STATE.key(FLEET, f"v{number}"), wire.encode(state), encoding=keys.JSON)
            time.sleep(0.2)


def send(first: int, count: int, rate: float, seconds: float) -> None:
    import socket

    from zmav.mavlink import Packer, load_dialect

    packers = [Packer(load_dialect(), number + 1, 1) for number in range(count)]
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    start = time.monotonic()
    for turn in range(int(rate * seconds)):
        name = SELDOM[turn // 10 % 2] if turn % 10 == 9 else MIX[turn % len(MIX)]
        for number, packer in enumerate(packers):
            left = start + (turn + number / count) / rate - time.monotonic()
            if left > 5e-5:
                time.sleep(left)
            fields: dict[str, Any] = {}
            if name == "ATTITUDE":
                high, low = divmod(time.monotonic_ns() // 1000, HALF)
                fields = {"rollspeed": float(high), "pitchspeed": float(low)}
            out.sendto(packer.pack(name, **fields), ("127.0.0.1", first + number))


def read(endpoint: str, count: int) -> None:
    """A subscriber of each topic of each vehicle; at the end of its input what it heard, as JSON."""
    from ground.ros2 import graph
    from ground.ros2.telemetry import STATE_TOPICS, TOPICS
    from ground.ros2.types import known
    from zmav.mavlink import decode, load_dialect, parse_frame
    from zmav.session import SessionSettings, open_session

    took: dict[str, list[float]] = {"imu/data": [], "ATTITUDE": []}
    plain = [(topic.name, topic.type) for topic in TOPICS.values()] + [each[:2] for each in STATE_TOPICS]
    counts, types, dialect = {name: 0 for name, _ in plain}, known(), load_dialect()

    def late(high: float, low: float) -> float:
        return time.monotonic_ns() / 1000 - (high * HALF + low)

    def on_imu(sample: Any) -> None:
        counts["imu/data"] += 1
        rates = types.decode(sample.payload.to_bytes(), "sensor_msgs/msg/Imu").angular_velocity
        took["imu/data"].append(late(rates.x, -rates.y))

    def on_frame(sample: Any) -> None:
        fields = decode(parse_frame(sample.payload.to_bytes(), dialect), dialect)
        took["ATTITUDE"].append(late(fields["rollspeed"], fields["pitchspeed"]))

    def counting(name: str) -> Any:
        def count_one(sample: Any) -> None:
            counts[name] += 1

        return count_one

    with open_session(SessionSettings(mode="peer", connect=[endpoint])) as session:
        tokens = []
        for number in range(count):
            node = graph.Node(0, str(session.info.zid()), number, "/", f"bench{number}")
            tokens.append(session.liveliness().declare_token(node.token))
            for place, (name, kind) in enumerate(plain):
                full = name if name.startswith("/") else f"/v{number}/{name}"
                if name.startswith("/") and number:
                    continue
                eid = 1000 * (number + 1) + place
                reader = graph.Endpoint(node, eid, graph.SUBSCRIBER, full, kind, types.hash(kind))
                session.declare_subscriber(reader.key, on_imu if name == "imu/data" else counting(name))
                tokens.append(session.liveliness().declare_token(reader.token))
        session.declare_subscriber(f"zmav/{FLEET}/*/mav/rx/*/*/ATTITUDE", on_frame)
        print("ready", flush=True)
        sys.stdin.readline()
        for each in took.values():
            each.clear()
        for name in counts:
            counts[name] = 0
        sys.stdin.readline()
        print(json.dumps({"took": took, "counts": counts}), flush=True)


@contextlib.contextmanager
def running(count: int) -> Iterator[tuple[int, dict[str, subprocess.Popen[str]]]]:
    """The three processes, and the first port."""
    endpoint, first = f"tcp/127.0.0.1:{free_port()}", free_udp_ports(count)
    plan = {
        "adapters and router": [sys.executable, HERE, "fleet", str(first), str(count), endpoint],
        "zmav ros2": [sys.executable, "-m", "zmav", "ros2", "--fleet", FLEET, "-e", endpoint],
        "subscriber": [sys.executable, HERE, "read", endpoint, str(count)],
    }
    with contextlib.ExitStack() as stack:
        found = {}
        for name, command in plan.items():
            found[name] = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            stack.callback(end, found[name])
            time.sleep(2.0)
        said = found["subscriber"].stdout
        assert said is not None
        said.readline()
        yield first, found


def measure(count: int, rate: float, seconds: float) -> dict[str, Any]:
    with running(count) as (first, processes):
        command = [sys.executable, HERE, "send", str(first), str(count), str(rate)]
        subprocess.run([*command, "3"], check=True)  # until everybody knows everybody
        reader = processes["subscriber"]
        assert reader.stdin is not None and reader.stdout is not None
        reader.stdin.write("\n")
        reader.stdin.flush()
        before, began = {name: _cpu_ns(each.pid) for name, each in processes.items()}, time.monotonic()
        subprocess.run([*command, str(seconds)], check=True)
        took = time.monotonic() - began
        shares = {name: (_cpu_ns(each.pid) - before[name]) / 1e9 / took for name, each in processes.items()}
        reader.stdin.write("\n")
        reader.stdin.flush()
        heard = json.loads(reader.stdout.readline())
    latency = {name: sorted(values) for name, values in heard["took"].items()}
    return {
        "shares": shares,
        "messages": sum(heard["counts"].values()) / took,
        "latency_ms": {
            name: [values[len(values) // 2] / 1e3, values[int(0.99 * len(values))] / 1e3] if values else None
            for name, values in latency.items()
        },
    }


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--vehicles", type=int, default=7)
    options.add_argument("--rate", type=float, default=100.0)
    options.add_argument("--seconds", type=float, default=10.0)
    options.add_argument("--json", action="store_true")
    asked = options.parse_args()
    found = measure(asked.vehicles, asked.rate, asked.seconds)
    if asked.json:
        print(json.dumps(found))
        return
    print(f"{asked.vehicles} vehicles, {asked.rate:g} messages a second each; {found['messages']:.0f} a second in ROS")
    for name, share in found["shares"].items():
        print(f"  {name}: {100 * share:.1f} % of a core, {100 * share / asked.vehicles:.1f} % a vehicle")
    for name, both in found["latency_ms"].items():
        print(f"  {name}: p50 {both[0]:.2f} ms, p99 {both[1]:.2f} ms" if both else f"  {name}: nothing came")


if __name__ == "__main__":
    kind, *rest = sys.argv[1:] or [""]
    if kind == "fleet":
        fleet(int(rest[0]), int(rest[1]), rest[2])
    elif kind == "send":
        send(int(rest[0]), int(rest[1]), float(rest[2]), float(rest[3]))
    elif kind == "read":
        read(rest[0], int(rest[1]))
    else:
        main()
