"""What ``zmav doctor --file`` says of the fleet file, and of what it names on this host."""

from __future__ import annotations

from collections.abc import Iterator

from zmav.config import FleetConfig, VehicleConfig, load_fleet
from zmav.doctor import topics
from zmav.doctor.findings import Finding
from zmav.errors import ZmavError
from zmav.links.url import parse_url
from zmav.mavlink import load_dialect
from zmav.mavlink.signing import read_key
from zmav.session import DEFAULT_ROUTER
from zmav.trust.certificate import Role
from zmav.trust.credentials import Credentials

MEND = "mend that field: 'zmav mesh config --file FILE' reads it in the same way"


def check_file(path: str, name: str | None, own: Credentials | None = None) -> tuple[list[Finding], FleetConfig | None]:
    """Findings about the file and the host's table, and the file itself where it can be read."""
    try:
        file = load_fleet(path)
        table = file.host(name) if name is not None else None
    except ZmavError as e:
        return [topics.FILE.wrong(e.message, MEND)], None
    found = list(_table(name, table)) if name and isinstance(table, VehicleConfig) else []
    if own is not None and own.fleet != file.fleet:
        text = f"{path} is the fleet {file.fleet}'s, and the credentials are for {own.fleet}"
        found.append(topics.FILE.wrong(text, "write the same fleet in both, or give the other --credentials"))
    if own is not None and own.role is Role.VEHICLE and name not in (None, own.name):
        text = f"the credentials are {own.name}'s, and this host is {name}"
        found.append(topics.FILE.wrong(text, "give the vehicle's own --credentials: zmav mesh ca"))
    if all(finding.ok for finding in found):
        counts = f"vehicles: {len(file.vehicles)}, stations: {len(file.stations)}"
        found.append(topics.FILE.well(f"{path}: fleet {file.fleet}, {counts}" + (f"; here: {name}" if name else "")))
    return found, file


def _table(name: str, table: VehicleConfig) -> Iterator[Finding]:
    for field, read in (
        ("link", lambda: parse_url(table.link)),
        ("dialect", lambda: load_dialect(table.dialect)),
        ("signing.key_file", lambda: read_key(table.signing.key_file) if table.signing else None),
    ):
        try:
            read()
        except ZmavError as e:
            yield topics.FILE.wrong(f"vehicles.{name}.{field}: {e.message}", MEND)


def own_router(file: FleetConfig, name: str) -> str:
    """The endpoint by which this host's programs reach its router."""
    plain = [each for each in file.host(name).listen if each.startswith("tcp/")]
    for endpoint in plain:
        address, _, port = endpoint.removeprefix("tcp/").rpartition(":")
        if address in ("127.0.0.1", "localhost", "[::1]"):
            return endpoint
        if address in ("0.0.0.0", "[::]"):
            return f"tcp/127.0.0.1:{port}"
    return plain[0] if plain else DEFAULT_ROUTER
