"""What a host's router is opened with, worked out from the fleet file; each value with where it came from."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec
import zenoh

from mesh.credentials.acl import access_control
from mesh.credentials.exposure import check_opened
from mesh.endpoint import between, bound, bracketed, host_port, place
from mesh.neighbours import Neighbour, neighbours
from mesh.profiles import PROFILES, Rules, timers
from mesh.radios import FoundRadio, Interfaces, interfaces, stand
from mesh.shaping import downsampling, thinned
from zmav import keys
from zmav.config import FleetConfig, Host, Profile, StationConfig, VehicleConfig
from zmav.errors import BadConfig
from zmav.rundir import socket_to_listen
from zmav.session import DEFAULT_ROUTER, SessionSettings, config, defaults, sources
from zmav.trust.certificate import Role
from zmav.trust.credentials import Credentials

LISTEN, CONNECT, SCOUTING = "listen/endpoints", "connect/endpoints", "scouting/multicast/"
ABOVE = 2
"""from a radio's port to its second one; between them is the port of its bearer"""


@dataclass(frozen=True)
class Setting:
    """One value of Zenoh's configuration."""

    value: Any
    source: str
    """in words: ``profile mesh``, ``fleet file: mesh.lease``, ``-l``, ``zmav``"""


@dataclass(frozen=True)
class RouterPlan:
    """One host's router."""

    fleet: str
    name: str
    profile: Profile
    host: Host
    """its radios with the addresses and interfaces that were found"""
    settings: dict[str, Setting]
    """by Zenoh configuration path"""
    file: FleetConfig = field(default_factory=FleetConfig)
    """the whole fleet file: the rules at our door are about the other hosts, too"""
    neighbours: tuple[Neighbour, ...] = ()
    credentials: Credentials | None = None
    vehicle: bool = False
    """it is a vehicle's, and not a ground host's"""
    radios: tuple[FoundRadio, ...] = ()
    """the host's radios and whether they are there"""

    def session(self, base: SessionSettings) -> SessionSettings:
        """``base`` as a router's settings, with what was worked out here."""
        values = {path: setting.value for path, setting in self.settings.items()}
        return msgspec.structs.replace(base, mode="router", values={**values, **base.values})

    def value(self, path: str) -> Any:
        """The value at a Zenoh configuration path; None where nothing was worked out for it."""
        return self.settings[path].value if path in self.settings else None

    @property
    def listens(self) -> list[str]:
        """The endpoints that it listens on."""
        return self.endpoints(LISTEN)

    def endpoints(self, path: str) -> list[str]:
        """Those of ``listen/endpoints`` or ``connect/endpoints``; Zenoh also takes them by the mode of who opens."""
        value = self.value(path)
        return list(value.get("router") or ()) if isinstance(value, Mapping) else list(value or ())

    @property
    def scouts_on(self) -> tuple[str, ...]:
        """The interfaces on which neighbours are looked for by multicast."""
        names = self.value(f"{SCOUTING}interface") if self.value(f"{SCOUTING}enabled") else None
        return tuple(str(names).split(",")) if names else ()


def plan_router(
    file: FleetConfig | None,
    name: str,
    base: SessionSettings,
    *,
    fleet: str | None = None,
    insecure: bool = False,
    vehicle: bool = False,
    there: Interfaces | None = None,
) -> RouterPlan:
    """The router of the host ``name``.

    Without a ``file`` it keeps to loopback unless ``base``, what a person gave on the command line, says otherwise;
    ``base`` goes before everything. ``there`` are the host's network interfaces; None: this computer's.
    Raises :class:`BadConfig` for a host that the file has not, for what cannot be, and for what would let strangers in.
    """
    keys.check_name(name)
    if fleet is not None:
        keys.check_name(fleet, "fleet")
    whole = file or FleetConfig()
    table = file.host(name) if file else StationConfig()
    found = interfaces() if there is None and table.mesh.radios else there or {}
    radios = tuple(stand(radio, found) for radio in table.mesh.radios)
    credentials = Credentials.load(base.credentials) if base.credentials else None
    profile = whole.profile_of(table.mesh)
    plan = RouterPlan(
        fleet=fleet or (credentials.fleet if credentials and not file else whole.fleet),
        name=name,
        profile=profile,
        host=msgspec.structs.replace(table.mesh, radios=[each.radio for each in radios]),
        settings={path: Setting(value, "zmav") for path, value in defaults("router").items()},
        file=whole,
        neighbours=neighbours(whole, name, table.mesh, radios, PROFILES[profile]),
        credentials=credentials,
        vehicle=vehicle or name in whole.vehicles,
        radios=radios,
    )
    if credentials:
        _check_member(plan, credentials)
    for settings in (_timers(plan), _links(plan, table), _scouting(plan), _thinning(plan), _trust(plan)):
        plan.settings.update(settings)
    opened, ours = config(plan.session(base)), config(plan.session(SessionSettings(credentials=base.credentials)))
    check_opened(opened, ours, credentials, insecure or whole.mesh.insecure)
    plan.settings.update(_given(plan, base, opened))
    return plan


