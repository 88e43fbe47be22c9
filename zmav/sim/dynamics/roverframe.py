"""What a rover is made of: masses, wheels, motors, tyres. Data only; the equations are in
:mod:`zmav.sim.dynamics.rover`.
"""

from __future__ import annotations

import msgspec

from zmav.sim.dynamics.battery import Pack


class RoverFrame(msgspec.Struct, frozen=True, kw_only=True):
    """A rover's constants (SI units, body axes forward-right-down)."""

    name: str
    mass_kg: float
    length_m: float
    width_m: float
    height_m: float
    wheelbase_m: float
    track_m: float
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
    drag_area_m2: float
    idle_current_a: float
    stall_current_a: float
    pack: Pack


# A 1/10 racing car: mass, wheelbase, steering, tyres, top speed and acceleration of the F1TENTH vehicle
# (O'Kelly et al., "F1TENTH: An Open-source Evaluation Environment for Continuous Control and Reinforcement
# Learning", PMLR 123, 2020: the simulation's default parameters); rolling resistance of rubber on asphalt.
CAR = RoverFrame(
    name="rover",
    mass_kg=3.74,
    length_m=0.58,
    width_m=0.31,
    height_m=0.20,
    wheelbase_m=0.3302,
    track_m=0.25,
    steering_max=0.4189,
    steering_rate=3.2,
    free_speed=20.0,
    stall_accel=9.51,
    motor_tau_s=0.05,
    friction=1.0489,
    rolling=0.015,
    drag_area_m2=0.03,
    idle_current_a=0.5,
    stall_current_a=60.0,
    pack=Pack(cells=3, capacity_mah=3300.0, resistance_ohm=0.02, full_v=12.6),
)
