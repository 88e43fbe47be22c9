"""From a setpoint's put on the ground to its frame on the autopilot's link, and from a cut network to the hold.

    python tests/bench/setpoint.py [--rounds 3] [--rate 50] [--seconds 6] [--cuts 8] [--json]

Sides, which take turns: MAVLink over UDP straight to the autopilot, the same frames over one bare Zenoh hop, zmav
through one router (the vehicle's own) and through three. Then the relay between ground and vehicle is frozen in the
middle of a stream (a cut network), and the ground's process killed, and the hold at the autopilot is waited for. The
autopilot is a UDP socket that says it is armed and in GUIDED.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import socket
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.bench._ground import STEP
from tests.bench._load import end
from zmav.mavlink import Packer, Splitter, decode, load_dialect
from zmav.process import free_port

GROUND = [sys.executable, str(Path(__file__).resolve().parent / "_ground.py")]
ZMAV = [sys.executable, "-m", "zmav"]
GUID_TIMEOUT = 3.0
"""s after which ArduCopter itself drops a velocity that is not repeated"""
TARGETS = ("SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT")


class Autopilot:
    """Armed in GUIDED at a place that does not move; notes when each velocity came."""

    armed = True

    def __init__(self) -> None:
        self._dialect = load_dialect()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self._socket.bind(("127.0.0.1", 0))
        self.port: int = self._socket.getsockname()[1]
        self.first: dict[int, float] = {}
        """monotonic seconds of the first frame of each number"""
        self.last = 0.0
        """of the first frame of the newest number: it is said again while it is fresh"""
        self.held = threading.Event()
        self.held_at = 0.0
        self._peer: Any = None
        self._packer = Packer(self._dialect, 1, 1)
        for run in (self._receive, self._beat):
            threading.Thread(target=run, daemon=True).start()

    def forget(self) -> None:
        self.first, self.held_at = {}, 0.0
        self.held.clear()

    def _receive(self) -> None:
        splitter, ids = Splitter(self._dialect), {self._dialect.message(name).id for name in TARGETS}
        while True:
            data, peer = self._socket.recvfrom(2048)
            now = time.monotonic()
            for frame in splitter.feed(data):
                if frame.compid == 191 and frame.msgid == 0:
                    self._peer = peer  # the companion beats; a bare sender does not
                if frame.msgid in ids:
                    self._note(round(decode(frame, self._dialect)["vx"] / STEP), now)
                elif frame.msgid == 111:
                    sent = decode(frame, self._dialect)["ts1"]
                    self._socket.sendto(self._packer.pack("TIMESYNC", tc1=time.monotonic_ns(), ts1=sent), peer)
                elif frame.msgid == 76:
                    self._acknowledge(decode(frame, self._dialect), peer)

    def _note(self, number: int, now: float) -> None:
        if number and number not in self.first:
            self.first[number] = self.last = now
        elif not number and self.first and not self.held.is_set():
            self.held_at = now
            self.held.set()

    def _acknowledge(self, command: dict[str, Any], peer: Any) -> None:
        self._socket.sendto(self._packer.pack("COMMAND_ACK", command=command["command"]), peer)
        if command["command"] == 512 and command["param1"] == 148:
            self._socket.sendto(self._packer.pack("AUTOPILOT_VERSION", uid=1), peer)

    def _beat(self) -> None:
        while True:
            if self._peer is not None:
                mode = 129 if self.armed else 1
                beat = {"type": 2, "autopilot": 3, "base_mode": mode, "custom_mode": 4, "system_status": 4}
                place = {"lat": 520000000, "lon": -10000000, "alt": 70000, "relative_alt": 10000}
                self._socket.sendto(self._packer.pack("HEARTBEAT", **beat), self._peer)
                self._socket.sendto(self._packer.pack("GLOBAL_POSITION_INT", **place), self._peer)
            time.sleep(0.1)


class Routers:
    """The vehicle's router, one on the way, and one on the ground, in a line; each a process."""

    def __init__(self, stack: contextlib.ExitStack, autopilot: Autopilot) -> None:
        self.vehicle, self.middle, self.ground = (f"tcp/127.0.0.1:{free_port()}" for _ in range(3))
        start(stack, [*ZMAV, "up", "--link", f"udpout:127.0.0.1:{autopilot.port}", "-l", self.vehicle])
        self.relay = start(stack, [*ZMAV, "router", "-l", self.middle, "-e", self.vehicle])
        start(stack, [*ZMAV, "router", "-l", self.ground, "-e", self.middle])