def _check_member(plan: RouterPlan, credentials: Credentials) -> None:
    """Others take a router's name from its certificate: the two must not differ."""
    for what, ours, theirs in (("name", plan.name, credentials.name), ("fleet", plan.fleet, credentials.fleet)):
        if ours != theirs:
            text = f"{credentials.folder} are the credentials of the {what} {theirs!r}, and this router's is {ours!r}"
            raise BadConfig(text, field="credentials", value=theirs, expected=ours)
    if plan.vehicle and credentials.role is not Role.VEHICLE:
        text = f"{plan.name} is a vehicle, and its certificate is for the role {credentials.role.value!r}"
        raise BadConfig(text, field="credentials", value=credentials.role.value, expected=Role.VEHICLE.value)


def _timers(plan: RouterPlan) -> dict[str, Setting]:
    """Leases, words within them, how often a neighbour is called and how long opening a link may take."""
    mesh, rules, profile = plan.file.mesh, PROFILES[plan.profile], f"profile {plan.profile}"
    budget = any(radio.budget for host in plan.file.hosts().values() for radio in host.mesh.radios)
    usual, words = timers(plan.profile, budget)

    def setting(name: str, value: Any, ours: Any) -> Setting:
        return Setting(value, profile if ours is None else f"fleet file: mesh.{name}")

    lease = round((mesh.lease or usual) * 1000)
    retry = round((mesh.retry or rules.retry) * 1000)
    backoff = {"period_init_ms": min(200, retry), "period_max_ms": retry, "period_increase_factor": 1.5}
    opening = Setting(round(rules.opening * 1000), profile)
    return {
        "transport/link/tx/lease": setting("lease", lease, mesh.lease),
        "transport/link/tx/keep_alive": setting("keep_alive", mesh.keep_alive or words, mesh.keep_alive),
        "transport/unicast/open_timeout": opening,
        "transport/unicast/accept_timeout": opening,
        "connect/retry": setting("retry", backoff, mesh.retry),
    }


def _links(plan: RouterPlan, table: VehicleConfig | StationConfig) -> dict[str, Setting]:
    """Where the router listens and whom it calls."""
    where = f"{'vehicles' if plan.name in plan.file.vehicles else 'stations'}.{plan.name}"
    profile, rules = f"profile {plan.profile}", PROFILES[plan.profile]
    listen, why = (
        (list(table.listen), [f"fleet file: {where}.listen"]) if table.listen else ([DEFAULT_ROUTER], ["zmav"])
    )
    called, guarded = _is_called(plan, rules), plan.credentials is not None
    second = rules.second_port and plan.host.neighbours is None
    others = {place(each) for each in listen} | _listeners(plan.file)
    for radio in called:
        port = radio.radio.port or plan.file.mesh.port
        free = port + ABOVE < 65536 and f"{bracketed(str(radio.radio.address))}:{port + ABOVE}" not in others
        ports = [port, port + ABOVE] if second and not radio.radio.budget and free else [port]
        listen += [between(str(radio.radio.address), each, guarded) for each in ports]
        why.append(f"{radio.name}{'' if radio.present else ' (waited for)'}")
    if guarded and (socket := _socket(listen)) is not None:
        listen.append(socket)
        why.append("for programs of this computer")
    found = {LISTEN: Setting(list(dict.fromkeys(listen)), ", ".join(dict.fromkeys(why)))}
    if any(not radio.present for radio in called):
        found.update(_patience(plan))
    connect, why = list(table.connect), [f"fleet file: {where}.connect"] if table.connect else []
    direct = [each for each in plan.host.neighbours or () if "/" in each]
    for neighbour in plan.neighbours:
        # One way only: Zenoh would call the others without end, 27 kB/s each, and be refused. Bearers carry several.
        best = [
            bound(between(way.address, way.port, guarded), str(way.radio.address)) for way in neighbour.ways[:1]
        ] or list(neighbour.endpoints)
        connect += best if neighbour.calls else []
    connect += direct
    if plan.neighbours or direct:
        why.append(profile if plan.host.neighbours is None else f"fleet file: {where}.mesh.neighbours")
    if plan.profile in ("cloud", "multi") and plan.file.mesh.rendezvous:
        own = [place(each) for each in listen]
        connect += [each for each in plan.file.mesh.rendezvous if place(each) not in own]
        why.append("fleet file: mesh.rendezvous")
    if connect:
        found[CONNECT] = Setting(list(dict.fromkeys(connect)), ", ".join(why))
    return found


