"""What a vehicle's companion computer pays for one autopilot: 'zmav up' with nobody or a reader over a network hop, at
rest and armed, a GCS bridge, or a stream of setpoints at 10 Hz; beside pymavlink, MAVSDK and mavlink-router where they
are installed, and a bare Zenoh publisher, in one run.

    python tests/bench/companion.py [--rates 50,100,250,500] [--seconds 6] [--rounds 1] [--sides zmav,...] [--json]

The autopilot sends so many messages a second, one datagram each, evenly. Each side is started, loaded with every rate,
and ended. Processor and context switches are the scheduler's, of every thread of the process; "us" is processor a
message. PSS shares what is mapped from files among all processes that run: on a computer of its own it is higher.
Processor is compared with processor of the same run: what else runs here makes all of them dearer.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import shutil
import socket
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.bench._load import MIX, end
from tests.bench.setpoint import Autopilot
from zmav.process import free_port

HERE = Path(__file__).resolve().parent
PEERS = [sys.executable, str(HERE / "_peers.py")]
ZMAV = [sys.executable, "-m", "zmav"]
BESIDE = 20.0
"""messages a second that the autopilot sends besides: heartbeats and positions"""
SETTLE = 6.0
"""s for a side to start, and to know its vehicle"""


class Feeder(Autopilot):
    """In GUIDED, and tells of itself as often as it is asked to, to who spoke to it or to a port."""

    def tell(self, port: int | None) -> None:
        """Whom; None: the companion, once it has spoken."""
        self._peer = None if port is None else ("127.0.0.1", port)

    def load(self, rate: float, seconds: float) -> int:
        """Send evenly; how many."""
        begun, total = time.monotonic(), int(rate * seconds)
        for number in range(total):
            time.sleep(max(0.0, begun + number / rate - time.monotonic()))
            if self._peer is not None:
                self._socket.sendto(self._packer.pack(MIX[number % len(MIX)]), self._peer)
        return total


class Sample(NamedTuple):
    """A process's sums so far: seconds of processor, and context switches."""

    cpu: float
    switches: int


def sample(pid: int) -> Sample:
    cpu, switches = 0, 0
    for task in Path(f"/proc/{pid}/task").iterdir():
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):
            cpu += int((task / "schedstat").read_text().split()[0])
            status = (task / "status").read_text().splitlines()
            switches += sum(int(line.split()[1]) for line in status if "ctxt_switches" in line)
    return Sample(cpu / 1e9, switches)


