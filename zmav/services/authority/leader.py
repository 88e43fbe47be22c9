"""A position target that is never far ahead of the vehicle, so that nothing flies on when the companion dies.

ArduPilot flies to a position target however long nothing more is heard; velocities it drops by itself. A far target is
therefore given as a near one: the point on the way there as far ahead as the vehicle needs to keep its speed. It
moves on with the vehicle as long as somebody renews it, and is where the vehicle stops when nobody does.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping
from typing import Any

import msgspec

from zmav import geo, wire
from zmav.autopilots import Autopilot, Message, Target
from zmav.autopilots.safety import flies_on
from zmav.errors import ZmavError
from zmav.services.authority.bounds import Bounds
from zmav.services.authority.control import Control, Mover
from zmav.services.companion import Companion
from zmav.services.link.reported import FRESH, fields_of

AHEAD_M = 15.0
AHEAD_S = 3.0
"""how far ahead: metres, and seconds at the present speed; measured: a copter keeps its 10 m/s, and stops in 45 m"""
RENEW_HZ = 4.0
CATCH_UP, SLOW, THERE_M = 0.7, 0.1, 0.3
"""1/s of what is missing that is added to the velocity; m/s below which a place stands; m within which it is reached"""


def within_reach(target: Target, position: Mapping[str, Any]) -> Target:
    """``target``, or the point on the way to it from a GLOBAL_POSITION_INT; height and course each on their own."""
    if target.lat_deg is None or target.lon_deg is None:
        return target
    here = wire.Origin(lat_deg=position["lat"] / 1e7, lon_deg=position["lon"] / 1e7, alt_amsl=0.0)
    north, east, _ = geo.to_ned(here, target.lat_deg, target.lon_deg, 0.0)
    away, ahead = math.hypot(north, east), AHEAD_M + AHEAD_S * math.hypot(position["vx"], position["vy"]) / 100.0
    changes: dict[str, float] = {}
    if away > ahead:
        lat, lon, _ = geo.to_global(here, (north * ahead / away, east * ahead / away, 0.0))
        changes = {"lat_deg": lat, "lon_deg": lon}
    above = AHEAD_M + AHEAD_S * abs(position["vz"]) / 100.0
    for name, field in (("alt_amsl", "alt"), ("alt_rel", "relative_alt")):
        wanted, now = getattr(target, name), position[field] / 1e3
        if wanted is not None and abs(wanted - now) > above:
            changes[name] = now + math.copysign(above, wanted - now)
    return msgspec.structs.replace(target, **changes) if changes else target


def pursuit(target: Target, position: Mapping[str, Any], most: float) -> Target:
    """The velocity over the ground that brings a vehicle which does not follow a moving place back to it: the target's
    own, and a share of what is missing, ``most`` m/s altogether. It never turns round for a place that it has passed,
    but waits for it.
    """
    if target.lat_deg is None or target.lon_deg is None or target.vel is None:
        return target
    here = wire.Origin(lat_deg=position["lat"] / 1e7, lon_deg=position["lon"] / 1e7, alt_amsl=0.0)
    north, east, _ = geo.to_ned(here, target.lat_deg, target.lon_deg, 0.0)
    vn, ve, _ = target.vel
    speed = math.hypot(vn, ve)
    n, e = vn + CATCH_UP * north, ve + CATCH_UP * east
    passed = n * vn + e * ve < 0.0 if speed > SLOW else math.hypot(north, east) < THERE_M
    share = min(1.0, most / math.hypot(n, e)) if n or e else 0.0
    return Target(vel=(0.0, 0.0, 0.0) if passed else (share * n, share * e, 0.0))


class PositionLeader:
    """Leads the vehicle to one far target, until :meth:`stop`. :meth:`near` from any thread, the rest on the loop.

    ``control`` is asked before each target; ``bounds`` say how fast it may go.
    """

    def __init__(self, companion: Companion, control: Control, bounds: Bounds) -> None:
        self._port, self._identity, self._events = companion.port, companion.identity, companion.events
        self._control, self._bounds = control, bounds
        self._task: asyncio.Task[None] | None = None

    def near(
        self, autopilot: Autopilot, target: Target, source: tuple[int, int], on_segment: bool = False
    ) -> Target | None:
        """What to give the autopilot now for ``target``: a near point, or for a moving one on the ground a velocity.
        None: nothing, for it does not say any more where it is; it stops where it was led last, which is told. A point
        of a segment (``on_segment``) is near by itself, and moves on.
        """
        if target.lat_deg is None or not flies_on(autopilot):
            return target
        position = fields_of(self._port, "GLOBAL_POSITION_INT", source, FRESH)
        if position is None:
            if on_segment or self._port.latest("GLOBAL_POSITION_INT", source) is None:
                return target
            text = "it does not say any more where it is: it is led no farther, and stops"
            self._events.emit("setpoint", "warning", text, why="position", limit="sp position")
            return None
        if autopilot.on_surface and target.vel is not None:
            return pursuit(target, position, self._bounds.most_speed)
        return within_reach(target, position)

    def lead(self, target: Target) -> bool:
        """Send a near target now, and keep moving it; False where the autopilot needs none, and nothing was done.

        Raises :class:`~zmav.errors.Refused` where nobody may move the vehicle now.
        """
        self._control.check_pilot()
        self.stop()
        autopilot = self._identity.autopilot
        if target.lat_deg is None or autopilot is None or not flies_on(autopilot):
            return False
        self._task = asyncio.get_running_loop().create_task(self._lead(autopilot, target))
        self._task.add_done_callback(self._on_done)
        self._control.take(self, Mover.TARGET)
        return True

    @property
    def leading(self) -> bool:
        return self._control.claimed(Mover.TARGET)

    def stop(self) -> None:
        """Something else moves the vehicle now."""
        if self._task is not None:
            self._task.cancel()
            self._task = None
            self._control.leave(self)

    def _on_done(self, task: asyncio.Task[None]) -> None:
        if task is self._task:
            self._control.leave(self)

    def close(self) -> None:
        """End for good: the vehicle is told to stop, and not only to go as far as its near target."""
        autopilot, source, leading = self._identity.autopilot, self._identity.source, self.leading
        self.stop()
        if leading and autopilot is not None and source is not None and self._identity.mode == autopilot.guided:
            mode, message = autopilot.hold()
            if message is not None and mode == autopilot.guided:
                for _ in range(3):  # it has no acknowledgement
                    self._port.send(message.name, **message.addressed(*source))

    async def _lead(self, autopilot: Autopilot, target: Target) -> None:
        mode, arrived = self._identity.mode, 0
        while arrived < 3:  # the end of the way is said again in case it was lost: it has no acknowledgement
            source = self._identity.source
            if source is None or self._identity.mode != mode or not self._identity.armed:
                return
            try:
                self._control.check_pilot()
            except ZmavError:  # the one who has it is told of it elsewhere
                return
            if self._control.claimed(Mover.SEGMENT, Mover.STREAM):
                return  # an agent flies it now
            now = self.near(autopilot, target, source)
            arrived += now is target
            action = autopilot.goto(now) if now is not None else None
            if isinstance(action, Message):
                self._port.send(action.name, **action.addressed(*source))
            await asyncio.sleep(1.0 / RENEW_HZ)
