"""One process of a study: a router with the vehicles of its host, told what to do by lines of JSON on its input.

Each line is ``{"do": VERB, ...}``; the answer is one line on the output. It ends with its input, anyone who died.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import sys
import threading
import time
from pathlib import Path
from typing import Any

import zenoh

from tests.bench.scale.footprint import TICK_HZ, Copter
from zmav import keys
from zmav.session import SessionSettings, open_session
from zmav.tokens import find_tokens

GET_TIMEOUT = 20.0
"""s"""
PAGE = os.sysconf("SC_PAGE_SIZE")


def usage() -> dict[str, float]:
    """What this process has taken so far: CPU seconds, and resident bytes now."""
    spent = resource.getrusage(resource.RUSAGE_SELF)
    pages = int(Path("/proc/self/statm").read_text("ascii").split()[1])
    return {"cpu": spent.ru_utime + spent.ru_stime, "rss": pages * PAGE}


def alive_key(fleet: str) -> str:
    """Every vehicle's token."""
    return keys.ALIVE.key(fleet, "*", role=keys.VEHICLE, sys="*", autopilot="*", uid="*", instance="*")


def count_tokens(session: zenoh.Session, fleet: str) -> int:
    """Vehicles whose tokens ``session`` finds."""
    return len(find_tokens(session, alive_key(fleet), GET_TIMEOUT))


class Node:
    """The router, its vehicles, and the thread in which they speak."""

    def __init__(self, session: zenoh.Session, fleet: str) -> None:
        self._session, self._fleet = session, fleet
        self._copters: list[Copter] = []
        self._tokens: set[str] = set()
        self._stop = threading.Event()
        self.late = 0
        """beats that came more than one beat too late: the machine cannot do it"""
        self._thread = threading.Thread(target=self._speak, name="vehicles")

    def do(self, verb: str, line: dict[str, Any]) -> dict[str, Any]:
        """The answer to one line."""
        if verb == "declare":
            new = [Copter(self._session, self._fleet, f"v{number}", number) for number in line["numbers"]]
            if new and not self._copters:  # as every vehicle does: it listens for clashes with any other
                listen = self._session.liveliness().declare_subscriber
                self._held = listen(alive_key(self._fleet), self._on_token, history=True)
            self._copters += new
        elif verb == "speak":
            self._thread.start()
        elif verb == "count":
            return {"tokens": self.tokens()}
        return {**usage(), "late": self.late, "routers": len(self._session.info.routers_zid())}

    def tokens(self) -> int:
        """Vehicles whose tokens this router knows."""
        return count_tokens(self._session, self._fleet)

    def close(self) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    def _on_token(self, sample: zenoh.Sample) -> None:
        change = self._tokens.add if sample.kind == zenoh.SampleKind.PUT else self._tokens.discard
        change(str(sample.key_expr))

    def _speak(self) -> None:
        beat, due = 0, time.monotonic()
        while not self._stop.wait(max(0.0, due - time.monotonic())):
            for copter in self._copters:
                copter.tick(beat)
            beat, due = beat + 1, due + 1.0 / TICK_HZ
            behind = time.monotonic() - due
            if behind > 1.0 / TICK_HZ:
                self.late, due = self.late + 1, due + behind


def main() -> None:
    """``python -m tests.bench.scale.node '{"fleet": ..., "listen": [...], "connect": [...]}'``."""
    how = json.loads(sys.argv[1])
    settings = SessionSettings(
        mode="router", listen=how["listen"], connect=how["connect"], cfg=("scouting/delay:0", *how.get("cfg", ()))
    )
    with open_session(settings) as session:
        node = Node(session, how["fleet"])
        with contextlib.closing(node):
            print(json.dumps({"ready": str(session.info.zid())}), flush=True)
            for line in sys.stdin:
                told = json.loads(line)
                print(json.dumps(node.do(told["do"], told)), flush=True)


if __name__ == "__main__":
    main()
