"""ArduCopter's flight modes, except GUIDED and AUTO (in :mod:`.guided`, :mod:`.auto`): one object per mode and
vehicle.

Modes: https://ardupilot.org/copter/docs/flight-modes.html
"""

from __future__ import annotations

import math

from zmav.sim.autopilots.arducopter.base import CopterBase
from zmav.sim.autopilots.ardupilot.state import Mode
from zmav.sim.control.setpoints import Axis, Spool, from_nose

CENTI = 0.01
TAKEOFF_STICK = 0.1  # of the climb stick, before a landed copter lifts off
LEAN_MAX = math.radians(30.0)
LAND_PAUSE_S = 4.0
OVER_TERRAIN = 1  # RTL_ALT_TYPE


class CopterMode(Mode):
    """A mode of an ArduCopter."""

    def __init__(self, copter: CopterBase) -> None:
        super().__init__(copter)
        self.copter = copter


class Stabilize(CopterMode):
    number, name = 0, "STABILIZE"
    needs_position, armable, by_pilot, manual_throttle = False, True, True, True
    throttle_to_arm = 0.02

    def blocked(self) -> str:
        return "in RC failsafe" if self.copter.rc.lost else ""

    def update(self) -> None:
        copter, pilot = self.copter, self.copter.rc
        if pilot.throttle < 0.02 and copter.landed:
            copter.sp.spool(Spool.IDLE)
            return
        copter.sp.spool(Spool.FLY)
        copter.sp.lean(pilot.roll * LEAN_MAX, -pilot.pitch * LEAN_MAX)
        copter.sp.turn(pilot.yaw * math.radians(copter.params["PILOT_Y_RATE"]))
        hover = copter.airframe.hover_share
        stick = pilot.throttle
        copter.sp.direct_thrust(stick * 2 * hover if stick < 0.5 else hover + (stick - 0.5) * 2 * (1.0 - hover))


class AltHold(CopterMode):
    number, name = 2, "ALT_HOLD"
    needs_position, armable, by_pilot = False, True, True

    def update(self) -> None:
        copter, pilot = self.copter, self.copter.rc
        if not self.lifts_off():
            return
        copter.sp.lean(pilot.roll * LEAN_MAX, -pilot.pitch * LEAN_MAX)
        self.by_throttle()

    def lifts_off(self) -> bool:
        """In the air, or about to be: a landed copter idles until the throttle stick is raised beyond its middle."""
        copter = self.copter
        if copter.landed and copter.rc.climb < TAKEOFF_STICK:
            copter.sp.spool(Spool.IDLE)
            return False
        copter.sp.spool(Spool.FLY)
        return True

    def by_throttle(self) -> None:
        """Climb and turn as the left stick says."""
        copter, pilot = self.copter, self.copter.rc
        up = copter.params["PILOT_SPEED_UP"] * CENTI
        down = copter.params["PILOT_SPEED_DN"] * CENTI or up
        copter.sp.climb(-pilot.climb * (up if pilot.climb > 0 else down))
        copter.sp.turn(pilot.yaw * math.radians(copter.params["PILOT_Y_RATE"]))


class Loiter(AltHold):
    number, name = 5, "LOITER"
    needs_position = True

    def enter(self) -> None:
        self.copter.stop_here()
        self.copter.sp.limit("speed", self.copter.params["LOIT_SPEED"] * CENTI)

    def update(self) -> None:
        copter, pilot = self.copter, self.copter.rc
        if not self.lifts_off():
            return
        speed = copter.params["LOIT_SPEED"] * CENTI
        vel = from_nose((pilot.pitch * speed, pilot.roll * speed, 0.0), copter.sense.yaw)
        copter.sp.move(vel=vel, horizontal=Axis.VELOCITY, vertical=Axis.VELOCITY)
        self.by_throttle()


class Brake(CopterMode):
    number, name = 17, "BRAKE"

    def enter(self) -> None:
        self.copter.stop_here()

    def update(self) -> None:
        self.copter.spool()


