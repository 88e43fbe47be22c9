"""A load generator and a sink for anything with MAVLink over UDP in and out; one clock (CLOCK_MONOTONIC) for both.

    python tests/bench/_load.py send PORT RATE SECONDS      the generator, a process of its own

Every frame is valid MAVLink 2 and carries a counter and its own sending time in the first twelve bytes of payload.
"""

from __future__ import annotations

import dataclasses
import socket
import statistics
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

from fastcrc import crc16

from zmav.mavlink import load_dialect

MIX = ("ATTITUDE", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "ATTITUDE", "SERVO_OUTPUT_RAW", "RC_CHANNELS")
_STAMP = struct.Struct("<IQ")
_PAYLOAD = 10
RECEIVE_BUFFER = 8 << 20


def send(port: int, rate: float, seconds: float) -> None:
    """Send at ``rate`` frames a second, evenly up to 2,000 and in bursts of a millisecond above."""
    dialect = load_dialect()
    types = [dialect.by_name[name] for name in MIX]
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    out.connect(("127.0.0.1", port))
    burst = max(1, round(rate / 1000.0)) if rate > 2000 else 1
    total = int(rate * seconds)
    filler = [bytes([7] * (kind.base_length - _STAMP.size)) for kind in types]
    heads = [bytes([0xFD, kind.base_length, 0, 0]) for kind in types]
    ids = [b"\x01\x01" + kind.id.to_bytes(3, "little") for kind in types]
    extras = [bytes([kind.crc_extra]) for kind in types]
    crc, start, period = crc16.mcrf4xx, time.monotonic_ns(), burst / rate * 1e9
    for number in range(total):
        if number % burst == 0:
            left = start + number // burst * period - time.monotonic_ns()
            if left > 0:
                time.sleep(left / 1e9)
        kind = number % len(types)
        body = b"".join(
            (heads[kind], bytes([number & 255]), ids[kind], _STAMP.pack(number, time.monotonic_ns()), filler[kind])
        )
        check = crc(body[1:] + extras[kind])
        try:
            out.send(body + check.to_bytes(2, "little"))
        except ConnectionRefusedError:
            continue  # nobody listens there yet, or any more: that counts as lost
    print(total, (time.monotonic_ns() - start) / 1e9)


@dataclasses.dataclass
class Run:
    """What came of one load: latencies in µs, CPU in µs a frame by process."""

    sent: int
    received: int
    rate: float
    """frames a second that were really offered"""
    latencies: list[float]
    cpu: list[float]

    @property
    def lost(self) -> int:
        return self.sent - self.received

    def quantile(self, share: float) -> float:
        ordered = sorted(self.latencies)
        return ordered[min(int(share * len(ordered)), len(ordered) - 1)] if ordered else float("nan")

    @property
    def p50(self) -> float:
        return statistics.median(self.latencies) if self.latencies else float("nan")


class Sink:
    """Receives on a port of its own until closed."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        self._socket.bind(("127.0.0.1", 0))
        self.port: int = self._socket.getsockname()[1]
        self._latencies: list[float] = []
        self.last = 0.0
        threading.Thread(target=self._receive, daemon=True).start()

    def _receive(self) -> None:
        receive, unpack, now = self._socket.recv, _STAMP.unpack_from, time.monotonic_ns
        while True:
            data = receive(2048)
            if data[:1] == b"\xfd" and len(data) > 24 and data[6] == 1:
                self._latencies.append((now() - unpack(data, _PAYLOAD)[1]) / 1e3)
                self.last = time.monotonic()

    def take(self) -> list[float]:
        taken, self._latencies = self._latencies, []
        return taken


def measure(port: int, sink: Sink, pids: list[int], rate: float, seconds: float) -> Run:
    """Load ``port``, watch ``sink`` and the CPU time of ``pids``."""
    sink.take()
    before = [_cpu_ns(pid) for pid in pids]
    command = [sys.executable, str(Path(__file__).resolve()), "send", str(port), str(rate), str(seconds)]
    sent, took = map(float, subprocess.run(command, check=True, capture_output=True, text=True).stdout.split())
    while time.monotonic() - sink.last < 0.3:
        time.sleep(0.05)
    after = [_cpu_ns(pid) for pid in pids]
    got = sink.take()
    cpu = [(b - a) / 1e3 / max(len(got), 1) for a, b in zip(before, after, strict=True)]
    return Run(int(sent), len(got), sent / took, got, cpu)


def end(process: subprocess.Popen[Any]) -> None:
    """End a process that one side of a comparison needed."""
    process.terminate()
    try:
        process.wait(5)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _cpu_ns(pid: int) -> int:
    """CPU time of all threads in nanoseconds, to the scheduler's own precision."""
    return sum(int(p.read_text().split()[0]) for p in Path(f"/proc/{pid}/task").glob("*/schedstat"))


if __name__ == "__main__" and sys.argv[1:2] == ["send"]:
    send(int(sys.argv[2]), float(sys.argv[3]), float(sys.argv[4]))
