"""What attacks on a router's ports and through its door cost those who may be there.

    python tests/bench/hostile.py [--rounds 3] [--seconds 2]
    python tests/bench/hostile.py --floods [--seconds 8] [--only param]

A router with credentials; a vehicle's program beside it that publishes telemetry and answers queries; an operator that
is linked over QUIC and measures both. Each attack is a process of its own (at a low priority: it would have a computer
of its own), switched on and off in one run, so that the ratio holds on a busy machine, too. ``--floods`` is the other
table: a vehicle's agent with an autopilot, and a viewer's floods of every channel that answers (``_floods.py``).
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import socket
import ssl
import statistics
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import zenoh

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from mesh.credentials.ca import Authority
from tests.bench import _floods
from tests.ports import free_udp_ports
from zmav.errors import SessionError
from zmav.process import free_port
from zmav.session import SessionSettings, open_session
from zmav.trust.certificate import Role

TELEMETRY_HZ, QUERIES_HZ = 100.0, 50.0
STATE, QUERY = "zmav/alpha/quad1/state", "zmav/alpha/quad1/msg/X"
QUIC = "quic/127.0.0.1:{}?mixed_rel=1"
STAMP = struct.Struct("<d")
Attack = Callable[[Path, int, int, int], None]
"""``attack(folder of the fleet, TCP, TLS, QUIC port)``: for ever"""


def paced(rate: float) -> Iterator[int]:
    """Counts, so many a second, in bursts of a hundredth of a second."""
    start, done = time.monotonic(), 0
    while True:
        for _ in range(int((time.monotonic() - start) * rate) - done):
            done += 1
            yield done
        time.sleep(0.01)


def member(folder: Path, name: str, endpoint: str) -> zenoh.Session:
    return open_session(SessionSettings(connect=[endpoint], credentials=str(folder / "ca" / "members" / name)))


def tls_garbage(folder: Path, tcp: int, tls: int, quic: int) -> None:
    for _ in paced(200):
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", tls), 1.0) as connection:
            connection.sendall(random.randbytes(500))


def tcp_connections(folder: Path, tcp: int, tls: int, quic: int) -> None:
    """Open, say nothing, be forgotten: 200 at a time."""
    held: list[socket.socket] = []
    for _ in paced(500):
        with contextlib.suppress(OSError):
            held.append(socket.create_connection(("127.0.0.1", tls), 1.0))
        if len(held) > 200:
            held.pop(0).close()


def quic_garbage(folder: Path, tcp: int, tls: int, quic: int) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as shooter:
        for number in paced(5000):
            with contextlib.suppress(OSError):
                shooter.sendto(
                    bytes([(0x00, 0x40, 0xC0, 0xFF)[number % 4]]) + random.randbytes(1200), ("127.0.0.1", quic)
                )


def strangers(folder: Path, tcp: int, tls: int, quic: int) -> None:
    """Whole handshakes with the certificate of another authority."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    context.load_cert_chain(folder / "others" / "cert.pem", folder / "others" / "key.pem")
    for _ in paced(100):
        with (
            contextlib.suppress(OSError),
            socket.create_connection(("127.0.0.1", tls), 1.0) as connection,
            context.wrap_socket(connection) as wrapped,
        ):
            wrapped.recv(1)


def quic_strangers(folder: Path, tcp: int, tls: int, quic: int) -> None:
    """The same over QUIC, eight at a time."""
    settings = SessionSettings(connect=[QUIC.format(quic)], credentials=str(folder / "others"))

    def knock() -> None:
        while True:
            with contextlib.suppress(SessionError):
                open_session(settings).close()

    for _ in range(8):
        threading.Thread(target=knock).start()
    threading.Event().wait()


def forbidden_puts(folder: Path, tcp: int, tls: int, quic: int) -> None:
    view = member(folder, "view", QUIC.format(quic))
    for _ in paced(5000):
        view.put("zmav/alpha/quad1/setpoint/x", bytes(100))


