"""The pilot's sticks: a radio, or MANUAL_CONTROL from a joystick (COM_RC_IN_MODE), the modes that follow them.

https://docs.px4.io/v1.16/en/flight_modes_mc/position.html and its neighbours
"""

from __future__ import annotations

import math

from zmav.sim.autopilots.pilot import Pilot
from zmav.sim.autopilots.px4 import events
from zmav.sim.autopilots.px4.modes import ALTCTL, POSCTL, Mode
from zmav.sim.autopilots.px4.state import Px4State
from zmav.sim.control.setpoints import Axis, Spool, from_nose

RADIO_ONLY, DISABLED = 0, 4  # COM_RC_IN_MODE
TAKEOVER = 0.12  # of a stick's way: a pilot who moves it more takes an automatic mode over (COM_RC_STICK_OV)
MOVING_S = 0.15  # how long a joystick that moved counts as moving
TAKEOFF_STICK = 0.15
DEADZONE = 0.05
_BY_HEIGHT = (ALTCTL, POSCTL)


class Sticks:
    """Roll, pitch, yaw from -1 to 1 and throttle from 0 to 1, of the one who holds them."""

    def __init__(self, copter: Px4State, pilot: Pilot) -> None:
        self._copter, self._pilot = copter, pilot
        self._joystick: tuple[float, float, float, float] | None = None
        self._joystick_at = self._radio_at = -math.inf
        self._joystick_moved = -math.inf
        self._heard = False

    def update(self) -> None:
        """Ten times a second: hear the radio, say when the sticks come and go."""
        copter = self._copter
        if self._pilot.heard:
            self._radio_at = copter.now
        alive = self.alive
        if alive is not self._heard:
            self._heard = alive
            if not alive:
                copter.tell(events.MANUAL_LOST)

    def joystick(self, roll: float, pitch: float, yaw: float, throttle: float) -> None:
        """A MANUAL_CONTROL came."""
        if int(self._copter.params["COM_RC_IN_MODE"]) in (RADIO_ONLY, DISABLED):
            return
        stick, before, now = (roll, pitch, yaw, throttle), self._joystick, self._copter.now
        heard = now - self._joystick_at <= float(self._copter.params["COM_RC_LOSS_T"])
        moved = max(abs(a - b) for a, b in zip(stick[:3], before or stick, strict=False))
        if heard and moved > TAKEOVER:
            self._joystick_moved = now
        self._joystick, self._joystick_at = stick, now

    @property
    def alive(self) -> bool:
        if int(self._copter.params["COM_RC_IN_MODE"]) == DISABLED:
            return False
        latest = self._copter.now if self._pilot.heard else max(self._radio_at, self._joystick_at)
        return self._copter.now - latest <= float(self._copter.params["COM_RC_LOSS_T"])

    @property
    def values(self) -> tuple[float, float, float, float]:
        """(roll, pitch, yaw, throttle); pitch is positive forward."""
        pilot = self._pilot
        if pilot.heard or self._joystick is None:
            return pilot.roll, pilot.pitch, pilot.yaw, pilot.throttle
        roll, pitch, yaw, throttle = (0.0 if abs(v) < DEADZONE else v for v in self._joystick)
        return roll, pitch, yaw, throttle

    @property
    def moved(self) -> bool:
        """A radio's stick is held away from its middle, or a joystick's was moved from where it was."""
        if not self._pilot.heard:
            return self.alive and self._copter.now - self._joystick_moved <= MOVING_S
        roll, pitch, yaw, _ = self.values
        return self.alive and max(abs(roll), abs(pitch), abs(yaw)) > TAKEOVER

    @property
    def climb(self) -> float:
        """The throttle as a wish to climb, -1 to 1."""
        stick = 2.0 * self.values[3] - 1.0
        return 0.0 if abs(stick) < DEADZONE else stick

    def lifts(self, mode: Mode) -> bool:
        """A standing vehicle is asked to fly."""
        return self.alive and (self.climb > TAKEOFF_STICK if mode in _BY_HEIGHT else self.values[3] > 0.1)

    def descends(self, mode: Mode) -> bool:
        return self.alive and (self.climb < -0.3 if mode in _BY_HEIGHT else self.values[3] < 0.2)

    def fly(self, mode: Mode) -> None:
        """One tick of a manual mode; without sticks the vehicle sinks level, as was measured."""
        copter, sp, p = self._copter, self._copter.sp, self._copter.params
        sp.spool(Spool.FLY)
        if not self.alive:
            sp.raw(False)
            sp.lean(0.0, 0.0)
            sp.climb(p["MPC_LAND_SPEED"])
            sp.heading(copter.sense.want_yaw)
            return
        roll, pitch, yaw, throttle = self.values
        sp.turn(yaw * math.radians(p["MPC_MAN_Y_MAX"]))
        lean = math.radians(p["MPC_MAN_TILT_MAX"])
        if mode is POSCTL:
            self._by_speed(roll, pitch)
            return
        sp.lean(roll * lean, -pitch * lean)
        if mode is ALTCTL:
            self._by_climb()
        else:
            hover = copter.airframe.hover_share
            sp.direct_thrust(throttle * 2 * hover if throttle < 0.5 else hover + (throttle - 0.5) * 2 * (1.0 - hover))

    def _by_speed(self, roll: float, pitch: float) -> None:
        copter, speed = self._copter, self._copter.params["MPC_VEL_MANUAL"]
        vel = from_nose((pitch * speed, roll * speed, 0.0), copter.sense.yaw)
        copter.sp.limit("speed", speed)
        copter.sp.move(vel=vel, horizontal=Axis.VELOCITY, vertical=Axis.VELOCITY)
        self._by_climb()

    def _by_climb(self) -> None:
        copter, climb = self._copter, self.climb
        up, down = (copter.params[name] for name in ("MPC_Z_VEL_MAX_UP", "MPC_Z_VEL_MAX_DN"))
        copter.sp.limit("speed_up", up)
        copter.sp.limit("speed_down", down)
        copter.sp.climb(-climb * (up if climb > 0 else down))