def start(stack: contextlib.ExitStack, command: list[str]) -> subprocess.Popen[str]:
    """A process that ends with the stack."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)

    stack.callback(end, process)
    stack.callback(process.send_signal, signal.SIGCONT)  # first: a frozen one hears nothing else
    return process


def latencies(autopilot: Autopilot, command: list[str]) -> tuple[list[float], int]:
    """One stream: ms from put to frame for each setpoint, and how many did not come."""
    autopilot.forget()
    out = subprocess.run([*GROUND, *command], check=True, capture_output=True, text=True, timeout=120).stdout
    times = json.loads(out.splitlines()[-1])
    came = [1e3 * (autopilot.first[n] - t) for n, t in enumerate(times, 1) if n in autopilot.first]
    return came, len(times) - len(came)


@contextlib.contextmanager
def streaming(endpoint: str, autopilot: Autopilot) -> Iterator[subprocess.Popen[str]]:
    """A stream of 20 Hz that would go on for a minute."""
    with contextlib.ExitStack() as stack:
        ground = start(stack, [*GROUND, "zmav", endpoint, "20", "60"])
        assert ground.stdout is not None and ground.stdout.readline().strip() == "ready"
        autopilot.forget()
        while len(autopilot.first) < 10:
            time.sleep(0.05)
        yield ground


def cut(autopilot: Autopilot, routers: Routers, kind: str) -> tuple[float, float]:
    """Seconds from the cut, and from the last setpoint's frame, to the hold."""
    with streaming(routers.ground, autopilot) as ground:
        victim = ground if kind == "killed" else routers.relay
        now = time.monotonic()
        os.kill(victim.pid, signal.SIGKILL if kind == "killed" else signal.SIGSTOP)
        try:
            if not autopilot.held.wait(10.0):
                raise SystemExit(f"{kind}: no hold within 10 s")
            return autopilot.held_at - now, autopilot.held_at - autopilot.last
        finally:
            routers.relay.send_signal(signal.SIGCONT)
            ground.kill()
            time.sleep(2.0)  # until the links are there again, and the lease has ended


def spread(values: list[float], unit: str) -> str:
    return f"{min(values):.3f} / {statistics.median(values):.3f} / {max(values):.3f} {unit}"


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--rounds", type=int, default=3)
    options.add_argument("--rate", type=float, default=50.0)
    options.add_argument("--seconds", type=float, default=6.0)
    options.add_argument("--cuts", type=int, default=8)
    options.add_argument("--json", action="store_true")
    args = options.parse_args()
    autopilot = Autopilot()
    pace = [str(args.rate), str(args.seconds)]
    with contextlib.ExitStack() as stack:
        routers = Routers(stack, autopilot)
        bare = f"tcp/127.0.0.1:{free_port()}"
        start(stack, [*GROUND, "hop", bare, str(autopilot.port)])
        time.sleep(4.0)
        commands = {
            "UDP to the autopilot": ["udp", str(autopilot.port), *pace],
            "bare Zenoh hop": ["zenoh", bare, *pace],
            "zmav, 1 router": ["zmav", routers.vehicle, *pace],
            "zmav, 3 routers": ["zmav", routers.ground, *pace],
        }
        medians: dict[str, list[float]] = {name: [] for name in commands}
        tails: dict[str, list[float]] = {name: [] for name in commands}
        lost = dict.fromkeys(commands, 0)
        for _ in range(args.rounds):
            for name, command in commands.items():
                came, missing = latencies(autopilot, command)
                medians[name].append(statistics.median(came))
                tails[name].append(statistics.quantiles(came, n=100)[98])
                lost[name] += missing
        cuts = {kind: [cut(autopilot, routers, kind) for _ in range(args.cuts)] for kind in ("cut", "killed")}
    if args.json:
        print(json.dumps({"p50_ms": medians, "p99_ms": tails, "lost": lost, "cuts_s": cuts}))
        return
    for name in commands:
        p50, p99 = statistics.median(medians[name]), statistics.median(tails[name])
        print(f"{name:22} p50 {p50:6.3f} ms  p99 {p99:7.3f} ms  lost {lost[name]}")
    one, bare_p50 = (statistics.median(medians[name]) for name in ("zmav, 1 router", "bare Zenoh hop"))
    three = statistics.median(medians["zmav, 3 routers"])
    print(f"p50: zmav / bare Zenoh hop ×{one / bare_p50:.2f}, 3 routers / 1 router ×{three / one:.2f}")
    if not args.cuts:
        return
    for kind, what in (("cut", "network cut"), ("killed", "holder killed")):
        print(f"{what:14} to hold {spread([c for c, _ in cuts[kind]], 's')} (min / median / max of {args.cuts})")
        print(f"{'':14} last setpoint to hold {spread([s for _, s in cuts[kind]], 's')}")
    worst = max(c for c, _ in cuts["cut"])
    print(f"worst cut to hold / ArduCopter's own GUID_TIMEOUT ×{worst / GUID_TIMEOUT:.2f}")


if __name__ == "__main__":
    main()
