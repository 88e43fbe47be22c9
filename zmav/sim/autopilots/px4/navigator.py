"""What the AUTO modes do: take off, hold, fly to a place or a mission's places, return, land.

https://docs.px4.io/v1.16/en/flight_modes_mc/takeoff.html, .../hold.html, .../mission.html, .../return.html
"""

from __future__ import annotations

import math
from collections.abc import Callable

from zmav.sim.autopilots.items import Item
from zmav.sim.autopilots.px4 import events
from zmav.sim.autopilots.px4.items import RELATIVE, MissionItems
from zmav.sim.autopilots.px4.modes import DESCEND, HOLD, LAND, MISSION, RTL, TAKEOFF, Mode
from zmav.sim.autopilots.px4.state import Px4State
from zmav.sim.control.setpoints import Axis, Spool, Vector
from zmav.sim.geo import Position, to_ned

_WAYPOINT, _LOITER, _LOITER_TIME, _RETURN, _LAND, _TAKEOFF, _DELAY, _JUMP, _SPEED = 16, 17, 19, 20, 21, 22, 93, 177, 178
_TRAVELS = {_WAYPOINT, _LOITER, _LOITER_TIME, _LAND, _TAKEOFF, _DELAY}
_NO_PLACE = 2**31 - 1
_LOW_M = 1.0  # above home: from there it rises straight up first
_MOST_STEPS = 50  # items without a way to fly that are worked off at once: jumps may go round in circles
REACHED_M = 0.4
TAKEN_OFF_M = 0.8
"""NAV_MC_ALT_RAD: so far below the height of a takeoff it ends, and HOLD keeps the height that it found"""
MIN_CLIMB_M = 0.1
CLOSE_M = 1.0  # nearer to home than this it lands where it is


