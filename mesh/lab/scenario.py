"""A lab's file (TOML): its hosts, what joins them, and what of the fleet file does not follow from that.

name = "line3"
profile = "mesh"                # the routers'
credentials = true              # made when the lab begins; false: the routers run with insecure = true

[hosts.ground]                  # a ground host: 'zmav router'
[hosts.quad1]
vehicle = "copter"              # simulated: copter, hexa, plane, rover or px4; 'zmav up'
position = [0.0, 100.0]         # m north and east

[hosts.quad2]
vehicle = "rover"
[hosts.box]
program = "none"                # only a namespace

[[media]]
kind = "radio"                  # each pair has its own channel; those that are not named do not hear each other
name = "mesh"
network = "10.77.0.0/24"
hosts = ["ground", "quad1", "quad2"]
pairs = [["ground", "quad1"], ["quad1", "quad2"]]    # absent: all
rate = "6 Mbit/s"
delay = "2 ms"
shared = true                   # one sends at a time

[media.ends."quad1-quad2"]      # and of one pair; "quad1>quad2": of one direction
loss = 0.1

[[media]]
kind = "link"                   # two hosts and nobody else
between = ["ground", "quad2"]
radio = "lte"                   # what the fleet file calls it; also budget, cost and thin

[fleet]                         # goes into the fleet file as it is
origin = { lat_deg = 52.756, lon_deg = -1.246, alt_amsl = 60.0 }
"""

from __future__ import annotations

import ipaddress
import itertools
import re
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from mesh.lab.channel import Conditions
from mesh.lab.kernel import LONGEST_NAME
from mesh.lab.values import Ask, conditions
from zmav import keys
from zmav.config import Profile
from zmav.config.table import Table, reading
from zmav.errors import BadConfig

VehicleKind = Literal["copter", "hexa", "plane", "rover", "px4"]
_Metres = Annotated[float, msgspec.Meta(ge=-1e7, le=1e7)]
Place = tuple[_Metres, _Metres]
SIMULATOR = "simulator"
"""what the program beside the routers is called"""
_INTERFACES = {"wifi": "wlan", "lte": "wwan", "ethernet": "eth", "serial": "sl"}
_INTERFACE = re.compile(rf"[\w.-]{{1,{LONGEST_NAME}}}", re.ASCII)


class HostSpec(Table, kw_only=True, frozen=True):
    """One host: a namespace and what runs in it."""

    vehicle: VehicleKind | None = None
    """a simulated one is behind its router; None: a ground host"""
    program: Literal["router", "none"] = "router"
    position: Place | None = None
    """m north and east of the origin, where a simulated vehicle starts"""
    neighbours: list[str] | None = None
    """as in the fleet file"""
    relay: bool = True
    sim: dict[str, Any] = {}
    """more of its table for ``zmav sim``"""
    arguments: list[str] = []
    """more for its ``zmav up`` or ``zmav router``"""


class Medium(Ask, kw_only=True, frozen=True, forbid_unknown_fields=True):
    """What all media have: a network, the conditions of their channels, and what the fleet file says of the radios."""

    name: str | None = None
    network: str | None = None
    """None: the next free ``10.77.N.0/24``"""
    interface: str | None = None
    """what hosts call theirs; None: after the medium"""
    mtu: Annotated[int, msgspec.Meta(ge=68, le=9000)] = 1500
    shared: bool = False
    """one sends at a time; False: each direction has the rate to itself"""
    ends: dict[str, Ask] = {}
    """conditions of one pair (``a-b``) or direction (``a>b``)"""
    radio: Literal["ethernet", "wifi", "lte", "serial"] = "wifi"
    budget: str | None = None
    cost: int | None = None
    thin: dict[str, float] = {}


class Link(Medium, kw_only=True, frozen=True, forbid_unknown_fields=True, tag_field="kind", tag="link"):
    """Two hosts, and no others: a radio channel of two."""

    between: tuple[str, str]


class RadioChannel(Medium, kw_only=True, frozen=True, forbid_unknown_fields=True, tag_field="kind", tag="radio"):
    """Stations of which not all hear each other."""

    hosts: list[str] | None = None
    """None: all"""
    pairs: list[tuple[str, str]] | None = None
    """who hears whom; None: all"""


AnyMedium = Link | RadioChannel


class Scenario(Table, kw_only=True, frozen=True):
    """The whole file."""

    name: str = "lab"
    profile: Profile = "mesh"
    credentials: bool = False
    hosts: dict[str, HostSpec]
    media: list[AnyMedium] = []
    fleet: dict[str, Any] = {}
    seed: int = 0
    """of all chance in the links"""


def pairs_of(medium: RadioChannel) -> list[tuple[str, str]]:
    """Who may hear whom on a medium of a checked scenario."""
    return medium.pairs if medium.pairs is not None else list(itertools.combinations(medium.hosts or [], 2))


