"""The fleet file that a scenario means: ``zmav up``, ``zmav router`` and ``zmav sim`` of the lab all read it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mesh.lab.network import Network
from mesh.lab.scenario import Scenario
from mesh.lab.wiring import Wiring
from zmav.config import FleetConfig, load_fleet
from zmav.config.table import toml_document
from zmav.errors import BadConfig
from zmav.sim.lineup import KINDS
from zmav.sim.spec import VehicleSpec

ORIGIN = {"lat_deg": 52.756, "lon_deg": -1.246, "alt_amsl": 60.0}
"""where labs are that do not say it"""


def write_fleet(network: Network, directory: Path) -> FleetConfig:
    """Write ``directory/fleet.toml`` and read it again; raises :class:`BadConfig` for what in ``[fleet]`` cannot be.

    Vehicles' autopilots are at pseudo-terminals in ``directory``: a path is the same in every network namespace.
    """
    scenario, wiring = network.scenario, network.wiring
    whole: dict[str, Any] = dict(scenario.fleet)
    whole.setdefault("fleet", scenario.name)
    whole.setdefault("origin", ORIGIN)
    mesh = {"profile": scenario.profile, "insecure": not scenario.credentials}
    whole["mesh"] = {**mesh, **_table(whole, "mesh")}
    vehicles, stations = _table(whole, "vehicles"), _table(whole, "stations")
    sysid = 0
    for name, host in scenario.hosts.items():
        ours = {"mesh": _place(scenario, wiring, name)}
        if host.vehicle is None:
            stations[name] = _merged(ours, _table(stations, name, "stations."))
            continue
        sysid += 1
        table = {**ours, "link": str(directory / f"{name}.pty"), "sysid": sysid, "sim": _sim(scenario, name)}
        vehicles[name] = _merged(table, _table(vehicles, name, "vehicles."))
    whole["vehicles"], whole["stations"] = vehicles, stations
    path = directory / "fleet.toml"
    path.write_text(toml_document(whole), encoding="utf-8")
    return load_fleet(path)


def _table(tables: Mapping[str, Any], name: str, above: str = "") -> dict[str, Any]:
    found, field = tables.get(name, {}), f"fleet.{above}{name}"
    if not isinstance(found, Mapping):
        raise BadConfig.wrong(field, found, "a table", f"{field} is {found!r}")
    return dict(found)


def _place(scenario: Scenario, wiring: Wiring, name: str) -> dict[str, Any]:
    """A host's place in the network, as the fleet file has it."""
    host, media = scenario.hosts[name], {medium.name: medium for medium in scenario.media}
    radios = []
    for interface in wiring.interfaces:
        if interface.host != name:
            continue
        medium = media[interface.medium]
        radio: dict[str, Any] = {"interface": interface.name, "address": f"{interface.address}/{interface.prefix}"}
        radio["kind"] = medium.radio
        for field in ("budget", "cost", "thin"):
            if getattr(medium, field):
                radio[field] = getattr(medium, field)
        radios.append(radio)
    place: dict[str, Any] = {"radios": radios}
    if host.neighbours is not None:
        place["neighbours"] = host.neighbours
    if not host.relay:
        place["relay"] = False
    return place


def _sim(scenario: Scenario, name: str) -> dict[str, Any]:
    host = scenario.hosts[name]
    kind, plain = KINDS[host.vehicle or "copter"], VehicleSpec()
    table = {
        field: getattr(kind, field)
        for field in ("autopilot", "airframe")
        if getattr(kind, field) != getattr(plain, field)
    }
    if host.position is not None:
        table["start_ned_m"] = [*host.position, 0.0]
    return {**table, **host.sim}


def _merged(ours: dict[str, Any], theirs: Mapping[str, Any]) -> dict[str, Any]:
    """``theirs`` goes first, table by table."""
    found = dict(ours)
    for key, value in theirs.items():
        mine = found.get(key)
        found[key] = _merged(mine, value) if isinstance(mine, dict) and isinstance(value, Mapping) else value
    return found
