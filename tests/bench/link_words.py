"""Links given up an hour where datagrams are lost, and a QUIC listener that a half-open call holds up. Without root.

    python tests/bench/link_words.py [--lease 0.8] [--words 8] [--streams 7] [--loss 0.2] [--delay 0.1] [--pairs 8]
    python tests/bench/link_words.py --half-open

Pairs of routers in one process, each over a relay that loses and delays. ``--streams 0``: Zenoh's own words alone.
"""

from __future__ import annotations

import argparse
import contextlib
import multiprocessing
import os
import random
import socket
import sys
import time
from pathlib import Path

import zenoh

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from mesh.quality.probe import LANES
from tests.mesh.quality.relay import Relay, everything
from zmav.process import free_port
from zmav.session import SessionSettings, open_session


def router(listen: str | None, connect: str | None, lease: float, words: int) -> zenoh.Session:
    values = {
        "transport/link/tx/lease": round(lease * 1000),
        "transport/link/tx/keep_alive": words,
        "transport/unicast/open_timeout": 3000,
        "transport/unicast/accept_timeout": 3000,
    }
    ends = [[end] if end else [] for end in (listen, connect)]
    return open_session(SessionSettings(mode="router", listen=ends[0], connect=ends[1], values=values))


def endpoint(port: int) -> str:
    return f"udp/127.0.0.1:{port}?rel=1;mixed_rel=1"


def given_up(args: argparse.Namespace) -> None:
    rng, gone, ends = random.Random(1), [0], []
    with contextlib.ExitStack() as stack:

        def on_transport(event: zenoh.TransportEvent) -> None:
            gone[0] += event.kind == zenoh.SampleKind.DELETE

        relays = []
        for number in range(args.pairs):
            port = free_port(socket.SOCK_DGRAM)
            one = router(endpoint(port), None, args.lease, args.words)
            relays.append(stack.enter_context(Relay(port)))
            two = router(None, relays[-1].endpoint, args.lease, args.words)
            one.info.declare_transport_events_listener(on_transport)
            for session, own, other in ((one, "one", "two"), (two, "two", "one")):
                session.declare_subscriber(f"words/{number}/{own}", lambda sample: None)
                ends.append((session, f"words/{number}/{other}"))
        time.sleep(3.0)
        for relay in relays:
            relay.delay = [args.delay, args.delay]
            relay.drop = [lambda data: rng.random() < args.loss] * 2
        gone[0], began, turn, linked = 0, time.monotonic(), 0, 0
        while time.monotonic() - began < args.seconds:
            for session, key in ends if args.streams else ():
                lane = LANES[turn % args.streams]
                session.put(key, b"", priority=lane, congestion_control=zenoh.CongestionControl.DROP)
            turn += 1
            linked += sum(bool(session.info.transports()) for session, _ in ends[::2])
            time.sleep(max(began + turn * args.lease / args.words - time.monotonic(), 0.0))
        hours = linked / turn * args.seconds / 3600
        print(f"{gone[0]} links given up in {hours:.2f} hours of links, load {os.getloadavg()[0]:.1f}", flush=True)
    os._exit(0)  # sessions with such links close for ten seconds each


def call(to: str) -> None:
    with router(None, to, 1.0, 4):
        time.sleep(60.0)


def half_open() -> None:
    """A caller whose answers are lost and which ends; then how long another one is not answered."""
    for held in (False, True):
        port = free_port(socket.SOCK_DGRAM)
        with router(endpoint(port), None, 1.0, 4), Relay(port) as relay:
            relay.drop[1] = everything
            if held:
                caller = multiprocessing.get_context("spawn").Process(target=call, args=(relay.endpoint,))
                caller.start()
                time.sleep(3.5)
                caller.kill()
                caller.join()
            began, other = time.monotonic(), router(None, endpoint(port), 1.0, 4)
            while not other.info.transports():
                time.sleep(0.05)
            print(f"{'after a half-open call' if held else 'alone'}: {time.monotonic() - began:.1f} s", flush=True)
    os._exit(0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--half-open", action="store_true")
    numbers = {"lease": 0.8, "words": 8, "streams": 7, "loss": 0.2, "delay": 0.1, "pairs": 8, "seconds": 300.0}
    for name, default in numbers.items():
        parser.add_argument(f"--{name}", type=type(default), default=default)
    args = parser.parse_args()
    half_open() if args.half_open else given_up(args)


if __name__ == "__main__":
    main()
