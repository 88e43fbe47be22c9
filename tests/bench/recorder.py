"""Recording 50 vehicles at 100 messages a second each, beside pymavlink's own recording of the same frames.

    python tests/bench/recorder.py [--vehicles 50] [--rate 100] [--seconds 4]

Ours: frames put on their keys in a router, recorded by 'zmav record' (a .tlog of each vehicle and an .mcap of
everything, decoded). Theirs: the same frames as UDP datagrams, received by pymavlink and written as MAVProxy
writes them (one .tlog, nothing decoded). Rates are offered by this process; CPU is that of the recording process alone.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import zenoh

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))
from tests.bench._load import RECEIVE_BUFFER, _cpu_ns, end
from zmav.mavlink import Packer, load_dialect
from zmav.process import free_port
from zmav.session import SessionSettings, open_session

MIX = (
    "ATTITUDE",
    "LOCAL_POSITION_NED",
    "GLOBAL_POSITION_INT",
    "ATTITUDE",
    "SERVO_OUTPUT_RAW",
    "RC_CHANNELS",
    "VFR_HUD",
    "SYS_STATUS",
    "GPS_RAW_INT",
    "BATTERY_STATUS",
)
THEIRS = """
import socket, struct, sys, time
from pymavlink import mavutil
source = mavutil.mavlink_connection(f"udpin:127.0.0.1:{sys.argv[1]}", dialect="ardupilotmega")
source.port.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8 << 20)
log = open(sys.argv[2], "wb", buffering=0)
print("ready", flush=True)
while True:  # as MAVProxy does it; a UDP connection of pymavlink's does not keep the log that setup_logfile asks for
    message = source.recv_match(blocking=True)
    if message is not None and message.get_type() != "BAD_DATA":
        log.write(struct.pack(">Q", int(time.time() * 1e6)) + message.get_msgbuf())
"""


class Result(NamedTuple):
    offered: float
    kept: int
    sent: int
    cpu_us: float
    share: float
    size: int


def frames(vehicles: int) -> list[tuple[str, bytes]]:
    """A second's worth of keys and frames; numbers that differ, as in flight."""
    dialect = load_dialect()
    made = []
    for vehicle in range(1, vehicles + 1):
        packer = Packer(dialect, sysid=vehicle, compid=1)
        for number in range(100):
            name = MIX[number % len(MIX)]
            fields: dict[str, Any] = {}
            for field in dialect.message(name).fields:
                value = (0.001 * number + 0.1 * vehicle) if field.type == "float" else (7 * number + vehicle) % 100
                if not field.length and field.type != "char":
                    fields[field.name] = value
            made.append((f"zmav/bench/v{vehicle}/mav/rx/{vehicle}/1/{name}", packer.pack(name, **fields)))
    # One vehicle after the other, as they come.
    return [made[100 * v + n] for n in range(100) for v in range(vehicles)]


def offer(
    put: Callable[[str, bytes], object], made: list[tuple[str, bytes]], rate: float, seconds: float
) -> tuple[int, float]:
    """Put frames at ``rate`` a second in bursts of a few milliseconds; how many, in what time."""
    total, sent, start = int(rate * seconds), 0, time.monotonic()
    source = itertools.cycle(made)
    while sent < total:
        due = min(total, int((time.monotonic() - start) * rate) + 1)
        for key, frame in itertools.islice(source, due - sent):
            put(key, frame)
        sent = due
        time.sleep(0.004)
    return sent, time.monotonic() - start


@contextlib.contextmanager
def process(*command: str) -> Iterator[subprocess.Popen[str]]:
    started = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        assert started.stdout is not None
        line = started.stdout.readline()
        assert "ready" in line or "recording" in line, line
        yield started
    finally:
        end(started)


