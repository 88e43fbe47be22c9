"""What a rover is made of: masses, wheels, motors, tyres. Data only; the equations are in
:mod:`zmav.sim.dynamics.rover`.
"""

from __future__ import annotations

import msgspec

from zmav.errors import BadConfig
from zmav.sim.dynamics.battery import Pack


class RoverFrame(msgspec.Struct, frozen=True, kw_only=True):
    """A rover's constants (SI units, body axes forward-right-down)."""

    name: str
    skid: bool
    """steered by its two sides; else by its front wheels"""
    mass_kg: float
    length_m: float
    width_m: float
    height_m: float
    wheelbase_m: float
    track_m: float
    effective_track_m: float
    """of a skid-steered rover: over which its sides' speeds make a turn"""
    steering_max: float
    """rad of the front wheels at full lock"""
    steering_rate: float
    """rad/s at which they turn"""
    free_speed: float
    """m/s at full throttle without any load"""
    stall_accel: float
    """m/s^2 at full throttle, standing, with tyres that hold"""
    motor_tau_s: float
    friction: float
    """of the tyres, in all directions"""
    rolling: float
    """coefficient of rolling resistance"""
    scrub: float
    """of a skid-steered rover: resistance of a turn, as a share of the weight at the wheels"""
    drag_area_m2: float
    idle_current_a: float
    stall_current_a: float
    pack: Pack


def _car() -> RoverFrame:
    # A 1/10 racing car: mass, wheelbase, steering, tyres, top speed and acceleration of the F1TENTH vehicle
    # (O'Kelly et al., "F1TENTH: An Open-source Evaluation Environment for Continuous Control and Reinforcement
    # Learning", PMLR 123, 2020: the simulation's default parameters); rolling resistance of rubber on asphalt.
    return RoverFrame(
        name="rover",
        skid=False,
        mass_kg=3.74,
        length_m=0.58,
        width_m=0.31,
        height_m=0.20,
        wheelbase_m=0.3302,
        track_m=0.25,
        effective_track_m=0.25,
        steering_max=0.4189,
        steering_rate=3.2,
        free_speed=20.0,
        stall_accel=9.51,
        motor_tau_s=0.05,
        friction=1.0489,
        rolling=0.015,
        scrub=0.0,
        drag_area_m2=0.03,
        idle_current_a=0.5,
        stall_current_a=60.0,
        pack=Pack(cells=3, capacity_mah=3300.0, resistance_ohm=0.02, full_v=12.6),
    )


def _ugv() -> RoverFrame:
    # A four-wheeled all-terrain UGV that carries a 1 m pad: size, mass, axes and top speed of Clearpath's Warthog (its
    # data sheet); an effective track of 1.5 times the real one, as Mandow et al. measured on such wheels.
    return RoverFrame(
        name="rover-skid",
        skid=True,
        mass_kg=280.0,
        length_m=1.52,
        width_m=1.38,
        height_m=0.83,
        wheelbase_m=0.9144,
        track_m=1.13,
        effective_track_m=1.70,
        steering_max=0.0,
        steering_rate=0.0,
        free_speed=5.0,
        stall_accel=5.0,
        motor_tau_s=0.10,
        friction=0.8,
        rolling=0.03,
        scrub=0.05,
        drag_area_m2=1.1,
        idle_current_a=2.0,
        stall_current_a=200.0,
        pack=Pack(cells=13, capacity_mah=105000.0, resistance_ohm=0.03, full_v=54.6),
    )


def rover_frame(name: str) -> RoverFrame:
    """The frame of that name; :class:`BadConfig` names the known ones."""
    makers = {"rover": _car, "rover-skid": _ugv}
    if name not in makers:
        expected = ", ".join(makers)
        raise BadConfig(f"no rover {name!r}; known: {expected}", field="airframe", value=name, expected=expected)
    return makers[name]()
