"""One vehicle's geofence and limits, held against what it is asked to fly from where it is now."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from zmav import wire
from zmav.autopilots import Target
from zmav.config import Geofence, Limits
from zmav.mavlink import decode
from zmav.services import limits as limit
from zmav.services.identity import Identity
from zmav.services.port import Port
from zmav.services.trajectory import Segment

FRESH = 2.0
"""s: age up to which a position says where the vehicle is"""


class Bounds:
    """Raises :class:`~zmav.errors.BadInput` whose ``detail["count"]`` names the bound. On the event loop.

    Made of a fence that encloses nothing, :class:`~zmav.errors.BadConfig`.
    """

    def __init__(
        self, port: Port, identity: Identity, origin: wire.Origin | None, fence: Geofence | None, limits: Limits | None
    ) -> None:
        self._port, self._identity = port, identity
        made = limit.Fence(fence, origin) if fence else None
        self._fence = made if made and (made.limits_ground or made.limits_height) else None
        self._limits = limits if limits and any(value is not None for value in _values(limits)) else None

    def check(self, what: Target | Segment) -> None:
        """A target from here, or a whole segment."""
        if self._fence is None and self._limits is None:
            return
        position = self._position() if self._fence else None
        flat = bool(self._identity.autopilot and self._identity.autopilot.on_surface)
        home = (position["alt"] - position["relative_alt"]) / 1e3 if position else None
        if isinstance(what, Segment):
            what.check(self._fence, self._limits, home, flat=flat)
        else:
            limit.check(what, self._fence, self._limits, home, _here(position), flat=flat)

    def _position(self) -> Mapping[str, Any] | None:
        source = self._identity.source
        heard = self._port.latest("GLOBAL_POSITION_INT", source) if source else None
        return decode(heard.frame, self._port.dialect) if heard and heard.age < FRESH else None


def _values(limits: Limits) -> list[float | None]:
    return [getattr(limits, name) for name in limits.__struct_fields__]


def _here(position: Mapping[str, Any] | None) -> limit.Here | None:
    if position is None:
        return None
    velocity = (position["vx"] / 100.0, position["vy"] / 100.0, position["vz"] / 100.0)
    return limit.Here(position["lat"] / 1e7, position["lon"] / 1e7, position["relative_alt"] / 1e3, velocity)
