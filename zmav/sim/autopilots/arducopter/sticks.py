"""ArduCopter's modes for a pilot beyond the usual three: ACRO, SPORT, DRIFT and POSHOLD.

https://ardupilot.org/copter/docs/acro-mode.html, .../sport-mode.html, .../drift-mode.html, .../poshold-mode.html
"""

from __future__ import annotations

import math

from zmav.sim.autopilots.arducopter.modes import CENTI, LEAN_MAX, AltHold, CopterMode
from zmav.sim.control.setpoints import Axis, Spool

LEVELLING, LIMITED = 1, 2  # ACRO_TRAINER
DRIFT_SPEED = 5.0  # m/s sideways that the highest lean works against
BRAKE_GAIN = math.radians(6.0)  # lean for each m/s of slipping that DRIFT works against


class Acro(CopterMode):
    """Body rates by the sticks; ACRO_TRAINER levels it, and keeps it from leaning beyond ANGLE_MAX."""

    number, name = 1, "ACRO"
    needs_position, armable, by_pilot, manual_throttle = False, True, True, True
    throttle_to_arm = 0.02

    def update(self) -> None:
        copter, pilot, params = self.copter, self.copter.rc, self.copter.params
        if pilot.throttle < 0.02 and copter.landed:
            copter.sp.spool(Spool.IDLE)
            return
        copter.sp.spool(Spool.FLY)
        most = math.radians(params["ACRO_RP_RATE"])
        roll, pitch = pilot.roll * most, -pilot.pitch * most
        trainer, s = int(params["ACRO_TRAINER"]), copter.sense
        if trainer >= LEVELLING:
            roll -= s.roll * params["ACRO_BAL_ROLL"] * (1.0 - abs(pilot.roll))
            pitch -= s.pitch * params["ACRO_BAL_PITCH"] * (1.0 - abs(pilot.pitch))
        if trainer >= LIMITED:
            lean = copter.sp.limit_of("lean")
            roll, pitch = _kept(roll, s.roll, lean), _kept(pitch, s.pitch, lean)
        copter.sp.rates(roll, pitch, pilot.yaw * math.radians(params["ACRO_Y_RATE"]))
        hover, stick = copter.hover_thrust, pilot.throttle
        copter.sp.direct_thrust(stick * 2 * hover if stick < 0.5 else hover + (stick - 0.5) * 2 * (1.0 - hover))


def _kept(rate: float, angle: float, most: float) -> float:
    """A rate that does not carry an angle past ``most``, and brings back one that is."""
    return min(max(rate, (-most - angle) * 4.5), (most - angle) * 4.5)


class Sport(AltHold):
    """Rates about the level axes by the sticks: a lean stays when they are let go; the height is held."""

    number, name = 13, "SPORT"
    _roll = _pitch = 0.0

    def enter(self) -> None:
        self._roll, self._pitch = self.copter.sense.roll, self.copter.sense.pitch

    def update(self) -> None:
        copter, pilot = self.copter, self.copter.rc
        if not self.lifts_off():
            self._roll = self._pitch = 0.0
            return
        step, most = math.radians(copter.params["ACRO_RP_RATE"]) * copter.dt, copter.sp.limit_of("lean")
        self._roll = min(max(self._roll + pilot.roll * step, -most), most)
        self._pitch = min(max(self._pitch - pilot.pitch * step, -most), most)
        copter.sp.lean(self._roll, self._pitch)
        self.by_throttle()


class Drift(AltHold):
    """Flown like a plane with one stick: roll turns the nose and banks into the turn, pitch gives way, and what slips
    sideways is braked by itself.
    """

    number, name = 11, "DRIFT"
    needs_position = True

    def update(self) -> None:
        copter, pilot, s = self.copter, self.copter.rc, self.copter.sense
        if not self.lifts_off():
            return
        cos, sin = math.cos(s.yaw), math.sin(s.yaw)
        ahead, aside = s.vn * cos + s.ve * sin, s.ve * cos - s.vn * sin
        most = LEAN_MAX
        turn = pilot.roll * math.radians(copter.params["PILOT_Y_RATE"]) * 0.5
        banked = math.atan(turn * max(ahead, 0.0) / 9.80665)
        roll = banked - min(max(aside, -DRIFT_SPEED), DRIFT_SPEED) * BRAKE_GAIN
        pitch = -pilot.pitch * LEAN_MAX if pilot.pitch else min(max(ahead, -DRIFT_SPEED), DRIFT_SPEED) * BRAKE_GAIN
        copter.sp.lean(min(max(roll, -most), most), min(max(pitch, -most), most))
        self.by_throttle()
        copter.sp.turn(turn + pilot.yaw * math.radians(copter.params["PILOT_Y_RATE"]))


class PosHold(AltHold):
    """Leans with the sticks as ALT_HOLD does; with them in the middle it brakes and stays where it stops."""

    number, name = 16, "POSHOLD"
    needs_position = True
    _holding = False

    def enter(self) -> None:
        self._holding = False

    def update(self) -> None:
        copter, pilot = self.copter, self.copter.rc
        if not self.lifts_off():
            self._holding = False
            return
        if pilot.roll or pilot.pitch:
            self._holding = False
            copter.sp.lean(pilot.roll * LEAN_MAX, -pilot.pitch * LEAN_MAX)
        elif not self._holding:
            self._holding = True
            copter.sp.move(horizontal=Axis.VELOCITY, vertical=Axis.VELOCITY)
            copter.sp.limit("speed", copter.params["LOIT_SPEED"] * CENTI)
        self.by_throttle()
