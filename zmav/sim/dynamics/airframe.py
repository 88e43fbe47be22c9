"""What a multirotor is made of: masses, rotors, drag. Data only; the equations are in
:mod:`zmav.sim.dynamics.copter`.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np

from zmav.errors import BadConfig
from zmav.sim.arrays import Array
from zmav.sim.dynamics.battery import Pack

GRAVITY = 9.80665  # m/s^2, standard gravity
AIR_DENSITY = 1.225  # kg/m^3, ISA sea level
REFERENCE_DENSITY = 1.1565  # ISA at 593 m, where the default quadrotor's figures were taken


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
    thrust_max_n: float  # one rotor at full throttle, full battery and ``air_density``, standing in the air
    torque_per_thrust_m: float  # reaction torque per newton of thrust
    thrust_expo: float  # throttle -> thrust curve: 0 linear, 1 quadratic (MOT_THST_EXPO)
    rotor_tau_s: float  # first-order lag of rotor speed
    drag_area_m2: float  # Cd*A of the body, the same from every side
    rotor_drag_kgps: float  # linear drag of the rotor discs in their plane, at hover speed, all rotors together
    spin_drag: float = 0.0  # N m against each rad/s of turning
    leg_m: float  # horizontal distance of the four feet from the centre
    hover_current_a: float
    battery_mah: float
    battery_v: float  # full
    battery_cells: int = 3
    battery_ohm: float = 0.0
    battery_ideal: bool = True  # the voltage stays whatever is drawn, as in the autopilots' own simulations
    air_density: float = AIR_DENSITY  # that the thrust is given for, kg/m^3; 0: it is the same in any air
    inflow_mps: float = 0.0  # a rotor at full speed moving that fast along its axis gives nothing; 0: any speed will do
    rotor_radius_m: float = 0.0  # 0: feels no ground effect
    rotor_height_m: float = 0.15  # over the feet

    @property
    def weight_n(self) -> float:
        return self.mass_kg * GRAVITY

    @property
    def pack(self) -> Pack:
        capacity = 0.0 if self.battery_ideal else self.battery_mah
        cells, ohm = self.battery_cells, self.battery_ohm
        return Pack(cells=cells, capacity_mah=capacity, resistance_ohm=ohm, full_v=self.battery_v)

    @property
    def hover_thrust_n(self) -> float:
        """Thrust of one rotor in hover."""
        return self.weight_n / len(self.rotors)

    @property
    def hover_share(self) -> float:
        """Of full thrust, what carries the weight."""
        return self.hover_thrust_n / self.thrust_max_n

    @property
    def hover_throttle(self) -> float:
        """Throttle (0..1) that hovers in still air: the thrust curve solved for the weight."""
        share, expo = self.hover_share, self.thrust_expo
        if expo < 1e-6:
            return share
        linear = 1.0 - expo
        return (math.sqrt(linear * linear + 4.0 * expo * share) - linear) / (2.0 * expo)

    def at(self, density: float) -> Airframe:
        """As its owner knows it who hovers in air of that density (kg/m^3) with a fresh battery: the autopilots are
        trimmed for these rotors (MOT_THST_HOVER, MPC_THR_HOVER), while the physics goes by the bench's figures.
        """
        sag = 0.0 if self.battery_ideal else self.battery_ohm * self.hover_current_a / self.battery_v
        thrust = self.thrust_max_n * (1.0 - sag) ** 2
        if self.air_density == 0.0:
            return msgspec.structs.replace(self, thrust_max_n=thrust)
        return msgspec.structs.replace(self, thrust_max_n=thrust * density / self.air_density, air_density=density)

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
    # ArduPilot SITL's default "+" quadrotor: 3 kg that hovers at 0.39 throttle, and 15 m/s at 45 degrees of lean, both
    # at 593 m above the sea.
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
        drag_area_m2=0.14 * AIR_DENSITY / REFERENCE_DENSITY,
        rotor_drag_kgps=0.35,
        leg_m=0.15,
        hover_current_a=28.3,
        battery_mah=3300.0,
        battery_v=12.6,
        battery_ohm=0.01,
        air_density=REFERENCE_DENSITY,
    )


def _hexa_x() -> Airframe:
    """A hexarotor of the DJI F550's class: 550 mm across, 3.2 kg, 10 inch propellers, four cells.

    Thrust and torque: static coefficients C_T = 0.115 and C_P = 0.045 of a 10 x 4.7 slow-flyer propeller, falling to
    no thrust at an advance ratio of 0.65 (UIUC propeller database; J. B. Brandt, M. S. Selig, "Propeller Performance
    Data at Low Reynolds Numbers", AIAA 2011-1255). 137 turns a second, which a motor of 900 to 960 rpm/V reaches on
    four cells, give T = C_T rho n^2 D^4 = 11 N; torque / thrust = C_P D / (2 pi C_T) = 0.016 m; no thrust any more at
    0.65 n D = 22.6 m/s along the axis.
    Inertia: by parts. Six motors with propeller and controller of 105 g on a ring of 0.275 m, arms of 55 g, landing
    gear of 200 g 0.15 m below, the rest a cylinder of 0.09 m radius and 0.12 m height.
    Hover: 5.2 N a rotor need 48 W at the shaft, 64 W at an efficiency of 0.75: 6 x 64 W / 15.6 V = 25 A.
    Battery: 4 cells of 4 mOhm with 4 mOhm of wires.
    """
    return Airframe(
        name="hexa",
        mass_kg=3.2,
        inertia_kgm2=(0.043, 0.040, 0.069),
        rotors=_ring(6, 0.275, 30.0, (1, -1, 1, -1, 1, -1)),
        thrust_max_n=11.0,
        torque_per_thrust_m=0.016,
        thrust_expo=0.65,
        rotor_tau_s=0.035,
        drag_area_m2=0.16,
        rotor_drag_kgps=0.40,
        leg_m=0.16,
        hover_current_a=25.0,
        battery_mah=5000.0,
        battery_v=16.8,
        battery_cells=4,
        battery_ohm=0.020,
        battery_ideal=False,
        inflow_mps=22.6,
        rotor_radius_m=0.127,
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
        spin_drag=0.025,
        leg_m=0.15,
        hover_current_a=9.0,
        battery_mah=3300.0,
        battery_v=16.2,
        battery_cells=4,
        air_density=0.0,
    )


def airframe(name: str) -> Airframe:
    """The airframe of that name; :class:`BadConfig` names the known ones."""
    makers = {"quad": _quad_plus, "hexa": _hexa_x, "sih": _sih_x}
    if name not in makers:
        expected = ", ".join(makers)
        raise BadConfig(f"no airframe {name!r}; known: {expected}", field="airframe", value=name, expected=expected)
    return makers[name]()
