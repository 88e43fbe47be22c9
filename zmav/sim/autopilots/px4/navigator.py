"""What the AUTO modes do: take off, hold, fly to a place, return, land.

https://docs.px4.io/v1.16/en/flight_modes_mc/takeoff.html, .../hold.html, .../return.html, .../land.html
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from zmav.sim.autopilots.px4.modes import DESCEND, LAND, MISSION, RTL, TAKEOFF, Mode
from zmav.sim.control.setpoints import Axis, Spool, Vector

if TYPE_CHECKING:
    from zmav.sim.autopilots.px4.copter import Px4Copter

REACHED_M = 0.4
MIN_CLIMB_M = 0.1
CLOSE_M = 1.0  # nearer to home than this it lands where it is


class Navigator:
    """One vehicle's AUTO modes."""

    def __init__(self, copter: Px4Copter) -> None:
        self._copter = copter
        self.target: Vector | None = None  # of HOLD and on the way home, world NED
        self.yaw: float | None = None
        self.takeoff_amsl: float | None = None  # asked for by NAV_TAKEOFF
        self._leg = ""
        self._wait_until = 0.0
        self._takeoff_down = 0.0

    def enter(self, mode: Mode) -> None:
        copter = self._copter
        copter.sp.raw(False)
        copter.cruise_speed = None
        self.target = self.yaw = None
        copter.stop_here()
        if mode is TAKEOFF:
            self._plan_takeoff()
        elif mode is RTL:
            self._plan_return()
        elif mode is MISSION:
            copter.mission.enter()

    def reposition(self, target: Vector, yaw: float | None, speed: float | None) -> None:
        """HOLD at that place of the world's NED, when HOLD flies."""
        self.target, self.yaw = target, yaw
        if speed is not None:
            self._copter.cruise_speed = speed

    @property
    def goal(self) -> Vector:
        """Where the mode goes, in the world's NED."""
        copter, sense = self._copter, self._copter.sense
        if copter.mode is TAKEOFF:
            return sense.north, sense.east, self._takeoff_down
        return self.target or (sense.north, sense.east, sense.down)

    @property
    def way_home_s(self) -> float:
        """Seconds that a return to home would take, by its legs and with PX4's margins."""
        copter, sense, p = self._copter, self._copter.sense, self._copter.params
        north, east, down = copter.home_world
        away, height = math.hypot(north - sense.north, east - sense.east), down - sense.down
        up = max(self._return_height() - height, 0.0) if away > CLOSE_M else 0.0
        slow = p["MPC_LAND_SPEED"]
        takes = up / p["MPC_Z_V_AUTO_UP"] + away / p["MPC_XY_CRUISE"] + max(height + up, 0.0) / max(slow, 0.1)
        return float(takes * p["RTL_TIME_FACTOR"] + p["RTL_TIME_MARGIN"])

    @property
    def lifts(self) -> bool:
        """A standing vehicle is to leave the ground."""
        mission = self._copter.mission
        under_way = not (mission.finished or mission.landing)
        return self._copter.mode is TAKEOFF or (self._copter.mode is MISSION and under_way)

    @property
    def descends(self) -> bool:
        """It goes down until the ground stops it."""
        mode = self._copter.mode
        if mode is MISSION:
            return self._copter.mission.landing
        return mode in (LAND, DESCEND) or (mode is RTL and self._leg == "land")

    def fly(self) -> None:
        """One tick of the mode."""
        copter = self._copter
        copter.sp.spool(Spool.FLY)
        copter.limit_auto()
        mode = copter.mode
        if mode is TAKEOFF:
            self._rise()
        elif mode is RTL:
            self._return()
        elif mode is LAND:
            self.descend()
        elif mode is DESCEND:
            copter.sp.lean(0.0, 0.0)  # without a position: level
            copter.sp.climb(copter.params["MPC_LAND_SPEED"])
        elif mode is MISSION:
            copter.mission.fly()
        elif self.target is not None:
            self.go(self.target, self.yaw)

    def go(self, target: Vector, yaw: float | None) -> bool:
        """Toward a place, nose as asked or (MPC_YAW_MODE 0) toward it; True once there."""
        copter, sense = self._copter, self._copter.sense
        copter.sp.move(pos=target)
        north, east = target[0] - sense.north, target[1] - sense.east
        away = math.hypot(north, east)
        if yaw is not None:
            copter.sp.heading(yaw)
        elif away > float(copter.params["NAV_ACC_RAD"]):
            copter.sp.heading(math.atan2(east, north))
        return away < float(copter.params["NAV_ACC_RAD"]) and abs(target[2] - sense.down) < 0.8

    # ---- takeoff

    def _plan_takeoff(self) -> None:
        copter = self._copter
        home_amsl = copter.place(copter.home_world).alt_amsl_m
        least = home_amsl + float(copter.params["MIS_TAKEOFF_ALT"])
        wanted, self.takeoff_amsl = self.takeoff_amsl, None
        if wanted is None:
            copter.default_takeoff(least - home_amsl)
            wanted = least
        elif wanted < least:
            copter.say(4, f"Using minimum takeoff altitude: {least - home_amsl:.2f} m\t")
            wanted = least
        down = copter.home_world[2] - (wanted - home_amsl)
        if down > copter.sense.down - MIN_CLIMB_M:
            copter.say(2, "Already higher than takeoff altitude\t")
            down = copter.sense.down
        self._takeoff_down = down

    def _rise(self) -> None:
        copter = self._copter
        copter.sp.limit("speed_up", copter.params["MPC_TKO_SPEED"])
        copter.sp.height(self._takeoff_down)
        if copter.sense.down < self._takeoff_down + REACHED_M:
            copter.takeoff_done()

    # ---- return

    def _plan_return(self) -> None:
        """Climb to where the cone over home (RTL_CONE_ANG) or RTL_RETURN_ALT begins, never down."""
        copter, sense = self._copter, self._copter.sense
        self._leg = "climb"
        self.target = (sense.north, sense.east, copter.home_world[2] - self._return_height())

    def _return_height(self) -> float:
        """Above home, m."""
        copter, sense = self._copter, self._copter.sense
        north, east, down = copter.home_world
        away = math.hypot(north - sense.north, east - sense.east)
        height = float(copter.params["RTL_RETURN_ALT"])
        cone = math.radians(float(copter.params["RTL_CONE_ANG"]))
        if away < CLOSE_M:
            height = 0.0
        elif 0.0 < cone < math.pi / 2 - 0.01:
            height = min(height, max(away / math.tan(cone), 2.0 * float(copter.params["NAV_ACC_RAD"])))
        return max(height, down - sense.down)

    def _return(self) -> None:
        copter, sense = self._copter, self._copter.sense
        north, east, down = copter.home_world
        height = self.target[2] if self.target is not None else sense.down
        if self._leg == "climb":
            copter.sp.height(height)
            if sense.down < height + REACHED_M:
                self._leg = "home"
        elif self._leg == "home":
            if self.go((north, east, height), None):
                self._leg = "down"
        elif self._leg == "down":
            low = max(height, down - float(copter.params["RTL_DESCEND_ALT"]))
            if self.go((north, east, low), None):
                self._leg = "wait"
                self._wait_until = copter.now + float(copter.params["RTL_LAND_DELAY"])
        elif self._leg == "wait":
            # A negative RTL_LAND_DELAY: stay up there.
            if copter.params["RTL_LAND_DELAY"] >= 0 and copter.now >= self._wait_until:
                self._leg = "land"
                copter.sp.move(pos=(north, east, sense.down), vertical=Axis.VELOCITY)
        else:
            self.descend()

    # ---- landing

    def descend(self) -> None:
        """Down, slower from MPC_LAND_ALT1 to MPC_LAND_ALT2, and at a crawl below MPC_LAND_ALT3."""
        copter = self._copter
        height = copter.home_world[2] - copter.sense.down
        p = copter.params
        fast, slow, crawl = p["MPC_Z_V_AUTO_DN"], p["MPC_LAND_SPEED"], p["MPC_LAND_CRWL"]
        high, low = p["MPC_LAND_ALT1"], p["MPC_LAND_ALT2"]
        if height < p["MPC_LAND_ALT3"]:
            speed = crawl
        else:
            share = min(max((height - low) / max(high - low, 0.1), 0.0), 1.0)
            speed = slow + share * (fast - slow)
        copter.sp.climb(max(speed, 0.1))
