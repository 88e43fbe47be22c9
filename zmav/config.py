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
from typing import Annotated

import msgspec

from zmav import keys, wire
from zmav.errors import BadConfig, BadInput


class VehicleConfig(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """One vehicle's table."""

    link: str
    sysid: Annotated[int, msgspec.Meta(ge=1, le=255)] | None = None
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
        for name in (fleet.fleet, *fleet.vehicles):
            keys.check_name(name)
        if fleet.origin:
            _check_origin(fleet.origin)
    except msgspec.ValidationError as e:
        what, _, where = str(e).partition(" - at `$")
        field = where.strip("`").lstrip(".") or "the file"
        raise BadConfig(f"{path}: {what} (at {field})", field=field, expected=what) from None
    except BadInput as e:
        raise BadConfig(f"{path}: {e}", **e.detail) from None
    except ValueError as e:
        raise BadConfig(f"{path} is not TOML: {e}", field="file", value=str(path), expected="TOML") from e
    return fleet


def origin_of(lat_deg: float, lon_deg: float, alt_amsl: float) -> wire.Origin:
    """The fleet's origin at a place that there is; raises :class:`BadConfig` otherwise."""
    return _check_origin(wire.Origin(lat_deg=lat_deg, lon_deg=lon_deg, alt_amsl=alt_amsl))


def _check_origin(origin: wire.Origin) -> wire.Origin:
    for name, most in (("lat_deg", 89.0), ("lon_deg", 180.0), ("alt_amsl", 10_000.0)):
        value = getattr(origin, name)
        if not abs(value) <= most:  # so that NaN is refused, too
            text = f"the origin's {name} is {value}; expected ±{most:.0f} at most"
            raise BadConfig(text, field=f"origin.{name}", value=value, expected=f"±{most:.0f}")
    return origin
