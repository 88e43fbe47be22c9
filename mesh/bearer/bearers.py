"""The bearer that a router's plan calls for: which neighbours it carries, and what the router listens and calls with.

A pair of hosts meets through bearers where one of the two has the profile ``multi``, or a radio between them has a
budget: both have the same fleet file and find the same. A bearer listens one port above the radio's router. Of a
pair, the one whose name comes first opens the link.
"""

from __future__ import annotations

import asyncio
import ipaddress
import json
import socket
from collections.abc import Sequence
from dataclasses import replace

import msgspec

from mesh.bearer.bearer import Bearer, Far
from mesh.bearer.port import Address
from mesh.endpoint import between, bound, host_port
from mesh.neighbours import Neighbour, Way
from mesh.plan import RouterPlan, Setting
from zmav.config import FleetConfig, Radio
from zmav.errors import BadConfig
from zmav.process import free_port
from zmav.session import BLOCKED, SessionSettings

LISTEN, CONNECT = "listen/endpoints", "connect/endpoints"
ABOVE = 1
"""from a radio's port to its bearer's"""
BATCH = 2048
"""bytes of Zenoh's batches: with 64 kB, a batch of telemetry holds up setpoints (p99 212 ms against 129 at 1 Mbit/s)"""


def carried(plan: RouterPlan) -> tuple[Neighbour, ...]:
    """The neighbours of a plan that are met through bearers."""
    return tuple(each for each in plan.neighbours if each.ways and _meets(plan.file, plan.name, each))


def borne(plan: RouterPlan) -> tuple[Radio, ...]:
    """The host's radios on which a bearer listens."""
    ways = {way.radio.address for each in carried(plan) for way in each.ways}
    return tuple(r for r in plan.host.radios if r.address and (r.budget or r.address in ways))


def _meets(file: FleetConfig, name: str, neighbour: Neighbour) -> bool:
    profiles = {file.profile_of(file.host(each).mesh) for each in (name, neighbour.name)}
    addresses = {way.address for way in neighbour.ways}
    theirs = [r for r in file.host(neighbour.name).mesh.radios if _plain(r) in addresses]
    return "multi" in profiles or any(radio.budget for radio in (*theirs, *(way.radio for way in neighbour.ways)))


def _plain(radio: Radio) -> str | None:
    """A radio's address without its network's size."""
    return radio.address.partition("/")[0] if radio.address else None


class Bearers:
    """``async with Bearers(plan) as bearers: bearers.plan`` is what the router is to be opened with.

    Where nothing is to be carried it is the plan itself, and no thread runs. Raises
    :class:`~zmav.errors.BadConfig` for a port that leaves none above it.
    """

    def __init__(self, plan: RouterPlan) -> None:
        self.plan, self._given = plan, plan
        self.bearer: Bearer | None = None

    async def __aenter__(self) -> Bearers:
        plan, radios = self._given, borne(self._given)
        if not radios:
            return self
        router = ("127.0.0.1", free_port(socket.SOCK_DGRAM))
        fars = [_far(plan, each, radios) for each in carried(plan)]
        ports = _ports(plan, radios)
        known = [*plan.file.vehicles, *plan.file.stations]
        self.bearer = Bearer(plan.fleet, plan.name, ports, fars, router, known)
        self.plan = _rewired(plan, radios, router, [self.bearer.local[far.name] for far in fars if far.opens])
        await asyncio.to_thread(self.bearer.__enter__)
        return self

    def session(self, base: SessionSettings) -> SessionSettings:
        """What to open the router's session with; what ``base`` says of what bearers change is in the plan already."""
        before, after = self._given.settings, self.plan.settings
        ours = [f"{path}:{json.dumps(each.value)}" for path, each in after.items() if each is not before.get(path)]
        settings = self.plan.session(base)
        return msgspec.structs.replace(settings, cfg=[*settings.cfg, *ours])  # the last word on each path

    async def __aexit__(self, *_: object) -> None:
        if self.bearer is not None:
            await asyncio.to_thread(self.bearer.__exit__, None, None, None)
            self.bearer = None