class Mission:
    """The items of one vehicle's mission; ``current`` flies, or will when MISSION is entered. HOLD follows the last."""

    def __init__(self, copter: Px4State) -> None:
        self._copter = copter
        self.items = MissionItems()
        self.current = 0
        self.finished = False
        self.landing = False
        self.reached: Callable[[int], None] = lambda seq: None
        self.go: Callable[[Vector, float | None], bool]
        """flies toward a place with a heading; True once there"""
        self.descend: Callable[[], None]
        self._known = 0
        self._start: Vector | None = None  # of the item that flies
        self._there_since: float | None = None
        self._jumps: dict[int, int] = {}

    @property
    def able(self) -> bool:
        """There is something to fly."""
        return len(self.items) > 0

    @property
    def state(self) -> int:
        """MISSION_STATE: complete, active, paused, not started."""
        if self.finished:
            return 5
        if self._copter.mode is MISSION and self._copter.armed:
            return 3
        return 4 if self.current else 2

    def renew(self) -> None:
        """Start from the beginning where the list has changed."""
        if self._known != self.items.opaque_id:
            self._known = self.items.opaque_id
            self.jump(0)

    def jump(self, seq: int) -> bool:
        """Make ``seq`` the current item; False where there is none such."""
        if not 0 <= seq < max(len(self.items), 1):
            return False
        self.current, self.finished = seq, False
        self._jumps.clear()
        self._begin()
        return True

    def enter(self) -> None:
        """MISSION is entered: go on where it was left, or begin again after its end."""
        self.renew()
        if self.finished:
            self.jump(0)
        self._begin()

    def _begin(self) -> None:
        self._start = self._there_since = None
        self.landing = False

    def fly(self) -> None:
        """One tick."""
        for _ in range(_MOST_STEPS):
            if self.current >= len(self.items):
                self._end()
                return
            item = self.items.items[self.current]
            if not self._step(item):
                return
        self._end()

    def _step(self, item: Item) -> bool:
        """Fly one item; True where the next one is to be looked at in the same tick."""
        copter = self._copter
        if item.command == _RETURN:
            self.current += 1
            copter.set_mode(RTL)
            return False
        if item.command == _JUMP:
            return self._jump_item(item)
        if item.command == _SPEED:
            copter.cruise_speed = item.p2 if item.p2 > 0 else None
        elif item.command in _TRAVELS and not self._travel(item):
            return False
        self._done()
        return True

    def _jump_item(self, item: Item) -> bool:
        done = self._jumps.get(self.current, 0)
        if done < item.p2 and 0 <= item.p1 < len(self.items):
            self._jumps[self.current] = done + 1
            self.current = int(item.p1)
            self._begin()
        else:
            self._done()
        return True

    def _travel(self, item: Item) -> bool:
        """On the way to an item, or waiting there; True when it is done."""
        copter, sense = self._copter, self._copter.sense
        if self._start is None:
            self._start = (sense.north, sense.east, sense.down)
        if item.command == _DELAY:
            return self._waited(item.p1)
        target = self._target(item)
        if item.command == _LAND:
            self._land(target)
            return False
        if item.command == _TAKEOFF or copter.home_world[2] - self._start[2] < _LOW_M:
            copter.sp.move(pos=(self._start[0], self._start[1], target[2]))
            if abs(sense.down - target[2]) > 0.8:
                return False
        yaw = math.radians(item.p4) if item.command == _WAYPOINT and math.isfinite(item.p4) and item.p4 else None
        there = self.go(target, yaw)
        if item.command == _LOITER or not (there or self._there_since is not None):
            return False
        return self._waited(item.p1 if item.command in (_WAYPOINT, _LOITER_TIME) else 0.0)

    def _land(self, target: Vector) -> None:
        sense = self._copter.sense
        if self.landing or math.hypot(target[0] - sense.north, target[1] - sense.east) < 0.5:
            self.landing = True
            self.descend()
        else:
            self.go((target[0], target[1], self._start[2] if self._start else sense.down), None)

    def _waited(self, seconds: float) -> bool:
        now = self._copter.now
        self._there_since = now if self._there_since is None else self._there_since
        return now - self._there_since >= seconds

    def _target(self, item: Item) -> Vector:
        """The item's place in the world's NED; without a place of its own, where it began."""
        copter, start = self._copter, self._start or (0.0, 0.0, 0.0)
        if item.here or item.x == _NO_PLACE:
            north, east = start[0], start[1]
            down = to_ned(Position(copter.world.lat_deg, copter.world.lon_deg, item.z), copter.world)[2]
        else:
            north, east, down = to_ned(Position(item.x * 1e-7, item.y * 1e-7, item.z), copter.world)
        return north, east, copter.home_world[2] - item.z if item.frame in RELATIVE else down

    def _done(self) -> None:
        self.reached(self.current)
        self.current += 1
        self._begin()

    def touched_down(self) -> None:
        """The last item, a landing, is over."""
        if self.landing:
            self.reached(self.current)
            self.landing, self.finished = False, True
            self.current = max(len(self.items) - 1, 0)

    def _end(self) -> None:
        self.finished, self.current = True, max(len(self.items) - 1, 0)
        self._copter.set_mode(HOLD)


class Navigator:
    """One vehicle's AUTO modes."""

    def __init__(self, copter: Px4State, mission: Mission) -> None:
        self._copter, self._mission = copter, mission
        mission.go, mission.descend = self.go, self.descend
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
            self._mission.enter()

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
    def lifts(self) -> bool:
        """A standing vehicle is to leave the ground."""
        mission = self._mission
        under_way = not (mission.finished or mission.landing)
        return self._copter.mode is TAKEOFF or (self._copter.mode is MISSION and under_way)

    @property
    def descends(self) -> bool:
        """It goes down until the ground stops it."""
        mode = self._copter.mode
        if mode is MISSION:
            return self._mission.landing
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
            self._mission.fly()
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
            copter.event(events.DEFAULT_TAKEOFF, events.float_argument(least - home_amsl))
            copter.say(6, f"Using default takeoff altitude: {least - home_amsl:.1f} m\t")
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
        # As fast as it can still brake from, by its jerk and then its acceleration (PX4's computeMaxSpeedFromDistance).
        accel, away = copter.params["MPC_ACC_DOWN_MAX"], max(copter.sense.down - self._takeoff_down, 0.0)
        half = 2.0 * accel * accel / copter.params["MPC_JERK_AUTO"]
        copter.sp.limit(
            "speed_up", min(copter.params["MPC_TKO_SPEED"], math.sqrt(half * half + 2.0 * accel * away) - half)
        )
        copter.sp.height(self._takeoff_down)
        if copter.sense.down < self._takeoff_down + TAKEN_OFF_M:
            copter.set_mode(HOLD)  # COM_TAKEOFF_ACT 0

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
