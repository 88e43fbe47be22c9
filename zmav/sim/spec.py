"""What a simulated vehicle and its world are made of."""

from __future__ import annotations

import msgspec

from zmav.errors import BadConfig
from zmav.sim.geo import Position


class Home(msgspec.Struct, frozen=True):
    """Origin of the world's local frame: degrees (WGS84), metres AMSL, and the heading vehicles start with."""

    lat_deg: float = -35.363261
    lon_deg: float = 149.165230
    alt_amsl_m: float = 584.09
    yaw_deg: float = 0.0

    @property
    def position(self) -> Position:
        return Position(self.lat_deg, self.lon_deg, self.alt_amsl_m)


class VehicleSpec(msgspec.Struct, frozen=True, kw_only=True):
    """One copter. What is None is chosen by the world.

    ``start_ned_m``: where it stands, metres NED of the world (None: in a row going east). ``endpoints``: see
    :mod:`zmav.sim.endpoints`. ``uid``: what AUTOPILOT_VERSION tells it apart by. ``params``: parameters that differ
    from the defaults.
    """

    name: str | None = None
    sysid: int | None = None
    airframe: str = "quad"
    start_ned_m: tuple[float, float, float] | None = None
    yaw_deg: float | None = None
    endpoints: tuple[str, ...] | None = None
    uid: int | None = None
    params: dict[str, float] = {}


def check_sysid(sysid: int) -> int:
    """``sysid`` if it is one; :class:`BadConfig` otherwise."""
    if not 1 <= sysid <= 255:
        raise BadConfig(f"no system id {sysid}; expected 1 to 255", field="sysid", value=sysid, expected="1 to 255")
    return sysid