def _listeners(file: FleetConfig) -> set[str]:
    """The first ports of all radios of the fleet, and those of their bearers: several hosts may be on one computer."""
    radios = [radio for host in file.hosts().values() for radio in host.mesh.radios]
    found = {(radio.ip(), (radio.port or file.mesh.port) + above) for radio in radios for above in (0, 1)}
    return {f"{bracketed(str(address.ip))}:{port}" for address, port in found if address is not None}


def _socket(listen: list[str]) -> str | None:
    """The unix socket beside the port of loopback that this host's programs know."""
    for endpoint in listen:
        address, port = host_port(endpoint)
        if endpoint.startswith("tcp/") and address in ("127.0.0.1", "::1", "localhost") and int(port or 0):
            return socket_to_listen(int(port))
    return None


def _is_called(plan: RouterPlan, rules: Rules) -> list[FoundRadio]:
    """The radios on which the router listens: in the cloud, those whose address is a rendezvous."""
    known = [radio for radio in plan.radios if radio.address is not None]
    return known if rules.listens else [radio for radio in known if is_rendezvous(plan, str(radio.radio.address))]


def is_rendezvous(plan: RouterPlan, address: str) -> bool:
    """Whether the fleet file has everybody meet at that address."""
    return any(place(each).rpartition(":")[0] == bracketed(address) for each in plan.file.mesh.rendezvous)


def _patience(plan: RouterPlan) -> dict[str, Setting]:
    """A radio that is not there yet (a modem, Wi-Fi after boot) is waited for.

    Zenoh 1.10 tries a listener again only where all of them may be tried again.
    """
    waited = ", ".join(radio.name for radio in plan.radios if not radio.present)
    again = {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 1.5}
    values = {"timeout_ms": -1, "exit_on_failure": False, "retry": again}
    return {f"listen/{name}": Setting(value, f"{waited} is waited for") for name, value in values.items()}


def _scouting(plan: RouterPlan) -> dict[str, Setting]:
    """Multicast, on the radios only: of two routers that hear each other, the one with the greater id calls."""
    rules, profile = PROFILES[plan.profile], f"profile {plan.profile}"
    if rules.scouting and rules.calls_all and not _is_unknown(plan):
        return {f"{SCOUTING}enabled": Setting(False, "the file has everybody's address")}
    names = [radio.radio.interface for radio in plan.radios if radio.present and radio.radio.interface]
    if not rules.scouting or plan.host.neighbours is not None or not names:
        why = "zmav" if not plan.radios else "no radio is there yet" if not names else "the host names its neighbours"
        return {f"{SCOUTING}enabled": Setting(False, why if rules.scouting else profile)}
    return {
        f"{SCOUTING}enabled": Setting(True, profile),
        f"{SCOUTING}interface": Setting(",".join(dict.fromkeys(names)), "the host's radios"),
        f"{SCOUTING}autoconnect": Setting({"router": ["router"], "peer": [], "client": []}, profile),
        f"{SCOUTING}autoconnect_strategy": Setting("greater-zid", profile),
        f"{SCOUTING}listen": Setting({"router": True, "peer": False, "client": False}, profile),
        f"{SCOUTING}ttl": Setting(1, profile),
    }


def _thinning(plan: RouterPlan) -> dict[str, Setting]:
    """How often what is read behind radios with a budget may leave through them."""
    thin = thinned(plan.file, plan.host.radios)
    if not thin:
        return {}
    sources = "; ".join(dict.fromkeys(each.source for each in thin))
    return {"downsampling": Setting(downsampling(plan.file, plan.fleet, plan.name, thin), sources)}


def _is_unknown(plan: RouterPlan) -> bool:
    """Whether there is a host whose address the fleet file has not."""
    hosts = (host for place, host in plan.file.hosts().items() if place.partition(".")[2] != plan.name)
    return any(radio.address is None for host in hosts for radio in host.mesh.radios)


def _trust(plan: RouterPlan) -> dict[str, Setting]:
    """What the certificates bring, and what a router says of itself in its admin space."""
    about = {"fleet": plan.fleet, "name": plan.name}
    found = {"metadata": Setting(about, "the host's name")}
    if plan.credentials:
        source = f"credentials {plan.credentials.folder}"
        found.update({path: Setting(value, source) for path, value in plan.credentials.zenoh().items()})
        rules = access_control(plan.file, plan.fleet, plan.name, plan.credentials.roster)
        found["access_control"] = Setting(rules, f"roster {plan.credentials.roster.number}, the channel registry")
    return found


def _given(plan: RouterPlan, base: SessionSettings, opened: zenoh.Config) -> dict[str, Setting]:
    """What a person gave, as Zenoh took it; of a whole table (``--cfg listen:{...}``) what stands in it, too."""
    given = {path.strip("/"): source for path, source in sources(plan.session(base)).items() if path != "mode"}
    inside = {path: how for path in plan.settings for place, how in given.items() if path.startswith(f"{place}/")}
    return {path: Setting(json.loads(opened.get_json(path)), how) for path, how in {**inside, **given}.items()}
