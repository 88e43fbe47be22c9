"""What floods of every channel that can be asked or put cost an operator's `land`: the second table of ``hostile.py``.

``zmav up`` with credentials, before an autopilot of one UDP socket with 1,354 parameters; an operator over QUIC says
``land`` again and again, and the time is taken until the word is on the autopilot's link. The viewer is a process of
its own at a low priority, linked over QUIC (who does not read: over TLS through a proxy that lets nothing back). What a
viewer's door lets nobody bring comes from a program without credentials on the vehicle's own loopback.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import itertools
import json
import os
import re
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import zenoh
from zenoh import handlers

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import zmav
from mesh.credentials.ca import Authority
from tests.services.conftest import GUIDED, LAND, SET_MODE, Told
from tests.services.params.param_peer import ParamPeer, many
from zmav import wire
from zmav.errors import SessionError, ZmavError
from zmav.process import free_port
from zmav.session import SessionSettings, open_session
from zmav.trust.certificate import Role
from zmav.trust.credentials import Credentials
from zmav.trust.proof import Signer

QUIC, TLS, TCP = "quic/127.0.0.1:{}?mixed_rel=1", "tls/127.0.0.1:{}", "tcp/127.0.0.1:{}"
SPACE = "zmav/alpha/quad1/"
PARAMETERS = 1354
RATE = 1000.0
"""questions a second"""
BETWEEN = 0.15
"""s that the vehicle is in GUIDED again before the next order"""
PATIENCE = 90.0


class Ports(NamedTuple):
    """Where the vehicle's router listens, by protocol."""

    quic: int
    tls: int
    tcp: int


Flood = Callable[[Path, Ports], None]
"""``flood(members' folder, ports)``: for ever"""


def paced(rate: float) -> Iterator[int]:
    start, done = time.monotonic(), 0
    while True:
        for _ in range(int((time.monotonic() - start) * rate) - done):
            done += 1
            yield done
        time.sleep(0.01)


def viewer(folder: Path, endpoint: str) -> zenoh.Session:
    return open_session(SessionSettings(connect=[endpoint], credentials=str(folder / "view")))


def ask(session: zenoh.Session, key: str, payload: bytes = b"", **more: Any) -> None:
    quiet: Any = handlers.Callback(lambda reply: None, indirect=False)
    session.get(key, quiet, payload=payload, timeout=2.0, **more)


def asking(*asked: str, rate: float = RATE) -> Flood:
    """One after the other of these keys; ``{}`` is another number each time."""

    def flood(folder: Path, ports: Ports) -> None:
        session = viewer(folder, QUIC.format(ports.quic))
        for number in paced(rate):
            ask(session, SPACE + asked[number % len(asked)].format(number))

    return flood


def ordering(verb: str, **args: Any) -> Flood:
    """An order that a viewer may give, each proven and new."""

    def flood(folder: Path, ports: Ports) -> None:
        async def learn(z: zmav.Client) -> None:
            async with z:
                await z.vehicle("quad1").ping()
                for number in paced(RATE):
                    key, payload = f"{SPACE}do/{verb}", json.dumps({"id": f"{os.getpid()}-{number}", **args}).encode()
                    assert z.member is not None
                    ask(z.session, key, payload, attachment=z.member.proof(key, payload))

        settings = SessionSettings(connect=[QUIC.format(ports.quic)], credentials=str(folder / "view"))
        asyncio.run(learn(zmav.open(fleet="alpha", settings=settings)))

    return flood


def local(ports: Ports) -> zenoh.Session:
    return open_session(SessionSettings(connect=[TCP.format(ports.tcp)]))


def putting(key: str, payload: bytes = bytes(100), attachment: bytes | None = b"\x02" + bytes(16)) -> Flood:
    """By a local program, with a seal or a proof that is none."""

    def flood(folder: Path, ports: Ports) -> None:
        session = local(ports)
        for _ in paced(5 * RATE):
            session.put(SPACE + key, payload, attachment=attachment)

    return flood


def asking_locally(key: str, payload: bytes = b"{}") -> Flood:
    """By a local program, without a proof."""

    def flood(folder: Path, ports: Ports) -> None:
        session = local(ports)
        for number in paced(RATE):
            ask(session, SPACE + key.format(number), payload)

    return flood


def forging(key: str, rate: float, *, put: bool = False) -> Flood:
    """In the operator's name, by a local program: all is right but the signature."""

    def flood(folder: Path, ports: Ports) -> None:
        session, signer = local(ports), Signer(Credentials.load(folder / "ops"))
        (state,) = (reply.ok for reply in session.get(f"{SPACE}state", timeout=5.0))
        assert state is not None
        gate = bytes.fromhex(json.loads(state.payload.to_bytes())["gate"])
        forged, until = b"", 0.0
        for _ in paced(rate):
            if time.monotonic() > until:
                forged, until = signer.sign("another key", b"", introduce=True, answers=gate), time.monotonic() + 10.0
            if put:
                session.put(SPACE + key, b"", attachment=forged)
            else:
                ask(session, SPACE + key, b"{}", attachment=forged)

    return flood