def forbidden_queries(folder: Path, tcp: int, tls: int, quic: int) -> None:
    view = member(folder, "view", QUIC.format(quic))
    for _ in paced(500):
        view.get("zmav/alpha/quad1/do/arm", lambda reply: None, timeout=0.5)


def forged_rosters(folder: Path, tcp: int, tls: int, quic: int) -> None:
    view = member(folder, "view", QUIC.format(quic))
    roster = json.dumps({"fleet": "alpha", "number": 10**6, "t": 0, "members": [], "revoked": []})
    payload = json.dumps({"roster": roster, "signature": "A" * 88}).encode()
    for _ in paced(1000):
        view.put("zmav/alpha/@fleet/roster", payload)


def allowed_puts(folder: Path, tcp: int, tls: int, quic: int) -> None:
    """What it may: reports of pictures under its own name, which nobody wants."""
    view = member(folder, "view", QUIC.format(quic))
    for _ in paced(5000):
        view.put("zmav/alpha/view/camera/x/report/x", bytes(100))


ATTACKS: dict[str, Attack] = {
    "random bytes on tls/, 200 connections/s": tls_garbage,
    "silent connections to tls/, 500/s": tcp_connections,
    "handshakes of another CA's, 100/s": strangers,
    "handshakes of another CA's over QUIC": quic_strangers,
    "random datagrams on quic/, 5,000/s": quic_garbage,
    "a viewer's setpoints, 5,000/s": forbidden_puts,
    "a viewer's orders, 500/s": forbidden_queries,
    "a viewer's forged rosters, 1,000/s": forged_rosters,
    "a viewer's own keys, 5,000/s": allowed_puts,
}


def home(tcp: int) -> None:
    """The vehicle's program: telemetry, and answers."""
    with open_session(SessionSettings(connect=[f"tcp/127.0.0.1:{tcp}"])) as session:
        session.declare_queryable(QUERY, lambda query: query.reply(query.key_expr, b"x" * 100))
        publisher = session.declare_publisher(STATE)
        for _ in paced(TELEMETRY_HZ):
            publisher.put(STAMP.pack(time.monotonic()) + bytes(300))


class Meter:
    """The operator: telemetry's delay, and queries' round trips."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session, self._lock = session, threading.Lock()
        self._delays: list[float] = []
        session.declare_subscriber(STATE, self._on_state)

    def _on_state(self, sample: zenoh.Sample) -> None:
        with self._lock:
            self._delays.append(time.monotonic() - STAMP.unpack_from(sample.payload.to_bytes())[0])

    def measure(self, seconds: float) -> dict[str, float]:
        """Over so long: telemetry per second and its median delay, queries' median round trip and those lost."""
        with self._lock:
            self._delays.clear()
        trips, lost, start = [], 0, time.monotonic()
        for _ in paced(QUERIES_HZ):
            sent = time.monotonic()
            if sent - start > seconds:
                break
            answered = any(reply.ok for reply in self._session.get(QUERY, timeout=1.0))
            trips.append(time.monotonic() - sent)
            lost += not answered
        with self._lock:
            delays, took = list(self._delays), time.monotonic() - start
        return {
            "rate": len(delays) / took,
            "delay": statistics.median(delays),
            "trip": statistics.median(trips),
            "p95": sorted(trips)[int(0.95 * len(trips))],
            "lost": lost,
        }


def spawn(*arguments: str, **options: Any) -> subprocess.Popen[str]:
    return subprocess.Popen([sys.executable, *arguments], text=True, **options)


def joins(folder: Path, endpoint: str) -> float | None:
    """Seconds until a member that comes during the attack is in; None: not within 10 s."""
    start = time.monotonic()
    while time.monotonic() - start < 10.0:
        with contextlib.suppress(SessionError):
            member(folder, "late", endpoint).close()
            return time.monotonic() - start
    return None


