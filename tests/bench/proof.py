"""What proofs of origin cost: a message, a setpoint's way to the autopilot, and a fleet of ten at 50 Hz.

    python tests/bench/proof.py [--rounds 3] [--rate 50] [--seconds 5] [--vehicles 10] [--json]

The sides, with credentials and without, take turns in one run. The way of a setpoint is that of setpoint.py, from its
put on the ground through the vehicle's own router to its frame at the autopilot's socket. The fleet is one process: a
router, the vehicles' agents, their autopilots (UDP sockets) and one program that leases and streams to them all; what
is compared is its processor time.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import zmav
from mesh.credentials.ca import Authority
from tests.bench.setpoint import GROUND, ZMAV, Autopilot, start
from zmav import keys, wire
from zmav.onboard import Onboard, OnboardSettings
from zmav.process import free_port
from zmav.session import SessionSettings, open_session
from zmav.trust import VARIABLE
from zmav.trust.certificate import Role
from zmav.trust.credentials import Credentials
from zmav.trust.gate import Gate
from zmav.trust.proof import Signer
from zmav.trust.seal import is_sealed, seal
from zmav.trust.verify import Verifier

WITHOUT = {name: value for name, value in os.environ.items() if name != VARIABLE}


def members(folder: Path, names: list[str]) -> Path:
    """An authority's folder with the vehicles of these names and an operator ``op``; where the members' folders are."""
    authority = Authority.create(folder / "ca", "demo")
    for name in names:
        authority.issue(name, Role.VEHICLE, out=folder / name)
    authority.issue("op", Role.OPERATOR, out=folder / "op")
    return folder


def messages(folder: Path) -> dict[str, float]:
    """µs a message, the best of five rounds."""
    own, op = Credentials.load(folder / "quad1"), Credentials.load(folder / "op")
    gate, signer, verifier = Gate(own), Signer(op), Verifier.of(op)
    order = wire.encode(wire.GoTo(id="0" * 32, lease="0" * 16, pos=(1.0, 2.0, -3.0)))
    state = wire.encode(wire.VehicleState(t=time.time(), fleet="demo", name="quad1", instance="0" * 32)) + b" " * 900
    point = wire.encode(wire.Setpoint(lease="0" * 16, seq=1, deadline=time.time(), vel=(1.0, 0.0, 0.0)))
    do, at = keys.DO.key("demo", "quad1", verb="goto"), keys.SETPOINT.key("demo", "quad1", agent="alice")
    key, secret = keys.STATE.key("demo", "quad1"), bytes(32)
    gate.check(do, order, signer.sign(do, order, introduce=True, answers=gate.epoch))
    verifier.learn(own.certificate.der)
    proofs = iter([signer.sign(do, order, answers=gate.epoch) for _ in range(5 * 300)])
    spoken, sealed = Signer(own).sign(key, state), seal(secret, at, point)
    costs: dict[str, tuple[Callable[[], object], int]] = {
        "sign an order or a state": (lambda: signer.sign(do, order, answers=gate.epoch), 1000),
        "check an order at the gate": (lambda: gate.check(do, order, next(proofs)), 300),
        "check a state": (lambda: verifier.verify(key, state, spoken), 300),
        "seal a setpoint": (lambda: seal(secret, at, point), 5000),
        "check a seal": (lambda: is_sealed(secret, at, point, sealed), 5000),
        "decode a setpoint's JSON": (lambda: wire.decode(point, wire.Setpoint, "setpoint"), 5000),
    }
    return {name: best(call, count) for name, (call, count) in costs.items()}


def best(call: Callable[[], object], count: int) -> float:
    rounds = []
    for _ in range(5):
        begun = time.perf_counter()
        for _ in range(count):
            call()
        rounds.append((time.perf_counter() - begun) / count * 1e6)
    return min(rounds)


def latencies(autopilot: Autopilot, endpoint: str, pace: list[str], credentials: Path | None) -> list[float]:
    """ms from put to frame of one stream."""
    autopilot.forget()
    environment = {**WITHOUT, **({VARIABLE: str(credentials)} if credentials else {})}
    command = [*GROUND, "zmav", endpoint, *pace]
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=120, env=environment)
    times = json.loads(done.stdout.splitlines()[-1])
    return [1e3 * (autopilot.first[n] - t) for n, t in enumerate(times, 1) if n in autopilot.first]


def ways(folder: Path, rounds: int, pace: list[str]) -> dict[str, list[float]]:
    """The latencies of both sides, by their words; each has a vehicle of its own."""
    sides: dict[str, tuple[Autopilot, str, Path | None]] = {}
    with contextlib.ExitStack() as stack:
        for words, given in (("without", None), ("with credentials", folder)):
            autopilot, endpoint = Autopilot(), f"tcp/127.0.0.1:{free_port()}"
            own = ["--credentials", str(given / "quad1")] if given else []
            start(stack, [*ZMAV, "up", "--link", f"udpout:127.0.0.1:{autopilot.port}", "-l", endpoint, *own])
            sides[words] = (autopilot, endpoint, given / "op" if given else None)
        time.sleep(4.0)
        found: dict[str, list[float]] = {words: [] for words in sides}
        for _ in range(rounds):
            for words, (autopilot, endpoint, credentials) in sides.items():
                found[words] += latencies(autopilot, endpoint, pace, credentials)
    return found


async def fleet(folder: Path | None, count: int, rate: float, seconds: float) -> None:
    """One process's fleet; prints its processor time a second while it streams, and how many setpoints were flown."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    names = [f"quad{n}" for n in range(1, count + 1)]
    async with contextlib.AsyncExitStack() as stack:
        session = stack.enter_context(open_session(SessionSettings(mode="router", listen=[endpoint])))
        for name in names:
            link = f"udpout:127.0.0.1:{Autopilot().port}"
            own = str(folder / name) if folder else None
            await stack.enter_async_context(Onboard(session, OnboardSettings(link=link, name=name, credentials=own)))
        settings = SessionSettings(connect=[endpoint], credentials=str(folder / "op") if folder else None)
        z = await stack.enter_async_context(zmav.open(settings=settings))
        vehicles = await z.wait_for(*names, timeout=60.0)
        for vehicle in vehicles:
            await vehicle.wait_until(lambda s: s.armed is True and s.clash is None, 60.0)
        leases = [await stack.enter_async_context(vehicle.lease("bench")) for vehicle in vehicles]
        before, begun, processor = await flown(vehicles), time.monotonic(), time.process_time()
        for n in range(int(rate * seconds)):
            await asyncio.sleep(max(begun + n / rate - time.monotonic(), 0.0))
            for lease in leases:
                lease.setpoint(vel=(0.001 * n, 0.0, 0.0))
        spent = (time.process_time() - processor) / (time.monotonic() - begun)
        print(json.dumps([spent, await flown(vehicles) - before]), flush=True)