def ours(made: list[tuple[str, bytes]], rate: float, seconds: float, *more: str) -> Result:
    out = Path(tempfile.mkdtemp(prefix="zmav-bench-"))
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    patient = ("transport/link/tx/queue/congestion_control/drop/wait_before_drop:1000000",)
    detail: dict[str, Any] = {}

    def on_status(sample: zenoh.Sample) -> None:
        detail.update(json.loads(sample.payload.to_bytes())["detail"], told=detail.get("told", 0) + 1)

    command = (
        "record",
        "--out",
        str(out),
        "-e",
        endpoint,
        "--fleet",
        "bench",
        "--keep-free",
        "0",
        "--name",
        "gs",
        *more,
    )
    try:
        with open_session(SessionSettings(mode="router", listen=[endpoint], cfg=patient)) as session:
            session.declare_subscriber("zmav/bench/gs/agent/recorder/status", on_status)
            with process(sys.executable, "-m", "zmav", *command) as recorder:
                while not detail.get("written"):  # its own status: it hears
                    time.sleep(0.1)
                publishers = {key: session.declare_publisher(key) for key in {key for key, _ in made}}

                def put(key: str, frame: bytes) -> None:
                    publishers[key].put(frame)

                offer(put, made, rate, 1.0)  # every file and topic is there
                first = _settled(detail)
                before = _cpu_ns(recorder.pid)
                sent, took = offer(put, made, rate, seconds)
                kept = _settled(detail)
                cpu = (_cpu_ns(recorder.pid) - before) / 1e3
        size = sum(path.stat().st_size for path in out.rglob("*") if path.is_file())
        return Result(sent / took, min(sent, kept - first), sent, cpu / sent, cpu / 1e6 / took, size)
    finally:
        shutil.rmtree(out)


def _settled(detail: dict[str, Any]) -> int:
    """What is written, once it grows no more but by the recorder's own statuses."""
    calm, known, seen = 0, -100, 0
    while calm < 2:
        if detail["told"] == seen:
            time.sleep(0.05)
            continue
        seen = detail["told"]
        calm = calm + 1 if detail["written"] <= known + 2 else 0
        known = detail["written"]
    return int(known)


def _grown(path: Path) -> int:
    """A file's size once it grows no more."""
    size = -1
    while path.stat().st_size > size:
        size = path.stat().st_size
        time.sleep(1.0)
    return size


def theirs(made: list[tuple[str, bytes]], rate: float, seconds: float) -> Result:
    out, port = Path(tempfile.mkdtemp(prefix="zmav-bench-")), free_port()
    log = out / "all.tlog"
    try:
        with process(sys.executable, "-c", THEIRS, str(port), str(log)) as recorder:
            sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            sender.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, RECEIVE_BUFFER)
            sender.connect(("127.0.0.1", port))
            offer(lambda key, frame: sender.send(frame), made, rate, 1.0)
            first, before = _grown(log), _cpu_ns(recorder.pid)
            sent, took = offer(lambda key, frame: sender.send(frame), made, rate, seconds)
            size = _grown(log)
            cpu = (_cpu_ns(recorder.pid) - before) / 1e3
        mean = sum(len(frame) + 8 for _, frame in made) / len(made)
        return Result(sent / took, min(sent, round((size - first) / mean)), sent, cpu / sent, cpu / 1e6 / took, size)
    finally:
        shutil.rmtree(out)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicles", type=int, default=50)
    parser.add_argument("--rate", type=float, default=100.0)
    parser.add_argument("--seconds", type=float, default=4.0)
    asked = parser.parse_args()
    made = frames(asked.vehicles)
    rate, flood = asked.vehicles * asked.rate, 30_000.0
    mean = sum(len(frame) for _, frame in made) / len(made)
    print(f"{asked.vehicles} vehicles, {mean:.0f} bytes a frame, {os.cpu_count()} cores")
    print(f"{'':34}{'offered/s':>10}{'kept':>8}{'CPU µs/msg':>12}{'of a core':>11}{'bytes/msg':>11}")
    rows: list[tuple[str, Callable[[], Result]]] = [
        ("zmav record, .tlog and .mcap", lambda: ours(made, rate, asked.seconds)),
        ("zmav record --no-mcap", lambda: ours(made, rate, asked.seconds, "--no-mcap")),
        ("pymavlink, one .tlog", lambda: theirs(made, rate, asked.seconds)),
        ("zmav record, flooded", lambda: ours(made, flood, asked.seconds / 2)),
        ("pymavlink, flooded", lambda: theirs(made, flood, asked.seconds / 2)),
    ]
    for name, run in rows:
        found = run()
        whole = found.sent * (1.0 + 1.0 / (asked.seconds if "flooded" not in name else asked.seconds / 2))
        print(
            f"{name:34}{found.offered:10.0f}{found.kept / found.sent:8.1%}{found.cpu_us:12.1f}{found.share:11.1%}"
            f"{found.size / whole:11.0f}"
        )


if __name__ == "__main__":
    main()
