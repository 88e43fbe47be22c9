"""The fleet file: TOML, typed and strict, one for the whole fleet.

fleet = "alpha"

[origin]
lat_deg = 52.756
lon_deg = -1.246
alt_amsl = 60.0

[vehicles.quad1]
link = "/dev/ttyAMA0,921600"
listen = ["tcp/127.0.0.1:7447", "udp/10.77.0.1:7447?rel=1;mixed_rel=1"]
connect = ["udp/10.77.0.2:7447?rel=1;mixed_rel=1"]
"""

from __future__ import annotations

from pathlib import Path

import msgspec

from zmav import keys, wire
from zmav.errors import BadConfig


class VehicleConfig(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """One vehicle's table."""

    link: str
    sysid: int | None = None
    dialect: str = "ardupilotmega"
    listen: list[str] = []
    connect: list[str] = []


class FleetConfig(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """The whole file."""

    fleet: str = "demo"
    origin: wire.Origin | None = None
    vehicles: dict[str, VehicleConfig] = {}

    def vehicle(self, name: str) -> VehicleConfig:
        """The table of that vehicle; raises :class:`BadConfig` naming those there are."""
        if name not in self.vehicles:
            known = ", ".join(self.vehicles) or "none"
            raise BadConfig(
                f"no vehicle {name!r} in the fleet file; it has {known}", field="name", value=name, expected=known
            )
        return self.vehicles[name]


def load_fleet(path: str | Path) -> FleetConfig:
    """Read a fleet file; raises :class:`BadConfig` that names the file, the field and what was expected."""
    try:
        data = Path(path).read_bytes()
    except OSError as e:
        raise BadConfig(f"cannot read the fleet file {path}: {e.strerror}", field="file", value=str(path)) from e
    try:
        fleet = msgspec.toml.decode(data, type=FleetConfig)
    except (msgspec.DecodeError, ValueError) as e:
        raise BadConfig(f"{path}: {e}", field="file", value=str(path)) from e
    for name in (fleet.fleet, *fleet.vehicles):
        keys.check_name(name, "name in the fleet file")
    return fleet