class Land(CopterMode):
    number, name = 9, "LAND"
    needs_position = False
    is_landing = True
    _until = 0.0

    def enter(self) -> None:
        self._until = 0.0
        self.copter.stop_here()

    def pause(self) -> None:
        """A failsafe landed it: give the pilot a moment."""
        self._until = self.copter.now + LAND_PAUSE_S

    def update(self) -> None:
        copter = self.copter
        if not copter.spool():
            return
        if copter.now < self._until:
            copter.sp.climb(0.0)
        else:
            descend(copter)


class Rtl(CopterMode):
    number, name = 6, "RTL"
    changes_speed = True

    def __init__(self, copter: CopterBase) -> None:
        super().__init__(copter)
        self._leg = "climb"
        self._target = (0.0, 0.0)
        self._height = 0.0
        self._since = 0.0

    @property
    def is_landing(self) -> bool:
        return self._leg == "land"

    def enter(self) -> None:
        copter = self.copter
        self._leg = "climb"
        self.copter.stop_here()
        if copter.params["RTL_SPEED"] > 0:
            copter.change_speed("speed", copter.params["RTL_SPEED"] * CENTI)
        north, east, place_down = copter.rally.nearest()
        self._target = (north, east)
        down = self._height = copter.home_world[2]
        away = math.hypot(north - copter.sense.north, east - copter.sense.east)
        height = self._down - copter.sense.down
        # Near home it need not climb as high: a cone (RTL_CONE_SLOPE) over it limits the height.
        slope = copter.params["RTL_CONE_SLOPE"]
        least = max(height + max(copter.params["RTL_CLIMB_MIN"] * CENTI, 0.0), 2.0)
        wanted = max(copter.params["RTL_ALT"] * CENTI, least, down - place_down)
        if slope >= 0.5:
            wanted = min(wanted, max(away * slope, least))
        ceiling = copter.fence.ceiling
        if ceiling is not None and wanted > ceiling:
            wanted = ceiling
        self._height = down - max(wanted, height)

    @property
    def _down(self) -> float:
        """Where it climbs to: so high above home, or above the terrain below."""
        copter = self.copter
        follows = copter.params["RTL_ALT_TYPE"] == OVER_TERRAIN
        return self._height - (copter.above_home(copter.sense.north, copter.sense.east) if follows else 0.0)

    def update(self) -> None:
        copter = self.copter
        if not copter.spool():
            return
        north, east = self._target
        if self._leg == "climb":
            copter.sp.move(vel=(0.0, 0.0, 0.0), horizontal=Axis.VELOCITY, pos=(0.0, 0.0, self._down))
            if copter.sense.down < self._down + 0.5:
                self._leg = "return"
        elif self._leg == "return":
            copter.sp.move(pos=(north, east, self._down))
            if math.hypot(north - copter.sense.north, east - copter.sense.east) < copter.params["WPNAV_RADIUS"] * CENTI:
                self._leg, self._since = "wait", copter.now
        elif self._leg == "wait":
            if copter.now - self._since > copter.params["RTL_LOIT_TIME"] / 1000.0:
                self._leg = "land"
                copter.sp.move(pos=(north, east, self._height), vertical=Axis.VELOCITY)
        else:
            descend(copter)


def descend(copter: CopterBase) -> None:
    """The way down: quick above LAND_ALT_LOW, then at LAND_SPEED until the ground stops it."""
    height = copter.home_world[2] - copter.sense.down
    low = copter.params["LAND_ALT_LOW"] * CENTI
    slow = copter.params["LAND_SPEED"] * CENTI
    fast = copter.params["LAND_SPEED_HIGH"] * CENTI or copter.sp.limit_of("speed_down")
    # From above it slows down in time to pass LAND_ALT_LOW at LAND_SPEED.
    speed = min(fast, math.sqrt(slow * slow + 2.0 * 0.5 * max(height - low, 0.0)))
    if copter.touched:
        copter.sp.lean(0.0, 0.0)
    elif copter.sp.leans:  # thrown up again
        copter.sp.move(pos=(copter.sense.north, copter.sense.east, 0.0), vertical=Axis.VELOCITY)
    copter.sp.climb(max(speed, slow))
