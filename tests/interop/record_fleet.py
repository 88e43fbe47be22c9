"""Record what a fleet of an older zmav says, for tests that hold today's ground against it:

    python tests/interop/record_fleet.py TREE tests/interop/fleet-0.1.jsonl

TREE is a checkout of that version. Its simulator, two vehicles and its planner are started; they take off, a planner's
goal is flown, and questions and orders are asked. Each line is a token, a sample (``put``) or a reply, with its key and
its bytes as they came.
"""

from __future__ import annotations

import base64
import collections
import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import zenoh

from zmav.errors import SessionError
from zmav.process import free_port
from zmav.session import SessionSettings, open_session

MOST = {"state": 8, "rx": 2}
"""samples of a key, by its channel; of others 5"""
QUESTIONS = (
    "state", "msg/HEARTBEAT", "msg/ATTITUDE", "param/RTL_ALT", "mission/mission", "mission/fence", "mission/rally",
    "body", "host", "rates", "link/*", "certificate",
)  # fmt: skip
REFUSED: tuple[tuple[str, dict[str, Any]], ...] = (
    ("goto", {"pos": [0, 0, -90000]}),
    ("takeoff", {"alt_rel": 10, "colour": "red"}),
    ("ping", {}),
    ("land", {}),
)
PATIENCE_S = 60.0


class Recording:
    """Lines as they come, no more of a key than :data:`MOST` says. Thread-safe."""

    def __init__(self) -> None:
        self.lines: list[dict[str, Any]] = []
        self._count: collections.Counter[str] = collections.Counter()
        self._lock = threading.Lock()

    def clear(self) -> None:
        with self._lock:
            self._count.clear()
            self.lines = [line for line in self.lines if line["kind"] != "put"]

    def put(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        most = next((most for name, most in MOST.items() if f"/{name}" in key), 5)
        with self._lock:
            self._count[key] += 1
            if self._count[key] <= most and "/@probe/" not in key:
                self.lines.append(_line("put", key, sample.payload.to_bytes()))

    def reply(self, key: str, asked: str, payload: bytes, *, error: bool = False) -> None:
        with self._lock:
            self.lines.append(_line("error" if error else "reply", key, payload, asked=asked))

    def token(self, key: str) -> None:
        with self._lock:
            self.lines.append({"kind": "token", "key": key})


def _line(kind: str, key: str, payload: bytes, **more: str) -> dict[str, Any]:
    try:
        body = {"text": payload.decode()} if "/mav/" not in key else {"base64": base64.b64encode(payload).decode()}
    except UnicodeDecodeError:
        body = {"base64": base64.b64encode(payload).decode()}
    return {"kind": kind, "key": key, **more, **body}


@contextlib.contextmanager
def fleet(tree: Path, router: str) -> Iterator[None]:
    """Two copters of that tree and its planner, on that router."""
    # Two vehicles are soon planned for, while a solver is long compiled.
    environment = {**os.environ, "PYTHONPATH": str(tree), "ZMAV_CONNECT": router, "NUMBA_DISABLE_JIT": "1"}
    ports = sorted((free_port(), free_port()))
    origin = ("--origin", "-35.363261", "149.165230", "584.09")
    commands = [["sim", "--copters", "2", "--endpoint", f"tcp:{ports[0]}+{ports[1] - ports[0]}"]]
    for index, port in enumerate(ports):
        where = ("-l", router) if index == 0 else ("-l", "tcp/127.0.0.1:0", "-e", router)
        commands.append(["up", "--link", f"tcp:127.0.0.1:{port}", "--name", f"quad{index + 1}", *origin, *where])
    commands.append(["swarm", "planner", "--name", "ground"])
    started = []
    try:
        for command in commands:
            started.append(subprocess.Popen([sys.executable, "-m", "zmav", *command], cwd=tree, env=environment))
            if command[0] != "sim":
                wait_for_router(router)
        yield
    finally:
        for process in reversed(started):
            process.send_signal(signal.SIGTERM)
            process.wait(PATIENCE_S)


def wait_for_router(router: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while True:
        try:
            open_session(SessionSettings(connect=[router])).close()
            return
        except SessionError:
            if time.monotonic() > deadline:
                raise


def verb(tree: Path, router: str, *arguments: str) -> None:
    environment = {**os.environ, "PYTHONPATH": str(tree), "ZMAV_CONNECT": router}
    subprocess.run([sys.executable, "-m", "zmav", *arguments], cwd=tree, env=environment, check=True, timeout=300)


def ask(session: zenoh.Session, recording: Recording, key: str, payload: bytes | None = None) -> None:
    for reply in session.get(key, payload=payload, timeout=10.0):
        if reply.ok is not None:
            recording.reply(str(reply.ok.key_expr), key, reply.ok.payload.to_bytes())
        elif reply.err is not None:
            recording.reply(key, key, reply.err.payload.to_bytes(), error=True)


def record(tree: Path) -> Recording:
    router, recording = f"tcp/127.0.0.1:{free_port()}", Recording()
    with fleet(tree, router), open_session(SessionSettings(connect=[router])) as session:
        time.sleep(15.0)  # until they are ready to arm
        for space in ("zmav/demo/**", "zmav/demo/@fleet/**", "zmav/demo/@obstacle/**"):
            session.declare_subscriber(space, recording.put)
        verb(
            tree, router, "swarm", "obstacle", "add", "tower", "--cylinder", "40,10", "--radius", "3", "--ceiling", "60"
        )
        verb(tree, router, "swarm", "takeoff", "quad*", "--alt", "10")
        verb(tree, router, "swarm", "goto", "quad1=10,0,10", "quad2=0,15,12", "--no-wait")
        time.sleep(1.0)
        recording.clear()
        time.sleep(4.0)
        for reply in session.liveliness().get("zmav/demo/**", timeout=2.0):
            if reply.ok is not None:
                recording.token(str(reply.ok.key_expr))
        for name in ("quad1", "quad2"):
            for question in QUESTIONS:
                ask(session, recording, f"zmav/demo/{name}/{question}")
            for order, arguments in REFUSED:
                said = {**arguments, "id": f"old-{name}-{order}", "wait": 1.0}
                ask(session, recording, f"zmav/demo/{name}/do/{order}", json.dumps(said).encode())
        ask(session, recording, "zmav/demo/ground/swarm/status", b"{}")
    return recording


def main() -> None:
    tree, file = (Path(argument) for argument in sys.argv[1:])
    lines = record(tree.resolve()).lines
    file.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")


if __name__ == "__main__":
    main()
