"""One ArduCopter: its modes, put together, and how it leaves the ground and comes back to it."""

from __future__ import annotations

import math

from zmav import rotation
from zmav.sim.autopilots.arducopter.auto import Auto
from zmav.sim.autopilots.arducopter.base import LANDED_AFTER_S, CopterBase
from zmav.sim.autopilots.arducopter.guided import Guided
from zmav.sim.autopilots.arducopter.modes import AltHold, Brake, Land, Loiter, Rtl, Stabilize
from zmav.sim.autopilots.arducopter.reactions import CopterReactions
from zmav.sim.autopilots.arducopter.travel import Travel
from zmav.sim.autopilots.ardupilot.state import EMERGENCY, Mode, Reactions
from zmav.sim.dynamics.airframe import GRAVITY
from zmav.sim.fleets.base import Sense

LOW_THRUST_SHARE = 0.65  # of the hover throttle
HIGHEST_M = 80_000.0
# Of the crash check: https://ardupilot.org/copter/docs/crash_check.html
AFTER_S, ANGLE_ERROR_DEG, LEAN_DEG, SPEED_MAX, ACCEL_MAX = 2.0, 30.0, 15.0, 10.0, 3.0
FILTER_S = 1.0 / (2.0 * math.pi)  # of the acceleration: 1 Hz


class CrashCheck:
    """FS_CRASH_CHECK: who leans far from where it wants to, and hardly moves, has crashed."""

    def __init__(self, copter: CopterBase) -> None:
        self._copter = copter
        self._lasting = 0.0
        self._accel = 0.0

    def update(self, dt: float) -> None:
        copter, s = self._copter, self._copter.sense
        self._accel += (self._felt() - self._accel) * min(dt / FILTER_S, 1.0)
        if not copter.armed or copter.landed or not copter.params["FS_CRASH_CHECK"]:
            self._lasting = 0.0
            return
        off = self.off_deg
        lean = math.degrees(math.acos(min(max(math.cos(s.roll) * math.cos(s.pitch), -1.0), 1.0)))
        speed = math.sqrt(s.vn * s.vn + s.ve * s.ve + s.vd * s.vd)
        crashed = self._accel < ACCEL_MAX and lean > LEAN_DEG and off > ANGLE_ERROR_DEG and speed < SPEED_MAX
        self._lasting = self._lasting + dt if crashed else 0.0
        if self._lasting >= AFTER_S - 1e-9:
            copter.say(
                EMERGENCY,
                f"Crash: Disarming: AngErr={off:.0f}>{ANGLE_ERROR_DEG:.0f}, Accel={self._accel:.1f}<{ACCEL_MAX:.1f}",
            )
            copter.disarm(forced=True)

    @property
    def off_deg(self) -> float:
        """Between the thrust's direction and the one asked for; the heading does not count."""
        s = self._copter.sense
        is_down = _down(s.qw, s.qx, s.qy, s.qz)
        want_down = _down(s.want_qw, s.want_qx, s.want_qy, s.want_qz)
        dot = sum(a * b for a, b in zip(is_down, want_down, strict=True))
        return math.degrees(math.acos(min(max(dot, -1.0), 1.0)))

    def _felt(self) -> float:
        """Acceleration over the ground, m/s^2: what the accelerometers feel but for gravity."""
        s = self._copter.sense
        gx, gy, gz = rotation.to_body((s.qw, s.qx, s.qy, s.qz), (0.0, 0.0, GRAVITY))
        return math.sqrt((s.fx + gx) ** 2 + (s.fy + gy) ** 2 + (s.fz + gz) ** 2)


def _down(w: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """The body's down axis in the world: the last column of the attitude's matrix."""
    return 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)


class ArduCopter(CopterBase):
    """Flies one multirotor of the :class:`~zmav.sim.fleets.copter.CopterFleet`."""

    auto: Auto
    guided: Guided

    def make_modes(self) -> list[Mode]:
        self.land, rtl = Land(self), Rtl(self)
        self.guided, self.auto = Guided(self), Auto(self, Travel(self), rtl)
        modes: list[Mode] = [kind(self) for kind in (Stabilize, AltHold, Loiter, Brake)]
        return [*modes, self.guided, self.auto, self.land, rtl]

    def make_reactions(self) -> Reactions:
        return CopterReactions(self, self.land)

    def on_power(self) -> None:
        self.crash_check = CrashCheck(self)
        super().on_power()

    @property
    def taking_off(self) -> bool:
        if self.mode is self.guided:
            return self.guided.taking_off
        return self.mode is self.auto and self.auto.taking_off

    def take_off(self, height: float) -> bool:
        """Rise to ``height`` metres above home: GUIDED, armed and on the ground only."""
        ready = self.armed and self.landed and self.mode is self.guided and self.position_ok
        if not ready or not 0.0 < height < HIGHEST_M:
            return False
        down = self.home_world[2] - height
        if down > self.sense.down - 0.1:
            return False
        self.auto_armed = True
        self.guided.take_off(down)
        return True

    # ---- what it does by itself

    def update(self, now: float, sense: Sense, dt: float) -> None:
        super().update(now, sense, dt)
        if self.armed:
            self.heading.update(sense)

    def watch(self, dt: float) -> None:
        super().watch(dt)
        self.crash_check.update(dt)
        if self.armed:
            if self.rc.throttle > 0.03:
                self.auto_armed = True
            elif self.mode.manual_throttle and self.rc.valid:
                self.auto_armed = False

    def watch_ground(self) -> None:
        self._watch_contact()
        self._disarm_idle()

    def _watch_contact(self) -> None:
        """Landed: on the ground with hardly any thrust for a while. In the air: once the ground is left."""
        sense = self.sense
        if self.landed:
            if not sense.contact and sense.throttle > 0.5 * self.airframe.hover_throttle:
                self.landed = False
                self._quiet_since = None
            return
        quiet = sense.throttle < LOW_THRUST_SHARE * self.airframe.hover_throttle and abs(sense.vd) < 1.0
        if sense.contact and quiet and self.crash_check.off_deg <= ANGLE_ERROR_DEG:
            self._quiet_since = self.now if self._quiet_since is None else self._quiet_since
            if self.now - self._quiet_since >= LANDED_AFTER_S:
                self.landed = True
                self._idle_since = self._landed_at = self.now
        else:
            self._quiet_since = None

    def _disarm_idle(self) -> None:
        """Disarm after a landing, and after DISARM_DELAY of standing armed with the throttle down."""
        lands = isinstance(self.mode, (Land, Rtl))  # whatever the throttle stick says
        if not self.landed or self.taking_off or (self.rc.throttle > 0.05 and not lands):
            self._idle_since = self.now
            return
        delay = self.params["DISARM_DELAY"]
        if lands:
            delay = LANDED_AFTER_S
        elif delay <= 0:
            return
        if self.now - self._idle_since >= delay:
            self.disarm()
