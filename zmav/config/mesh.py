"""The network's part of the fleet file: which radios a host has, whom it hears, and how fast a lost link is noticed.

[mesh]                          # for the whole fleet
profile = "mesh"                # lan, wds, mesh, multi or cloud

[mesh.thin]                     # over any radio with a budget, at most so often, in Hz
ATTITUDE = 4

[vehicles.quad1.mesh]           # and of one host: a vehicle here, a ground host under [stations.ground.mesh]
neighbours = ["quad2", "ground"]

[[vehicles.quad1.mesh.radios]]
interface = "wlan0"
address = "10.77.0.1"

[[vehicles.quad1.mesh.radios]]
interface = "wwan0"
kind = "lte"
address = "10.8.0.11"
budget = "60 kB/s"
"""

from __future__ import annotations

import ipaddress
import math
import re
from collections.abc import Mapping
from typing import Annotated, Literal, Protocol, Union

import msgspec

from zmav import keys
from zmav.config.table import Positive, Table
from zmav.errors import BadConfig, BadInput

Profile = Literal["lan", "wds", "mesh", "multi", "cloud"]
RadioKind = Literal["ethernet", "wifi", "lte", "serial"]
Port = Annotated[int, msgspec.Meta(ge=1, le=65535)]
Address = Union[ipaddress.IPv4Interface, ipaddress.IPv6Interface]  # noqa: UP007
"""an IP address and the network it is in"""
PREFIX = {4: 24, 6: 64}
"""bits of the network, by IP version, where an address is written without them"""
COST: Mapping[RadioKind, int] = {"ethernet": 10, "wifi": 20, "lte": 100, "serial": 500}
"""what a way through such a radio costs, where the fleet file does not say"""


_RATE = re.compile(r"\s*([0-9]*\.?[0-9]+)\s*([kMG]?)(bit/s|bps|b/s|B/s|)\s*\Z")
_FACTOR = {"": 1.0, "k": 1e3, "M": 1e6, "G": 1e9}
LEAST_BUDGET = 5000.0
"""bytes/s below which no router's link opens in time (measured: 1.3 s at 5 kB/s)"""


def bits_per_second(text: str, field: str = "rate") -> float:
    """``1 Mbit/s``, ``60kB/s`` or ``500k`` (bits); raises :class:`BadInput`."""
    found = _RATE.match(text)
    value = float(found[1]) * _FACTOR[found[2]] * (8.0 if found[3] == "B/s" else 1.0) if found else 0.0
    if not (math.isfinite(value) and value > 0.0):
        expected = "1Mbit/s, 60kB/s or the like"
        raise BadInput(f"{field} {text!r}: expected {expected}", field=field, value=text, expected=expected)
    return value


def parse_budget(
    text: str, field: str = "budget", least: float = LEAST_BUDGET, like: str = "'60 kB/s' or '1 Mbit/s'"
) -> float:
    """Bytes a second of ``60 kB/s`` or ``1 Mbit/s``; raises :class:`BadConfig` for anything else."""
    try:
        rate = bits_per_second(text, field) / 8.0 if text.rstrip().endswith("/s") else 0.0
    except BadInput:
        rate = 0.0
    if rate < least:
        expected = f"like {like}, {least:g} B/s at least"
        raise BadConfig.wrong(field, text, expected, f"{field} is {text!r}")
    return rate


class Radio(Table, frozen=True):
    """One way out of a host: a network interface and what may go through it."""

    interface: str | None = None
    """``wlan0``, ``bat0``, ``wwan0``; None: whichever has the address"""
    address: str | None = None
    """the host's own IP address there, ``10.77.0.1`` or with its network's bits, ``10.77.0.1/16``, where these are
    not 24 (64 for IPv6); None: read from the interface when the router starts"""
    kind: RadioKind = "wifi"
    port: Port | None = None
    """where its router listens; None: the fleet's"""
    cost: Annotated[int, msgspec.Meta(ge=1, le=10_000)] | None = None
    """the cheaper way is preferred; None: by kind"""
    budget: str | None = None
    """``60 kB/s`` or ``1 Mbit/s``: what may leave through it, IP headers included"""
    thin: dict[str, Positive] = {}
    """message name -> Hz at most through it"""

    def ip(self) -> Address | None:
        """The address and its network, where one is given; raises :class:`BadConfig` for what is none."""
        if self.address is None:
            return None
        try:
            found = ipaddress.ip_interface(self.address)
        except ValueError as e:
            text = f"{self.address!r} is not an IP address"
            raise BadConfig(text, field="address", value=self.address, expected="like 10.77.0.1 or 10.77.0.1/24") from e
        return found if "/" in self.address else ipaddress.ip_interface(f"{self.address}/{PREFIX[found.version]}")

    def way_cost(self) -> int:
        """What a way through it costs: the cheaper one is preferred."""
        return self.cost if self.cost is not None else COST[self.kind]


