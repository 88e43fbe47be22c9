"""A protocol peer for ArduPilot's JSON interface, which stands in for a SITL program in the tests: it takes the options
that such a program takes, speaks the protocol as its published page has it, and flies to 5 m by the controller beside
it. No ArduPilot is in it.

It writes what it was given to ``started.json`` in its directory. ``--defaults`` files with a line ``PEER_DIES n`` have
it end, with exit status 3, after n frames; the rate of its frames is PEER_RATE.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import socket
import struct
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tests.hil.hover import PLUS, state_of, steer


def options() -> tuple[argparse.Namespace, list[str]]:
    parser = argparse.ArgumentParser()
    parser.add_argument("--model")
    parser.add_argument("--home")
    parser.add_argument("--sysid", type=int)
    parser.add_argument("-I", type=int, default=0, dest="instance")
    parser.add_argument("--defaults", default="")
    parser.add_argument("--sim-port-out", type=int, default=9002)
    words = sys.argv[1:]
    if "--home" in words:  # a southern latitude looks like an option
        at = words.index("--home")
        words[at : at + 2] = [f"--home={words[at + 1]}"]
    return parser.parse_known_args(words)


def params(files: str) -> dict[str, float]:
    found = {}
    for name in filter(None, files.split(",")):
        for line in Path(name).read_text(encoding="ascii").splitlines():
            if line and not line.startswith("#"):
                key, value = line.replace(",", " ").split()[:2]
                found[key] = float(value)
    return found


class Peer:
    """Sends servo packets and flies by the answers."""

    def __init__(self, port: int, rate: int) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", port))
        self.socket.settimeout(1.0)
        self.rate = rate
        self.frame = 0
        self.pwm = [1000] * 16

    def exchange(self) -> Any:
        """One step: sends again each second while there is no answer."""
        while True:
            try:
                self.socket.send(struct.pack("<HHI16H", 18458, self.rate, self.frame, *self.pwm))
                answer = self.socket.recv(65536)
            except (TimeoutError, ConnectionRefusedError):
                continue
            assert answer.startswith(b"\n") and answer.endswith(b"\n")
            self.frame += 1
            return json.loads(answer)

    def fly(self, told: Any, target: tuple[float, float, float]) -> None:
        self.pwm[:4] = [round(1000 + 1000 * throttle) for throttle in steer(PLUS, state_of(told), target, 0.0)]


def main() -> None:
    given, rest = options()
    Path("started.part").write_text(
        json.dumps({"argv": sys.argv[1:], "rest": rest, "pid": os.getpid(), "cwd": str(Path.cwd())}), encoding="ascii"
    )
    Path("started.part").rename("started.json")  # whole, or not there
    found = params(given.defaults)
    print(f"peer {given.instance} starts with {found}", flush=True)
    # As ArduPilot does: only the usual port follows the instance.
    port = given.sim_port_out if given.sim_port_out != 9002 else 9002 + 10 * given.instance
    peer = Peer(port, int(found.get("PEER_RATE", 400)))
    while True:
        peer.fly(peer.exchange(), (0.0, 0.0, -5.0))
        if peer.frame >= found.get("PEER_DIES", math.inf):
            print("peer dies as it was told", flush=True)
            sys.exit(3)


if __name__ == "__main__":
    main()
