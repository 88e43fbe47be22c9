"""What a multirotor is made of: masses, rotors, drag. Data only; the equations are in
:mod:`zmav.sim.dynamics.copter`.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np

from zmav.errors import BadConfig
from zmav.sim.arrays import Array

GRAVITY = 9.80665  # m/s^2, standard gravity
AIR_DENSITY = 1.225  # kg/m^3, ISA sea level


class Rotor(msgspec.Struct, frozen=True):
    """One rotor: where it sits (body FRD, metres) and which way it turns seen from above (+1 counter-clockwise)."""

    forward_m: float
    right_m: float
    spin: int


class Airframe(msgspec.Struct, frozen=True, kw_only=True):
    """A multirotor's constants (SI units, body axes forward-right-down)."""

    name: str
    mass_kg: float
    inertia_kgm2: tuple[float, float, float]  # about forward, right, down; products are zero
    rotors: tuple[Rotor, ...]
    thrust_max_n: float  # one rotor at full throttle
    torque_per_thrust_m: float  # reaction torque per newton of thrust
    thrust_expo: float  # throttle -> thrust curve: 0 linear, 1 quadratic (MOT_THST_EXPO)
    rotor_tau_s: float  # first-order lag of rotor speed
    drag_area_m2: float  # Cd*A of the body, the same from every side
    rotor_drag_kgps: float  # linear drag of the rotor discs in their plane, at hover speed, all rotors together
    leg_m: float  # horizontal distance of the four feet from the centre
    hover_current_a: float
    battery_mah: float
    battery_v: float

    @property
    def weight_n(self) -> float:
        return self.mass_kg * GRAVITY

    @property
    def hover_thrust_n(self) -> float:
        """Thrust of one rotor in hover."""
        return self.weight_n / len(self.rotors)

    @property
    def hover_throttle(self) -> float:
        """Throttle (0..1) that hovers in still air: the thrust curve solved for the weight."""
        return float(throttle_for(np.asarray(self.hover_thrust_n / self.thrust_max_n), self.thrust_expo))

    def wrench_matrix(self) -> Array:
        """(4, rotors): rotor thrusts in newtons -> (total thrust, torque about forward, right, down)."""
        rows = [
            [1.0 for _ in self.rotors],
            [-r.right_m for r in self.rotors],
            [r.forward_m for r in self.rotors],
            [r.spin * self.torque_per_thrust_m for r in self.rotors],
        ]
        return np.array(rows)


def throttle_for(thrust: Array, expo: float) -> Array:
    """Throttle 0..1 that gives that fraction of full thrust: the inverse of ``(1-expo)*u + expo*u^2``.

    Source: ardupilot.org, "Motor Thrust Scaling" (MOT_THST_EXPO).
    """
    if expo < 1e-6:
        return thrust
    linear = 1.0 - expo
    return (np.sqrt(linear * linear + 4.0 * expo * thrust) - linear) / (2.0 * expo)


def _ring(count: int, arm_m: float, first_deg: float, spins: tuple[int, ...]) -> tuple[Rotor, ...]:
    """Rotors evenly on a circle, clockwise from ``first_deg`` right of the nose."""
    angles = [math.radians(first_deg + 360.0 * i / count) for i in range(count)]
    return tuple(Rotor(arm_m * math.cos(a), arm_m * math.sin(a), spin) for a, spin in zip(angles, spins, strict=True))


def _quad_plus() -> Airframe:
    # ArduPilot SITL's default "+" quadrotor: 3 kg that hovers at 0.39 throttle, and 15 m/s at 45 degrees of lean.
    right, left, front, rear = (Rotor(0, 0.25, 1), Rotor(0, -0.25, 1), Rotor(0.25, 0, -1), Rotor(-0.25, 0, -1))
    mass, hover, expo = 3.0, 0.39, 0.65
    thrust_max = mass * GRAVITY / 4 / ((1 - expo) * hover + expo * hover * hover)
    return Airframe(
        name="quad",
        mass_kg=mass,
        inertia_kgm2=(0.032, 0.032, 0.057),
        rotors=(right, left, front, rear),
        thrust_max_n=thrust_max,
        torque_per_thrust_m=0.016,
        thrust_expo=expo,
        rotor_tau_s=0.03,
        drag_area_m2=0.14,
        rotor_drag_kgps=0.35,
        leg_m=0.15,
        hover_current_a=28.3,
        battery_mah=3300.0,
        battery_v=12.6,
    )


def _hexa_x() -> Airframe:
    # A DJI F550-class hexarotor (550 mm wheelbase) of 3.2 kg.
    return Airframe(
        name="hexa",
        mass_kg=3.2,
        inertia_kgm2=(0.040, 0.040, 0.072),
        rotors=_ring(6, 0.275, 30.0, (1, -1, 1, -1, 1, -1)),
        thrust_max_n=11.0,
        torque_per_thrust_m=0.016,
        thrust_expo=0.65,
        rotor_tau_s=0.035,
        drag_area_m2=0.16,
        rotor_drag_kgps=0.40,
        leg_m=0.16,
        hover_current_a=30.0,
        battery_mah=5000.0,
        battery_v=14.8,
    )


def _sih_x() -> Airframe:
    # PX4's own simulation-in-hardware quadrotor: 1 kg, 5 N a rotor straight from the command, linear drag (SIH_*).
    return Airframe(
        name="sih",
        mass_kg=1.0,
        inertia_kgm2=(0.025, 0.025, 0.030),
        rotors=_ring(4, 0.283, 45.0, (1, -1, 1, -1)),
        thrust_max_n=5.0,
        torque_per_thrust_m=0.02,
        thrust_expo=0.0,
        rotor_tau_s=0.05,
        drag_area_m2=0.0,
        rotor_drag_kgps=1.0,
        leg_m=0.15,
        hover_current_a=9.0,
        battery_mah=3300.0,
        battery_v=16.2,
    )


def airframe(name: str) -> Airframe:
    """The airframe of that name; :class:`BadConfig` names the known ones."""
    makers = {"quad": _quad_plus, "hexa": _hexa_x, "sih": _sih_x}
    if name not in makers:
        expected = ", ".join(makers)
        raise BadConfig(f"no airframe {name!r}; known: {expected}", field="airframe", value=name, expected=expected)
    return makers[name]()