async def flown(vehicles: list[Any]) -> int:
    await asyncio.sleep(0.5)
    return sum(vehicle.state.setpoints.get("flown", 0) for vehicle in vehicles)


def fleets(folder: Path, args: argparse.Namespace) -> dict[str, list[list[float]]]:
    """Both sides' processor time and setpoints flown, in turns."""
    found: dict[str, list[list[float]]] = {"without": [], "with credentials": []}
    for _ in range(args.rounds):
        for words, given in (("without", "-"), ("with credentials", str(folder))):
            command = [sys.executable, __file__, "--fleet", given, "--vehicles", str(args.vehicles)]
            command += ["--rate", str(args.rate), "--seconds", str(args.seconds)]
            done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=180, env=WITHOUT)
            found[words].append(json.loads(done.stdout.splitlines()[-1]))
    return found


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--rounds", type=int, default=3)
    options.add_argument("--rate", type=float, default=50.0)
    options.add_argument("--seconds", type=float, default=5.0)
    options.add_argument("--vehicles", type=int, default=10)
    options.add_argument("--json", action="store_true")
    options.add_argument("--fleet", help=argparse.SUPPRESS)
    args = options.parse_args()
    if args.fleet:
        asyncio.run(fleet(None if args.fleet == "-" else Path(args.fleet), args.vehicles, args.rate, args.seconds))
        return
    with tempfile.TemporaryDirectory() as scratch:
        folder = members(Path(scratch), [f"quad{n}" for n in range(1, args.vehicles + 1)])
        costs = messages(folder)
        delays = ways(folder, args.rounds, [str(args.rate), str(args.seconds)])
        loads = fleets(folder, args)
    if args.json:
        print(json.dumps({"us": costs, "ms": delays, "load": loads}))
        return
    for name, cost in costs.items():
        print(f"{name:32} {cost:8.1f} µs")
    report(args, delays, loads)


def report(args: argparse.Namespace, delays: dict[str, list[float]], loads: dict[str, list[list[float]]]) -> None:
    print(f"\na setpoint's way at {args.rate:.0f} Hz    p50 ms   p99 ms    came")
    middles = {}
    for words, values in delays.items():
        middles[words] = statistics.median(values)
        print(f"{words:26} {middles[words]:8.2f} {statistics.quantiles(values, n=100)[98]:8.2f} {len(values):7}")
    print(f"p50: with / without ×{middles['with credentials'] / middles['without']:.2f}")
    print(f"\n{args.vehicles} vehicles at {args.rate:.0f} Hz     cores (median)   flown")
    shares = {}
    for words, rounds in loads.items():
        shares[words] = statistics.median(share for share, _ in rounds)
        print(f"{words:26} {shares[words]:14.3f} {sum(count for _, count in rounds):7.0f}")
    print(f"processor: with / without ×{shares['with credentials'] / shares['without']:.2f}")


if __name__ == "__main__":
    main()
