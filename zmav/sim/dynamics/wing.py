"""What a fixed wing is made of. Constants and closed forms only; the equations of motion are in
:mod:`zmav.sim.dynamics.plane`.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np

from zmav.sim.arrays import Array, clamp
from zmav.sim.dynamics.airframe import GRAVITY
from zmav.sim.dynamics.battery import Pack


class Wheel(msgspec.Struct, frozen=True):
    """A point that may touch the ground: body forward-right-down, metres. ``rolls``: it is a wheel, and turns along
    the body; ``steered``: with the rudder.
    """

    forward_m: float
    right_m: float
    down_m: float
    rolls: bool = False
    steered: bool = False


class Wing(msgspec.Struct, frozen=True, kw_only=True):
    """A fixed wing's constants: SI units, radians, body axes forward-right-down.

    Coefficients are those of Beard and McLain, "Small Unmanned Aircraft: Theory and Practice", Princeton 2012,
    chapter 4; surfaces are shares of their travel, positive for rolling right, nose up and nose right.
    """

    name: str
    mass_kg: float
    inertia_kgm2: tuple[float, float, float]  # about forward, right, down; products are zero
    area_m2: float
    span_m: float
    chord_m: float
    oswald: float
    lift_0: float
    lift_alpha: float
    stall_rad: float  # angle of attack where the flow parts; the same below the wing
    stall_sharpness: float  # of the blend to the flat plate
    drag_0: float  # parasitic
    side_beta: float
    side_rudder: float
    roll_beta: float
    roll_p: float
    roll_r: float
    roll_aileron: float
    roll_rudder: float
    pitch_0: float
    pitch_alpha: float
    pitch_q: float
    pitch_elevator: float
    yaw_beta: float
    yaw_p: float
    yaw_r: float
    yaw_rudder: float
    thrust_max_n: float  # at full throttle, standing still
    thrust_speed_mps: float  # airspeed at which the propeller gives none
    servo_rate: float  # shares of the travel a second
    wheels: tuple[Wheel, ...]
    full_current_a: float
    pack: Pack

    @property
    def weight_n(self) -> float:
        return self.mass_kg * GRAVITY

    @property
    def aspect_ratio(self) -> float:
        return self.span_m**2 / self.area_m2

    def separated(self, alpha: Array) -> Array:
        """How much of the flow has parted, 0 to 1: Beard and McLain, equation (4.10), for angles (rad) either side."""
        m, a0 = self.stall_sharpness, self.stall_rad
        # Beyond an angle or so of stall it is 1 to the last digit; what the exponentials would reach is of no use.
        above = np.exp(-m * clamp(alpha - a0, -0.8, 0.8))
        below = np.exp(m * clamp(alpha + a0, -0.8, 0.8))
        result: Array = (1.0 + above + below) / ((1.0 + above) * (1.0 + below))
        return result

    def lift_drag(self, alpha: Array) -> tuple[Array, Array]:
        """Coefficients of lift and drag at angles of attack (rad): a line and a parabola where the flow is attached,
        a flat plate where it is not. Same source, equations (4.9) and (4.11); the plate's drag is 2 sin^2.
        """
        parted = self.separated(alpha)
        attached = self.lift_0 + self.lift_alpha * alpha
        sine = np.sin(alpha)
        plate = 2.0 * sine * sine
        lift = (1.0 - parted) * attached + parted * plate * np.sign(sine) * np.cos(alpha)
        induced = attached * attached * (1.0 / (math.pi * self.oswald * self.aspect_ratio))
        drag = self.drag_0 + (1.0 - parted) * induced + parted * plate
        return lift, drag

    def thrust(self, throttle: Array, airspeed: Array) -> Array:
        """Newtons at a throttle of 0 to 1: that share of what the propeller can give at this airspeed (m/s), which
        falls with its square and is never less than none. Same source, section 4.3, at full throttle.
        """
        left = 1.0 - (airspeed * (1.0 / self.thrust_speed_mps)) ** 2
        result: Array = self.thrust_max_n * throttle * np.maximum(left, 0.0)
        return result


# A Skywalker-class trainer of 2 kg, as ArduPilot's simulation flies: planform, lift, drag, damping and weathercock
# coefficients are the ones of the Skywalker 2013 that G. Zogopoulos-Papaliakos identified for "last_letter"
# (github.com/Georacer/last_letter), sideslip's moments with the lever of a centre of mass 15 cm ahead of the side
# force and 5 cm over it. Ours: a stall at 12 degrees, a balance that needs no elevator at 22 m/s, a propeller with
# a top speed, and wheels. Moments of inertia are the ones that the stock gains are tuned to.
TRAINER = Wing(
    name="plane",
    mass_kg=2.0,
    inertia_kgm2=(1.0, 1.0, 1.0),
    area_m2=0.45,
    span_m=1.88,
    chord_m=0.24,
    oswald=0.9,
    lift_0=0.56,
    lift_alpha=6.9,
    stall_rad=0.21,
    stall_sharpness=50.0,
    drag_0=0.10,
    side_beta=-0.98,
    side_rudder=-0.16,
    roll_beta=-0.146,
    roll_p=-1.0,
    roll_r=0.14,
    roll_aileron=0.20,
    roll_rudder=-0.03,
    pitch_0=-0.168,
    pitch_alpha=-2.8,
    pitch_q=-20.0,
    pitch_elevator=0.8,
    yaw_beta=0.33,
    yaw_p=0.022,
    yaw_r=-1.0,
    yaw_rudder=0.08,
    thrust_max_n=35.2,
    thrust_speed_mps=50.0,
    servo_rate=9.5,
    wheels=(
        Wheel(0.25, 0.0, 0.10, rolls=True, steered=True),
        Wheel(-0.10, 0.20, 0.10, rolls=True),
        Wheel(-0.10, -0.20, 0.10, rolls=True),
        Wheel(-0.75, 0.0, -0.02),  # tail
        Wheel(0.0, 0.94, -0.05),  # wing tips
        Wheel(0.0, -0.94, -0.05),
        Wheel(-0.70, 0.0, -0.25),  # fin
    ),
    full_current_a=50.0,
    pack=Pack(cells=3, full_v=12.6),
)