class Scene:
    """A router, the vehicle's program beside it, and the operator who measures."""

    def __init__(self, folder: Path, stack: contextlib.ExitStack) -> None:
        self.folder, self._log = folder, folder / "log"
        self.where = free_port(), free_port(), free_udp_ports(1)
        tcp, tls, quic = self.where
        listen = ("-l", f"tcp/127.0.0.1:{tcp}", "-l", f"tls/127.0.0.1:{tls}", "-l", QUIC.format(quic))
        own = ("--name", "quad1", "--credentials", str(folder / "ca" / "members" / "quad1"))
        with self._log.open("w") as log:
            router = spawn("-m", "zmav", "router", *listen, *own, stderr=log, stdin=subprocess.DEVNULL)
        stack.callback(router.wait)
        stack.callback(router.terminate)
        while "router" not in self._log.read_text():
            time.sleep(0.1)
        program = spawn(__file__, "--home", str(tcp), stdin=subprocess.DEVNULL)
        stack.callback(program.wait)
        stack.callback(program.kill)
        self.meter = Meter(stack.enter_context(member(folder, "ops", QUIC.format(quic))))
        time.sleep(1.0)

    @property
    def said(self) -> list[str]:
        """The lines of the router's log but its first."""
        return self._log.read_text().splitlines()[1:]


def compare(scene: Scene, name: str, rounds: int, seconds: float) -> str:
    """One row of the table."""
    quiet, attacked = [], []
    waits: dict[str, float | None] = {}
    for number in range(rounds):
        quiet.append(scene.meter.measure(seconds))
        attacker = spawn(
            __file__,
            "--attack",
            name,
            str(scene.folder),
            *map(str, scene.where),
            preexec_fn=lambda: os.nice(19),
            stdin=subprocess.DEVNULL,
        )
        time.sleep(1.5)  # its start costs processor time, and is no part of the attack
        attacked.append(scene.meter.measure(seconds))
        if number == rounds - 1:
            for endpoint in (f"tls/127.0.0.1:{scene.where[1]}", QUIC.format(scene.where[2])):
                waits[endpoint.partition("/")[0]] = joins(scene.folder, endpoint)
        attacker.kill()
        attacker.wait()
        time.sleep(0.3)
    ratio = [
        statistics.median(a[key] for a in attacked) / statistics.median(q[key] for q in quiet)
        for key in ("rate", "delay", "trip", "p95")
    ]
    lost = sum(int(a["lost"]) for a in attacked)
    late = "".join(f"{'>10' if wait is None else f'{wait:.2f}':>7}" for wait in waits.values())
    return f"{name:42}{''.join(f'{r:7.2f}' for r in ratio)}{lost:6}{late}{len(scene.said):6}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=2.0)
    given = parser.parse_args()
    print("with the attack / without it: telemetry per second, its delay, a query's time and its 95th percentile; then")
    print("queries lost, seconds until a member that comes during the attack is in, and lines in the router's log")
    print(f"{'':42}   rate  delay  query    p95  lost    tls   quic   log")
    for name in ATTACKS:
        with tempfile.TemporaryDirectory() as place, contextlib.ExitStack() as stack:
            folder = Path(place)
            authority = Authority.create(folder / "ca", "alpha")
            for who, role in (("late", "viewer"), ("view", "viewer"), ("ops", "operator"), ("quad1", "vehicle")):
                authority.issue(who, Role(role))
            Authority.create(folder / "ca2", "alpha").issue("ops", Role.OPERATOR, out=folder / "others")
            scene = Scene(folder, stack)
            print(compare(scene, name, given.rounds, given.seconds), flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--home"]:
        home(int(sys.argv[2]))
    elif sys.argv[1:2] == ["--attack"]:
        ATTACKS[sys.argv[2]](Path(sys.argv[3]), *map(int, sys.argv[4:7]))
    elif sys.argv[1:2] == ["--floods"]:
        _floods.main(sys.argv[2:])
    else:
        main()