def rosters(folder: Path, ports: Ports) -> None:
    """Asked for and put, both."""
    session, key = viewer(folder, QUIC.format(ports.quic)), "zmav/alpha/@fleet/roster"
    roster = json.dumps({"fleet": "alpha", "number": 10**6, "t": 0, "members": [], "revoked": []})
    forged = json.dumps({"roster": roster, "signature": "A" * 88}).encode()
    for number in paced(2 * RATE):
        if number % 2:
            session.put(key, forged)
        else:
            ask(session, key)


def unread(folder: Path, ports: Ports) -> None:
    """Asks for all parameters so that no answer may be dropped, and reads none; is cut off, and comes again."""
    gate = threading.Event()
    listener = socket.create_server(("127.0.0.1", 0))

    def pump(one: socket.socket, other: socket.socket, gated: bool) -> None:
        with contextlib.suppress(OSError):
            while True:
                if gated:
                    gate.wait()
                data = one.recv(1 << 16)
                if not data:
                    break
                if gated:
                    gate.wait()
                other.sendall(data)
        for each in (one, other):
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)

    def accept() -> None:
        while True:
            near, _ = listener.accept()
            far = socket.create_connection(("127.0.0.1", ports.tls))
            threading.Thread(target=pump, args=(near, far, False), daemon=True).start()
            threading.Thread(target=pump, args=(far, near, True), daemon=True).start()

    threading.Thread(target=accept, daemon=True).start()
    while True:
        gate.set()
        with (
            contextlib.suppress(SessionError, zenoh.ZError),
            viewer(folder, TLS.format(listener.getsockname()[1])) as session,
        ):
            time.sleep(0.2)
            gate.clear()
            begun = time.monotonic()
            for _ in paced(RATE):
                ask(session, f"{SPACE}param/*", congestion_control=zenoh.CongestionControl.BLOCK)
                if time.monotonic() - begun > 3.0:
                    break
            gate.set()


FLOODS: dict[str, Flood] = {
    "state": asking("state"),
    "certificate": asking("certificate"),
    "msg/HEARTBEAT": asking("msg/HEARTBEAT"),
    "msg/*": asking("msg/*"),
    "body": asking("body"),
    "host": asking("host"),
    "param": asking("param"),
    "param/*": asking("param/*"),
    "param/P_0001": asking("param/P_0001"),
    "param/ unknown": asking("param/P_X{}"),
    "mission/mission": asking("mission/mission"),
    "file/*": asking("file/*"),
    "file/x/*": asking("file/x/*"),
    "rates": asking("rates"),
    "link/*": asking("link/*"),
    "event, its cache": asking("event/@adv/**"),
    "all of quad1/**": asking("**"),
    "all of these in turn": asking(
        "state", "msg/*", "host", "param/*", "param/P_X{}", "mission/mission", "rates", "**"
    ),
    "do/ping": ordering("ping"),
    "do/log_list": ordering("log_list", wait=0.0),
    "do/file_list": ordering("file_list", path="/", wait=0.0),
    "roster, asked and put": rosters,
    "param/*, and reads nothing": unread,
    "bench/report": asking("bench/report/x"),
    "bench/ping": asking("bench/ping"),
    "bench/order": asking_locally("bench/order/start"),
    "setpoint, 5,000/s": putting("setpoint/x"),
    "mav/tx, 5,000/s": putting("mav/tx/1/1/COMMAND_LONG"),
    "do/land, unsigned": asking_locally("do/land"),
    "do/land, forged": forging("do/land", RATE),
    "do/land, forged, 5,000/s": forging("do/land", 5 * RATE),
    "mav/tx, forged, 5,000/s": forging("mav/tx/1/1/COMMAND_LONG", 5 * RATE, put=True),
}


class Autopilot(ParamPeer):
    """In GUIDED and armed; says when it was told to land."""

    def __init__(self) -> None:
        super().__init__()
        self.params = many(PARAMETERS)
        self.mode, self.armed, self.place = GUIDED, True, (47.0, 8.0)
        self.told_to_land: asyncio.Future[float] | None = None
        self._answer_as_usual, self.on_told = self.on_told, self._see

    def _see(self, told: Told) -> None:
        self._answer_as_usual(told)
        waiting = self.told_to_land
        lands = told.name == "COMMAND_LONG" and (told.fields["command"], told.fields["param2"]) == (SET_MODE, LAND)
        if lands and waiting is not None and not waiting.done():
            waiting.set_result(time.monotonic())