def memory(pid: int) -> tuple[float, float]:
    """RSS and PSS in MB."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    found = {name: int(rest.split()[0]) / 1024 for name, _, rest in (line.partition(":") for line in lines[1:])}
    return found["Rss"], found["Pss"]


class Side(NamedTuple):
    """``commands`` are started in this order; ``measured`` of them by the names of their rows. ``port``: where the
    autopilot sends; None: it is spoken to first. ``armed``: so it says.
    """

    name: str
    commands: list[list[str]]
    measured: dict[int, str]
    port: int | None = None
    armed: bool = False


def sides(feeder: Feeder, out: int) -> Iterator[Side]:
    """Each when its turn has come: the ports it names are free then."""

    def ground(endpoint: str) -> list[str]:
        return [*PEERS, "ground", endpoint, str(out)]

    for armed in (False, True):
        when = " armed" if armed else ""
        yield _zmav(f"zmav nobody{when}", feeder, lambda endpoint: [])._replace(armed=armed)
        yield _zmav(f"zmav one reader{when}", feeder, ground)._replace(armed=armed)
    yield _zmav("zmav GCS bridge", feeder, lambda endpoint: [*ZMAV, "gcs", "--udp", str(out), "-e", endpoint])
    yield _zmav(
        "zmav setpoints",
        feeder,
        lambda endpoint: [sys.executable, str(HERE / "_ground.py"), "zmav", endpoint, "10", "600"],
    )._replace(armed=True)
    port = free_port(socket.SOCK_DGRAM)
    yield Side("pymavlink", [[*PEERS, "pymavlink", str(port), str(out)]], {0: "pymavlink"}, port)
    port, endpoint = free_port(socket.SOCK_DGRAM), f"tcp/127.0.0.1:{free_port()}"
    bare = [[*PEERS, "bare-in", str(port), endpoint], [*PEERS, "bare-out", endpoint, str(out)]]
    yield Side("bare Zenoh hop", bare, {0: "bare Zenoh hop"}, port)
    with contextlib.suppress(ImportError):
        import mavsdk.asyncio  # noqa: F401 (where it is installed)

        port = free_port(socket.SOCK_DGRAM)
        stream = [sys.executable, str(HERE / "clients.py"), "--side", "MAVSDK", str(port)]
        yield Side("MAVSDK", [stream], {0: "MAVSDK"}, port)
    if router := shutil.which("mavlink-routerd"):
        port = free_port(socket.SOCK_DGRAM)
        yield Side(
            "mavlink-router", [[router, "-e", f"127.0.0.1:{out}", f"127.0.0.1:{port}"]], {0: "mavlink-router"}, port
        )


def _zmav(name: str, feeder: Feeder, other: Callable[[str], list[str]]) -> Side:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    up = [*ZMAV, "up", "--link", f"udpout:127.0.0.1:{feeder.port}", "-l", endpoint]
    beside = other(endpoint)
    measured = {0: name, 1: "  the bridge itself"} if "gcs" in beside else {0: name}
    return Side(name, [up, beside] if beside else [up], measured)


def run(side: Side, feeder: Feeder, rates: list[float], seconds: float) -> list[dict[str, Any]]:
    """A row for each of its processes at each rate."""
    rows = []
    with contextlib.ExitStack() as stack:
        feeder.tell(side.port)
        feeder.armed = side.armed
        processes = []
        for command in side.commands:
            processes.append(subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL))
            stack.callback(end, processes[-1])
            feeder.load(50.0, SETTLE)
        for rate in rates:
            feeder.load(rate, 1.0)
            before, begun = [sample(processes[index].pid) for index in side.measured], time.monotonic()
            feeder.load(rate, seconds)
            took = time.monotonic() - begun
            for (index, name), then in zip(side.measured.items(), before, strict=True):
                now = sample(processes[index].pid)
                rss, pss = memory(processes[index].pid)
                cpu = now.cpu - then.cpu
                rows.append(
                    {
                        "side": name,
                        "rate": rate,
                        "core": cpu / took,
                        "us": 1e6 * cpu / (rate + BESIDE) / took,
                        "switches": (now.switches - then.switches) / took,
                        "rss_mb": rss,
                        "pss_mb": pss,
                        "threads": len(list(Path(f"/proc/{processes[index].pid}/task").iterdir())),
                    }
                )
    return rows


def _drain(sock: socket.socket) -> None:
    while True:
        sock.recv(65535)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--rates", default="50,100,250,500")
    options.add_argument("--seconds", type=float, default=6.0)
    options.add_argument("--rounds", type=int, default=1)
    options.add_argument("--sides", default="", help="beginnings of names, between commas")
    options.add_argument("--json", action="store_true")
    args = options.parse_args()
    rates, wanted = [float(each) for each in args.rates.split(",")], tuple(args.sides.split(","))
    sink = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sink.bind(("127.0.0.1", 0))
    threading.Thread(target=_drain, args=(sink,), daemon=True).start()
    feeder = Feeder()
    found: list[dict[str, Any]] = []
    for _ in range(args.rounds):
        for side in sides(feeder, sink.getsockname()[1]):
            if side.name.startswith(wanted):
                found += run(side, feeder, rates, args.seconds)
    runs: dict[tuple[str, float], list[dict[str, Any]]] = {}
    for each in found:
        runs.setdefault((each["side"], each["rate"]), []).append(each)
    rows: list[dict[str, Any]] = [
        {"side": side, "rate": rate, **{name: statistics.median(each[name] for each in of) for name in FIGURES}}
        for (side, rate), of in runs.items()
    ]
    if args.json:
        print(json.dumps(rows))
        return
    print(f"{'':22}  msg/s   core    us/msg  switches/s   RSS MB   PSS MB  threads")
    for r in rows:
        print(
            f"{r['side']:22}  {r['rate']:5.0f}  {r['core']:5.1%}  {r['us']:8.1f}  {r['switches']:10.0f}  "
            f"{r['rss_mb']:7.1f}  {r['pss_mb']:7.1f}  {r['threads']:7.0f}"
        )
    for rate in rates:
        core = {r["side"]: r["core"] for r in rows if r["rate"] == rate}
        for peer in ("pymavlink", "bare Zenoh hop", "MAVSDK", "mavlink-router"):
            ratios = [
                f"{name[5:]} x{core[name] / core[peer]:.2f}" for name in core if name[:4] == "zmav" and peer in core
            ]
            if ratios:
                print(f"at {rate:.0f}/s, processor beside {peer}: {', '.join(ratios)}")


FIGURES = ("core", "us", "switches", "rss_mb", "pss_mb", "threads")

if __name__ == "__main__":
    main()