def load_scenario(path: str | Path) -> Scenario:
    """Read a lab's file; raises :class:`BadConfig` that names the file, the field and what was expected."""
    with reading(path, "the lab's file"):
        return check(msgspec.toml.decode(Path(path).read_bytes(), type=Scenario))


def check(scenario: Scenario) -> Scenario:
    """The scenario with names and networks filled in; raises :class:`BadConfig` for what cannot be."""
    keys.check_name(scenario.name)
    if not scenario.hosts:
        raise BadConfig.wrong("hosts", {}, "a table [hosts.NAME] for each host")
    for name in scenario.hosts:
        keys.check_name(name)
        if name == SIMULATOR:
            raise BadConfig.wrong("hosts", name, "another name: the lab's simulator is called so")
    filled: list[RadioChannel] = []
    for number, medium in enumerate(scenario.media):
        name = medium.name or ("-".join(medium.between) if isinstance(medium, Link) else f"medium{number}")
        if isinstance(medium, Link):
            same = {field: getattr(medium, field) for field in Medium.__struct_fields__}
            medium = RadioChannel(**same, hosts=list(medium.between))
        elif medium.hosts is None:
            medium = msgspec.structs.replace(medium, hosts=list(scenario.hosts))
        where = f"media.{name}"
        if medium.name is not None:
            keys.check_name(name, "medium")
        if name == "all":
            raise BadConfig.wrong(f"{where}.name", name, "another name: it stands for all links")
        if name in {each.name for each in filled}:
            raise BadConfig.wrong(f"{where}.name", name, "a name of its own for each medium")
        network = medium.network or _free_network(scenario.media, filled)
        interface = medium.interface or f"{_INTERFACES[medium.radio]}{number}"
        medium = msgspec.structs.replace(medium, name=name, network=network, interface=interface)
        _check_medium(medium, where, scenario.hosts)
        filled.append(medium)
    _check_interfaces(filled)
    return msgspec.structs.replace(scenario, media=filled)


def _free_network(media: list[AnyMedium], filled: list[RadioChannel]) -> str:
    taken = {medium.network for medium in (*media, *filled)}
    names = (f"10.{77 + i // 256}.{i % 256}.0/24" for i in range(len(taken) + 1))
    return next(name for name in names if name not in taken)


def _check_medium(medium: RadioChannel, where: str, hosts: dict[str, HostSpec]) -> None:
    conditions(Conditions(), medium, where)
    for ends, ask in medium.ends.items():
        conditions(Conditions(), ask, f"{where}.ends.{ends}")
    on_it = medium.hosts or []
    for name in on_it:
        if name not in hosts:
            raise BadConfig.wrong(f"{where}", name, f"hosts of this file: {', '.join(hosts)}")
    if len(set(on_it)) != len(on_it):
        raise BadConfig.wrong(where, on_it, "each host once")
    try:
        network = ipaddress.IPv4Network(medium.network or "")
    except ValueError as e:
        raise BadConfig.wrong(
            f"{where}.network", medium.network, f"an IPv4 network such as 10.77.0.0/24 ({e})"
        ) from None
    if network.num_addresses - 2 < len(on_it):
        raise BadConfig.wrong(f"{where}.network", medium.network, f"room for {len(on_it)} hosts")
    if medium.interface in (None, "lo", ".", "..") or not _INTERFACE.fullmatch(medium.interface or ""):
        raise BadConfig.wrong(
            f"{where}.interface", medium.interface, f"an interface's name, up to {LONGEST_NAME} letters"
        )
    if medium.pairs is not None:
        _check_pairs(medium.pairs, on_it, f"{where}.pairs")


def _check_pairs(pairs: list[tuple[str, str]], known: list[str], where: str) -> None:
    seen: set[frozenset[str]] = set()
    for pair in pairs:
        if pair[0] == pair[1] or not set(pair) <= set(known):
            raise BadConfig.wrong(where, list(pair), f"two hosts of {', '.join(known)}")
        if frozenset(pair) in seen:
            raise BadConfig.wrong(where, list(pair), "each pair once")
        seen.add(frozenset(pair))


def _check_interfaces(media: list[RadioChannel]) -> None:
    taken: dict[str, list[tuple[str | None, ipaddress.IPv4Network]]] = {}
    for medium in media:
        network = ipaddress.IPv4Network(medium.network or "")
        for host in medium.hosts or []:
            for interface, other in taken.setdefault(host, []):
                if interface == medium.interface:
                    expected = "another name for each interface of a host"
                    raise BadConfig.wrong(f"media.{medium.name}.interface", interface, expected)
                if network.overlaps(other):
                    expected = f"one apart from {other}, where {host} is, too"
                    raise BadConfig.wrong(f"media.{medium.name}.network", medium.network, expected)
            taken[host].append((medium.interface, network))
