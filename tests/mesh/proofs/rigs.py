"""The labs of the proofs, and what is watched in them: for the short tests here, and for tests/bench/mesh_proofs.py."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import statistics
import time
from collections.abc import AsyncIterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
import zenoh
import zenoh.ext

import zmav
from mesh.lab.lab import Lab
from mesh.lab.network import LabError, check_able
from mesh.lab.scenario import Scenario, check
from zmav import keys, wire
from zmav.errors import ZmavError
from zmav.waiting import on_loop, within

PATIENCE = 60.0


def scenario(**tables: Any) -> Scenario:
    """A scenario from what its file would hold."""
    return check(msgspec.convert(tables, Scenario))


def able() -> bool:
    """A lab can be laid here; where not, it is said why."""
    try:
        check_able()
    except LabError as e:
        print(f"skipped: {e}")
        return False
    return True


def chain(
    vehicles: int, *, relays: int = 0, credentials: bool = False, lease: float | None = None, **conditions: Any
) -> Scenario:
    """ground - relay1 ... - quad1 - quad2 ...: each hears only those beside it. ``lease``: not the profile's."""
    names = ["ground", *(f"relay{i + 1}" for i in range(relays)), *(f"quad{i + 1}" for i in range(vehicles))]
    hosts = {name: {"vehicle": "copter"} if name.startswith("quad") else {} for name in names}
    pairs = list(itertools.pairwise(names))
    return scenario(
        name="chain",
        profile="mesh",
        credentials=credentials,
        hosts=_placed(hosts),
        fleet=_leased(lease),
        media=[{"kind": "radio", "name": "mesh", "interface": "wlan0", "pairs": pairs, **conditions}],
    )


def ring(*, credentials: bool = False, lease: float | None = None, **conditions: Any) -> Scenario:
    """Six hosts: ground - a1 - a2 - quad1 - b2 - b1 - ground."""
    names = ["ground", "a1", "a2", "quad1", "b2", "b1"]
    hosts = {name: {"vehicle": "copter"} if name == "quad1" else {} for name in names}
    pairs = list(zip(names, [*names[1:], names[0]], strict=True))
    return scenario(
        name="ring",
        profile="mesh",
        credentials=credentials,
        hosts=_placed(hosts),
        fleet=_leased(lease),
        media=[{"kind": "radio", "name": "mesh", "interface": "wlan0", "pairs": pairs, **conditions}],
    )


BEHIND_THE_HOP = ("ground-quad2", "quad1-quad2")
"""links of :func:`wds` that its last hop carries"""


def wds(*, credentials: bool = False, lease: float | None = None, **conditions: Any) -> Scenario:
    """One segment over three access points: the ground at the first, a copter at each of the others."""
    hosts: dict[str, Any] = {"ground": {}, "quad1": {"vehicle": "copter"}, "quad2": {"vehicle": "copter"}}
    medium = {"kind": "radio", "name": "wds", "interface": "wlan0", "shared": True, **conditions}
    medium["ends"] = {"ground-quad2": {"delay": "6 ms"}}
    return scenario(
        name="wds", profile="wds", credentials=credentials, hosts=_placed(hosts), fleet=_leased(lease), media=[medium]
    )


def grid(width: int, height: int, *, credentials: bool = False, **conditions: Any) -> Scenario:
    """Hosts without vehicles on a grid, each hearing its neighbours in the four directions."""
    names = [f"h{row * width + column}" for row in range(height) for column in range(width)]
    pairs = [(names[i], names[i + 1]) for i in range(len(names)) if (i + 1) % width]
    pairs += [(names[i], names[i + width]) for i in range(len(names) - width)]
    return scenario(
        name="grid",
        profile="mesh",
        credentials=credentials,
        hosts={name: {} for name in names},
        media=[{"kind": "radio", "name": "mesh", "interface": "wlan0", "pairs": pairs, **conditions}],
    )


def _leased(lease: float | None) -> dict[str, Any]:
    """What the fleet file says of leases, in s; None: nothing, and the profile's hold."""
    return {"mesh": {"lease": lease}} if lease else {}


def _placed(hosts: dict[str, Any]) -> dict[str, Any]:
    return {name: {**host, "position": [0.0, 30.0 * i]} for i, (name, host) in enumerate(hosts.items())}