class Scene:
    """The vehicle's process and the operator."""

    def __init__(self, folder: Path, autopilot: Autopilot, z: zmav.Client, ports: Ports) -> None:
        self.folder, self.autopilot, self.z, self.ports = folder, autopilot, z, ports
        self._states: list[float] = []

    async def watch(self) -> None:
        async with self.z.subscribe(f"{SPACE}state") as states:
            async for _ in states:
                self._states.append(time.monotonic())

    async def measure(self, seconds: float) -> tuple[list[float], float]:
        """Over so long: each order's delay, and the longest time without a state."""
        delays, begun, pilot = list[float](), time.monotonic(), self.autopilot
        vehicle = self.z.vehicle("quad1")
        while time.monotonic() - begun < seconds:
            pilot.told_to_land = asyncio.get_running_loop().create_future()
            sent = time.monotonic()
            order = asyncio.create_task(vehicle.land())
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(asyncio.shield(pilot.told_to_land), PATIENCE)
            told = pilot.told_to_land
            delays.append((told.result() if told.done() else time.monotonic()) - sent)
            order.cancel()
            with contextlib.suppress(asyncio.CancelledError, ZmavError):
                await order
            pilot.mode = GUIDED  # the pilot takes it back
            pilot.heartbeat()
            await asyncio.sleep(BETWEEN)
        heard = [begun, *(at for at in self._states if at > begun), time.monotonic()]
        return delays, max(after - before for before, after in itertools.pairwise(heard))


@contextlib.asynccontextmanager
async def scene(place: Path) -> AsyncIterator[Scene]:
    authority = Authority.create(place / "ca", "alpha")
    for who, role in (("view", Role.VIEWER), ("ops", Role.OPERATOR), ("quad1", Role.VEHICLE)):
        authority.issue(who, role)
    folder, ports = place / "ca" / "members", Ports(free_port(), free_port(), free_port())
    async with contextlib.AsyncExitStack() as stack:
        autopilot = Autopilot()
        await autopilot.open()
        stack.push_async_callback(autopilot.close)
        with (place / "log").open("w") as log:
            up = subprocess.Popen(
                [
                    sys.executable,
                    "-m",
                    "zmav",
                    "up",
                    "--link",
                    autopilot.url,
                    "--fleet",
                    "alpha",
                    "--name",
                    "quad1",
                    "-l",
                    TCP.format(ports.tcp),
                    "-l",
                    QUIC.format(ports.quic),
                    "-l",
                    TLS.format(ports.tls),
                    "--credentials",
                    str(folder / "quad1"),
                    "--cache",
                    str(place / "cache"),
                ],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
            )
        stack.callback(up.wait)
        stack.callback(up.kill)
        for _ in range(100):
            with contextlib.suppress(SessionError):
                viewer(folder, QUIC.format(ports.quic)).close()
                break
            await asyncio.sleep(0.2)
        settings = SessionSettings(connect=[QUIC.format(ports.quic)], credentials=str(folder / "ops"))
        z = await stack.enter_async_context(zmav.open(fleet="alpha", settings=settings))
        made = Scene(folder, autopilot, z, ports)
        watch = asyncio.create_task(made.watch())
        stack.callback(watch.cancel)
        await z.wait_for("quad1", timeout=30.0)
        await complete(z)
        yield made


async def complete(z: zmav.Client) -> None:
    """Wait until all parameters are read."""
    for _ in range(120):
        for answer in await z.ask(f"{SPACE}param"):
            if not isinstance(answer, ZmavError) and wire.decode(answer.payload, wire.ParamTable, "param").complete:
                return
        await asyncio.sleep(0.5)
    raise SystemExit("the parameters were not read")


def row(name: str, quiet: list[float], flooded: list[float], gap: float) -> str:
    figures = [1e3 * f(delays) for delays in (quiet, flooded) for f in (statistics.median, p99)]
    return f"{name:28}" + "".join(f"{figure:9.0f}" for figure in figures) + f"{gap:9.2f}{len(flooded):6}"


def p99(delays: list[float]) -> float:
    return sorted(delays)[max(0, -(-99 * len(delays) // 100) - 1)]


async def compare(seconds: float, only: str) -> None:
    print("land, ms from the operator's word to the autopilot's link, quiet and under the flood; then the longest")
    print("time without a state, s, and orders measured under the flood")
    print(f"{'':28}      p50      p99      p50      p99    state     n")
    with tempfile.TemporaryDirectory() as place:
        async with scene(Path(place)) as made:
            quiet, _ = await made.measure(max(seconds, 10.0))
            for name in FLOODS:
                if not re.search(only, name):
                    continue
                attacker = subprocess.Popen(
                    [sys.executable, __file__, "--flood", name, str(made.folder), *map(str, made.ports)],
                    preexec_fn=lambda: os.nice(19),
                    stdin=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                )
                await asyncio.sleep(2.5)  # its start costs processor time, and is no part of the flood
                flooded, gap = await made.measure(seconds)
                attacker.kill()
                attacker.wait()
                print(row(name, quiet, flooded, gap), flush=True)
                again, _ = await made.measure(2.0)
                quiet = [*quiet, *again][-100:]


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description="Floods of questions.")
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--only", default="", help="floods whose name this regular expression finds")
    given = parser.parse_args(arguments)
    asyncio.run(compare(given.seconds, given.only))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--flood"]:
        FLOODS[sys.argv[2]](Path(sys.argv[3]), Ports(*map(int, sys.argv[4:7])))
    else:
        main(sys.argv[1:])