def foreseen(plan: RouterPlan) -> tuple[RouterPlan, list[Far]]:
    """What a router will be opened with, and whom its bearer carries; ports of loopback, chosen then, stand as 0."""
    radios = [radio for radio, _ in _ports(plan, borne(plan))]
    fars = [_far(plan, each, radios) for each in carried(plan)]
    later = ("127.0.0.1", 0)
    return (_rewired(plan, radios, later, [later for far in fars if far.opens]) if radios else plan), fars


def _far(plan: RouterPlan, neighbour: Neighbour, radios: Sequence[Radio]) -> Far:
    ways = [
        (_place(radios, way), (way.address, _above(way.port)), _cost(plan.file, neighbour.name, way))
        for way in neighbour.ways
    ]
    return Far(neighbour.name, ways, opens=plan.name < neighbour.name)


def _ports(plan: RouterPlan, radios: Sequence[Radio]) -> list[tuple[Radio, int]]:
    return [(radio, _above(radio.port or plan.file.mesh.port)) for radio in radios]


def _above(port: int) -> int:
    if port + ABOVE > 65535:
        text = f"port {port} leaves none for the bearer, which listens one above it: take a smaller one"
        raise BadConfig(text, field="port", value=port, expected="65534 at most")
    return port + ABOVE


def _place(radios: Sequence[Radio], way: Way) -> int:
    return next(place for place, radio in enumerate(radios) if radio.address == way.radio.address)


def _cost(file: FleetConfig, name: str, way: Way) -> int:
    """A way's cost is that of the radios at both its ends."""
    theirs = [r.way_cost() for r in file.host(name).mesh.radios if _plain(r) == way.address]
    return way.radio.way_cost() + (theirs[0] if theirs else way.radio.way_cost())


def _rewired(plan: RouterPlan, radios: Sequence[Radio], router: Address, local: Sequence[Address]) -> RouterPlan:
    """The plan with the bearers' endpoints in place of the radios' that they carry."""
    direct = {(way.address, way.port) for each in carried(plan) for way in each.ways}
    own = {(str(r.address), r.port or plan.file.mesh.port) for r in radios if r.budget or plan.profile == "multi"}
    ours = {LISTEN: ([router], own), CONNECT: (list(local), direct)}
    settings = dict(plan.settings)
    for path, (added, replaced) in ours.items():
        source = plan.settings[path].source if path in plan.settings else "zmav"
        kept = [each for each in plan.endpoints(path) if _address(each) not in replaced]
        ends = [between(*each, plan.credentials is not None) for each in added]
        new = [*kept, *(ends if path == LISTEN else (bound(end, "127.0.0.1") for end in ends))]
        if new != plan.endpoints(path):
            settings[path] = Setting(new, f"{source}, bearers")
    settings.update(_scouting(plan, {r.interface for r in radios if r.budget}))
    if "transport/link/tx/batch_size" not in settings:
        settings["transport/link/tx/batch_size"] = Setting(BATCH, "QoS")
    settings.setdefault(BLOCKED, Setting(5_000_000, "bearers"))  # a slow radio is full for longer than a wire
    return replace(plan, settings=settings)


def _scouting(plan: RouterPlan, budgeted: set[str | None]) -> dict[str, Setting]:
    """Anyone who is found by multicast is called directly, past any budget: so not on radios that have one."""
    left = [name for name in plan.scouts_on if name not in budgeted]
    if len(left) == len(plan.scouts_on):
        return {}
    if not left:
        return {"scouting/multicast/enabled": Setting(False, "the radios have budgets")}
    return {"scouting/multicast/interface": Setting(",".join(left), "the radios without a budget")}


def _address(endpoint: str) -> Address | None:
    """Address and port of a Zenoh endpoint; None where it names neither."""
    host, port = host_port(endpoint)
    try:
        return str(ipaddress.ip_address(host)), int(port)
    except ValueError:
        return None
