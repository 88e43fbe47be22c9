"""Frames: north-east-down as zmav has it, body as the models have it, and the view, whose z is up.

Every position in the recording is NED about the fleet's origin, below the entity ``world/ned``. That entity carries the
only change of frame: x, y, z of the view are east, north, up. Bodies are forward-right-down (FRD), turned into NED.
"""

from __future__ import annotations

import math

from zmav import geo, wire
from zmav.wire import Vector

NED_IN_VIEW = ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0))
"""rows: east, north and up of a NED vector; a proper rotation"""
FAR = 100_000.0
"""m from the origin beyond which a place is a mistake"""


def usable(vector: Vector | None) -> bool:
    """It can be drawn: finite, and within :data:`FAR`."""
    return vector is not None and all(math.isfinite(x) and abs(x) <= FAR for x in vector)


def origin_behind(position: wire.GlobalPosition, local: Vector) -> wire.Origin:
    """The origin about which ``local`` is the place of ``position``: what a vehicle with a declared one betrays."""
    found = wire.Origin(lat_deg=position.lat_deg, lon_deg=position.lon_deg, alt_amsl=position.alt_amsl)
    for _ in range(3):  # the map's scale is that of the origin's latitude, which is sought
        north, east, _ = geo.to_ned(found, position.lat_deg, position.lon_deg, position.alt_amsl)
        back = (north - local[0], east - local[1], 0.0)
        lat, lon, _ = geo.to_global(found, back)
        found = wire.Origin(lat_deg=lat, lon_deg=lon, alt_amsl=position.alt_amsl + local[2])
    return found


class Datum:
    """The origin that everything is drawn about: declared, told by a vehicle's two positions, or for the time being."""

    def __init__(self) -> None:
        self.origin: wire.Origin | None = None
        self.rank = "none"
        """or provisional, inferred, declared"""

    def declare(self, origin: wire.Origin) -> bool:
        """True where it changes what is drawn."""
        if not _sound(origin) or (self.rank == "declared" and origin == self.origin):
            return False
        return self._take(origin, "declared")

    def learn(self, state: wire.VehicleState) -> bool:
        """Take what a state tells of the origin where nothing better is known; True where it changes what is drawn."""
        position = state.position
        if position is None or not _sound(position):
            return False
        if usable(state.local) and self.rank in ("none", "provisional"):
            assert state.local is not None
            return self._take(origin_behind(position, state.local), "inferred")
        if self.rank == "none":
            ground = position.alt_amsl - position.alt_rel
            origin = wire.Origin(lat_deg=position.lat_deg, lon_deg=position.lon_deg, alt_amsl=ground)
            return _sound(origin) and self._take(origin, "provisional")
        return False

    def _take(self, origin: wire.Origin, rank: str) -> bool:
        self.origin, self.rank = origin, rank
        return True

    def ned(self, state: wire.VehicleState) -> Vector | None:
        """Where the vehicle is; None where that is not known, or cannot be drawn."""
        if state.local is not None and self.rank != "provisional":
            return state.local if usable(state.local) else None
        position = state.position
        return None if position is None else self.place(position.lat_deg, position.lon_deg, position.alt_amsl)

    def place(self, lat_deg: float, lon_deg: float, alt_amsl: float) -> Vector | None:
        """A WGS84 place in NED; None without an origin, or too far from it."""
        if self.origin is None or not all(map(math.isfinite, (lat_deg, lon_deg, alt_amsl))):
            return None
        found = geo.to_ned(self.origin, lat_deg, lon_deg, alt_amsl)
        return found if usable(found) else None


def _sound(place: wire.Origin | wire.GlobalPosition) -> bool:
    inside = abs(place.lat_deg) <= 89.0 and abs(place.lon_deg) <= 180.0 and abs(place.alt_amsl) <= FAR
    return inside and math.isfinite(place.alt_amsl)
