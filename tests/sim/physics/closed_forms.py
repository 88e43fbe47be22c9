"""What textbooks say of bodies and wings, for the physics to be held against."""

from __future__ import annotations

import math

import numpy as np

from zmav.sim.arrays import Array, dot
from zmav.sim.dynamics.airframe import AIR_DENSITY, GRAVITY
from zmav.sim.dynamics.copter import CopterDynamics
from zmav.sim.dynamics.plane import PlaneDynamics
from zmav.sim.dynamics.wing import Wing


def energy(dyn: CopterDynamics | PlaneDynamics, datum_down: float = 0.0) -> Array:
    """Kinetic and potential energy of each vehicle, J, (N,); potential is zero ``datum_down`` m below the origin."""
    frame = dyn.airframe if isinstance(dyn, CopterDynamics) else dyn.wing
    inertia = np.array(frame.inertia_kgm2)[:, None]
    moving = 0.5 * frame.mass_kg * dot(dyn.vel, dyn.vel) + 0.5 * (inertia * dyn.rate * dyn.rate).sum(0)
    result: Array = moving + frame.mass_kg * GRAVITY * (datum_down - dyn.pos[2])
    return result


def stall_speed(wing: Wing, load: float = 1.0) -> float:
    """The lowest speed of level flight at sea level, m/s, at a load factor."""
    most = float(wing.lift_drag(np.linspace(0.0, 2.0 * wing.stall_rad, 2001))[0].max())
    return math.sqrt(2.0 * load * wing.weight_n / (AIR_DENSITY * wing.area_m2 * most))


def glide(wing: Wing, speed: float) -> float:
    """Lift over drag in a shallow glide at a speed, m/s, at sea level."""
    need = wing.weight_n / (0.5 * AIR_DENSITY * speed**2 * wing.area_m2)
    return need / (wing.drag_0 + need**2 / (math.pi * wing.oswald * wing.aspect_ratio))