class Host(Table, frozen=True):
    """One host's place in the network."""

    profile: Profile | None = None
    """None: the fleet's"""
    radios: list[Radio] = []
    neighbours: list[str] | None = None
    """names of the fleet's other hosts, or Zenoh endpoints; None: by the profile"""
    relay: bool = True
    """False: it carries nobody else's traffic, and no other host takes from it what is not its own. Kept by the rules
    that credentials bring: without them everybody relays"""


class Mesh(Table, frozen=True):
    """What the whole fleet has in common. Timers that are None are the profile's."""

    profile: Profile = "lan"
    insecure: bool = False
    """True: off loopback without credentials, for a laboratory: anyone who hears the radio commands the fleet"""
    port: Port = 7447
    rendezvous: list[str] = []
    """``cloud``: endpoints of the routers that everybody reaches"""
    thin: dict[str, Positive] = {}
    """message name -> Hz at most, through radios that have a budget"""
    lease: Positive | None = None
    """s without a word after which a neighbour is lost"""
    keep_alive: Annotated[int, msgspec.Meta(ge=2, le=20)] | None = None
    """words within a lease"""
    retry: Positive | None = None
    """s between attempts to reach a neighbour, at most"""


class Member(Protocol):
    """What the checks need of a host's table."""

    mesh: Host


def check_hosts(mesh: Mesh, hosts: Mapping[str, Member]) -> None:
    """Raise :class:`BadConfig` where radios cannot be as they are written, or neighbours are not there.

    ``hosts`` are the tables by their place in the file, ``vehicles.quad1``.
    """
    names = {place.partition(".")[2] for place in hosts}
    taken: dict[tuple[str, int], str] = {}
    for place, host in hosts.items():
        for number, radio in enumerate(host.mesh.radios):
            _check_radio(f"{place}.mesh.radios[{number}]", radio, mesh.port, taken)
        for neighbour in host.mesh.neighbours or ():
            _check_neighbour(f"{place}.mesh.neighbours", neighbour, place.partition(".")[2], names)
    for endpoint in mesh.rendezvous:
        if "/" not in endpoint:
            raise BadConfig.wrong("mesh.rendezvous", endpoint, "a Zenoh endpoint like quic/rendezvous.example.org:7447")
    for name in mesh.thin:
        keys.check_message(name)


def _check_radio(place: str, radio: Radio, port: int, taken: dict[tuple[str, int], str]) -> None:
    for name in radio.thin:
        keys.check_message(name)
    if radio.budget is not None:
        parse_budget(radio.budget, f"{place}.budget")
    if radio.interface is None and radio.address is None:
        raise BadConfig.wrong(place, "without interface and address", "one of the two at least")
    try:
        address = radio.ip()
    except BadConfig as e:
        raise BadConfig(f"{place}.{e.message}", **{**e.detail, "field": f"{place}.address"}) from None
    if address is None:
        return
    if address.ip.is_unspecified or address.ip.is_multicast:
        raise BadConfig.wrong(f"{place}.address", radio.address, "one host's own address")
    network = address.network
    if network.prefixlen < network.max_prefixlen - 1 and address.ip == network.network_address:
        raise BadConfig.wrong(f"{place}.address", radio.address, f"an address in {network}, not the network's own")
    here = (str(address.ip), radio.port or port)
    if here in taken:
        raise BadConfig.wrong(f"{place}.address", radio.address, f"another one than {taken[here]}.address")
    taken[here] = place


def _check_neighbour(place: str, neighbour: str, own: str, names: set[str]) -> None:
    if neighbour == own:
        raise BadConfig.wrong(place, neighbour, "another host's name")
    if "/" not in neighbour and neighbour not in names:
        raise BadConfig.wrong(
            place, neighbour, f"a Zenoh endpoint or one of {', '.join(sorted(names - {own})) or 'none'}"
        )