@contextlib.asynccontextmanager
async def station(lab: Lab, host: str = "ground", **more: Any) -> AsyncIterator[zmav.Client]:
    """A client of a host's router, with that host's credentials where the lab has them."""
    if lab.scenario.credentials:
        more["credentials"] = str(lab.credentials(host))
    async with zmav.open(fleet=lab.fleet, connect=[await lab.endpoint(host)], **more) as z:
        yield z


async def all_heard(z: zmav.Client, lab: Lab, timeout: float = PATIENCE) -> float:
    """Seconds until every vehicle's autopilot is heard at the client."""
    start = time.monotonic()
    names = [name for name, host in lab.scenario.hosts.items() if host.vehicle]
    for vehicle in await z.wait_for(*names, timeout=timeout):
        await vehicle.wait_until(lambda state: state.connected, timeout)
    return time.monotonic() - start


async def in_the_air(vehicle: zmav.Vehicle, height: float = 10.0) -> None:
    """Armed and at that height."""
    await vehicle.arm(ready_timeout=PATIENCE)
    await vehicle.takeoff(height)


class Events:
    """A vehicle's events as a reader who must miss none has them: past ones first, lost ones recovered."""

    def __init__(self, session: zenoh.Session, fleet: str, name: str) -> None:
        self.events: list[wire.Event] = []
        ext = zenoh.ext
        self._news = asyncio.Event()
        self._subscriber = ext.declare_advanced_subscriber(
            session,
            keys.EVENT.key(fleet, name),
            on_loop(asyncio.get_running_loop(), self._take),
            history=ext.HistoryConfig(detect_late_publishers=True),
            recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
        )

    def _take(self, sample: zenoh.Sample) -> None:
        self.events.append(wire.decode(sample.payload.to_bytes(), wire.Event, "event"))
        self._news.set()

    def texts(self, kind: str) -> list[str]:
        return [event.text for event in self.events if event.kind == kind]

    async def until(self, kind: str, text: str, timeout: float = PATIENCE) -> None:
        """Wait for an event of that kind whose words hold ``text``; raises asyncio.TimeoutError."""
        deadline = time.monotonic() + timeout
        while not any(text in said for said in self.texts(kind)):
            self._news.clear()
            await within(deadline - time.monotonic(), self._news.wait())

    def close(self) -> None:
        self._subscriber.undeclare()


class Gaps:
    """A stream of one message, and the moments at which it came."""

    def __init__(self, z: zmav.Client, fleet: str, vehicle: str, message: str = "ATTITUDE") -> None:
        self.times: list[float] = []
        key = keys.RX.key(fleet, vehicle, sys="*", comp="*", msg=message)
        self._subscriber = z.session.declare_subscriber(key, lambda sample: self.times.append(time.monotonic()))

    def close(self) -> None:
        self._subscriber.undeclare()

    def longest(self, since: float) -> float:
        """The longest silence since a moment, the one that still lasts included, in s."""
        times = [since, *(t for t in list(self.times) if t >= since), time.monotonic()]
        return max(b - a for a, b in itertools.pairwise(times))

    async def again(self, since: float, timeout: float = PATIENCE) -> float:
        """Wait until it comes again after ``since``, and steadily; the silence in s."""
        deadline = time.monotonic() + timeout
        while len([t for t in list(self.times) if t > max(since, time.monotonic() - 1.0)]) < 6:
            if time.monotonic() > deadline:
                raise asyncio.TimeoutError
            await asyncio.sleep(0.05)
        return self.longest(since)


def active(lab: Lab, one: str, other: str, before: Sequence[int]) -> tuple[str, list[int]]:
    """Which of two links carried more bytes since the counts ``before``, and the counts now."""
    now = [sum(each.arrived_bytes for each in lab.counters(link)) for link in (one, other)]
    return (one if now[0] - before[0] >= now[1] - before[1] else other), now


async def pings(vehicle: zmav.Vehicle, count: int) -> list[float]:
    """Round trips of orders in s, those that no answer came for left out."""
    took = []
    for _ in range(count):
        with contextlib.suppress(ZmavError):
            took.append(await vehicle.ping())
    return took


def milliseconds(values: Sequence[float]) -> str:
    """``median (worst)``"""
    if not values:
        return "-"
    return f"{1e3 * statistics.median(values):.1f} ({1e3 * max(values):.1f}) ms"


def logs(lab: Lab) -> str:
    """The end of what every program said, for a failure."""
    said = {name: Path(program.log).read_text("utf-8", "replace")[-900:] for name, program in lab.programs.items()}
    return "\n".join(f"--- {name}\n{text}" for name, text in said.items())
