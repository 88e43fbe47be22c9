"""What a simulated GNSS receiver makes of corrections: the fix that its messages tell. Its noise stays as it is.

Without any it tells what its autopilot's own simulation tells. With them it has ambiguities as floats first and fixes
them then, as receivers do, and loses both step by step where they stop.
"""

from __future__ import annotations

import collections
from typing import Any, Protocol

from zmav.formats.rtcm3 import Cutter, Ecef, Message
from zmav.geo import to_ecef
from zmav.mavlink.rtcm import Joiner
from zmav.sim.autopilots.ardupilot.vehicle import ArduVehicle
from zmav.sim.autopilots.px4.copter import Px4Copter
from zmav.sim.environment import Vector
from zmav.sim.fleets.base import Seat
from zmav.sim.protocol.channel import Channel, Sender
from zmav.sim.sensors.troubles import FINE, Trouble

PLAIN, FLOAT, FIXED = 3, 5, 6
"""GPS_FIX_TYPE"""
FIXES_S, OLD_S, LOST_S = 5.0, 10.0, 30.0
"""s of corrections until it has fixed; s without any after which it has floats, and then neither"""
FAR_M = 100_000.0
"""m to a base beyond which its corrections are of no use"""
KEPT = 256
CAUSE = "corrections"


class Carrier(Protocol):
    """The vehicle that something is fitted to, as that sees it: a :class:`~zmav.sim.protocol.base.Node`."""

    brain: ArduVehicle | Px4Copter
    seat: Seat

    @property
    def sysid(self) -> int: ...


class CorrectedReceiver:
    """One vehicle's. ``deaf``, ``foreign`` and ``jump`` (m NED) are faults."""

    def __init__(self, node: Carrier) -> None:
        self._node = node
        self.deaf = self.foreign = False
        self.jump: Vector = (0.0, 0.0, 0.0)
        self.messages: collections.deque[Message] = collections.deque(maxlen=KEPT)
        """the newest, as they came"""
        self._shifted: Vector = (0.0, 0.0, 0.0)
        self.restart()

    def restart(self) -> None:
        self._joiner, self._cutter = Joiner(), Cutter()
        self._since: float | None = None
        self._heard = 0.0
        self._station: int | None = None
        self._base: Ecef | None = None
        self.messages.clear()

    def take(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        """A GPS_RTCM_DATA."""
        if self.deaf:
            return
        now = self._node.brain.now
        for message in self._cutter.feed(self._joiner.add(msg["flags"], msg["len"], bytes(msg["data"]))):
            self.messages.append(message)
            self._base = message.place or self._base
            if not message.observes:
                continue
            if self._since is None or message.station != self._station or now - self._heard > LOST_S:
                self._since = now  # another base's ambiguities are others
            self._station, self._heard = message.station, now

    def fix_type(self, plain: int) -> int:
        """GPS_FIX_TYPE, where it is ``plain`` without corrections."""
        found = plain if self._since is None or plain < PLAIN else self._corrected(self._since)
        shift = self.jump if self._since is not None and found >= FLOAT else (0.0, 0.0, 0.0)
        if shift != self._shifted:
            self._shifted = shift
            self._node.seat.trouble(CAUSE, Trouble(gps_shift=shift) if any(shift) else FINE)
        return found

    def _corrected(self, since: float) -> int:
        now = self._node.brain.now
        if self.foreign or now - self._heard > LOST_S or self._is_far():
            return PLAIN
        return FLOAT if now - self._heard > OLD_S or now - since < FIXES_S else FIXED

    def _is_far(self) -> bool:
        if self._base is None:
            return False
        fix = self._node.seat.fix()
        here = self._node.brain.place((fix.north, fix.east, fix.down))
        return self._base.distance(Ecef(*to_ecef(here.lat_deg, here.lon_deg, here.alt_amsl_m))) > FAR_M
