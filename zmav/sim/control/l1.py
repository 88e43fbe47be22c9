"""L1 guidance of N planes: the sideways acceleration that brings a plane onto a line, a circle or a heading.

Sources: Park, Deyst, How, "A New Nonlinear Guidance Logic for Trajectory Tracking", AIAA 2004-4900: steer to a point
at the distance L1 ahead on the path, with the acceleration K V^2 sin(eta) / L1; and the autopilot's own documents on
NAVL1_PERIOD and NAVL1_DAMPING (ardupilot.org, "Navigation Tuning"): with a period T and a damping z,

    L1 = z T V / pi,  K = 4 z^2

Circles are held by a second-order law of the same period in the distance from the circle, on top of the centripetal
acceleration; from outside a circle is approached by steering to its centre until both laws agree.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from zmav.rotation import wrap
from zmav.sim.arrays import Array, Flags, any_of, clamp
from zmav.sim.control.planetargets import CIRCLE, HEADING, LINE, PlaneTargets

CAPTURE = math.sqrt(0.5)  # sine of the angle that a line far away is flown to at
PASSED_S = 3.0  # after so much flight beyond its end a line is given up for the end itself
CONVERGING = math.radians(5.0)  # the integrator works below this angle to the line
INTEGRAL_MOST = 0.1  # rad
INDECISION = 0.9 * math.pi
RIGHT_ANGLE = 0.5 * math.pi
Index = NDArray[np.intp]


class L1:
    """What guidance makes of lines and circles: ``accel`` m/s^2 to the right, ``bearing`` (rad) it flies, ``error`` of
    the bearing, ``cross_track`` (m, left of the line or outside of the circle), ``circling``.
    """

    def __init__(self, targets: PlaneTargets) -> None:
        n = targets.lateral.shape[0]
        self._t = targets
        self.accel: Array = np.zeros(n)
        self.bearing: Array = np.zeros(n)
        self.error: Array = np.zeros(n)
        self.cross_track: Array = np.zeros(n)
        self.distance: Array = np.full(n, 1.0)  # L1, m
        self.circling: Flags = np.zeros(n, dtype=bool)
        self._integral: Array = np.zeros(n)
        self._last: Array = np.zeros(n)

    def update(self, pos: Array, vel: Array, yaw: Array, dt: float) -> None:
        """From ``pos`` (3, N) m and ``vel`` (3, N) m/s over the ground and ``yaw`` (N,)."""
        t = self._t
        speed = np.sqrt(vel[0] * vel[0] + vel[1] * vel[1])
        g = t.gains
        self.distance = np.maximum(g["NAVL1_DAMPING"] * g["NAVL1_PERIOD"] * speed * (1.0 / math.pi), 0.1)
        kinds = ((LINE, self._line), (CIRCLE, self._circle), (HEADING, self._heading))
        for kind, law in kinds:
            those = t.lateral == kind
            if any_of(those):
                index = np.flatnonzero(those)
                law(index, pos[:2, index], vel[:2, index], yaw[index], dt)
        others = t.lateral < LINE
        self._integral[others] = 0.0
        self.circling[others] = False

    def _decide(self, index: Index, eta: Array, bearing: Array, yaw: Array) -> Array:
        """Who flies away from where it wants to keeps the side to turn to that it chose."""
        last = self._last[index]
        away = np.abs(wrap(bearing - yaw)) > 2.0 / 3.0 * math.pi
        stuck = (np.abs(eta) > INDECISION) & (np.abs(last) > INDECISION) & away & (eta * last < 0.0)
        chosen = np.where(stuck, last, eta)
        self._last[index] = chosen
        result: Array = clamp(chosen, -RIGHT_ANGLE, RIGHT_ANGLE)
        return result

    def _line(self, index: Index, pos: Array, vel: Array, yaw: Array, dt: float) -> None:
        t, g = self._t, self._t.gains
        start, end = t.start[:, index], t.end[:, index]
        speed = np.hypot(vel[0], vel[1])
        nose = np.array([np.cos(yaw), np.sin(yaw)])
        # Backwards or standing, the nose says where it goes.
        backward = (speed < 0.1) | (vel[0] * nose[0] + vel[1] * nose[1] < 0.0)
        vel, speed = np.where(backward, 0.1 * nose, vel), np.where(backward, 0.1, speed)
        line = end - start
        length = np.hypot(line[0], line[1])
        direct = end - pos
        far = np.hypot(direct[0], direct[1])
        along = np.where(length > 1e-3, line / np.maximum(length, 1e-3), direct / np.maximum(far, 1e-3))
        off = pos - start
        cross = _cross(off, along)  # how far it is to the left of the line
        gone = off[0] * along[0] + off[1] * along[1]
        ahead = self.distance[index]
        # The usual: to a point ahead on the line, converging where that is near.
        angle = np.arcsin(clamp(cross / ahead, -CAPTURE, CAPTURE))
        gain = g["NAVL1_XTRACK_I"][index]
        grown = clamp(
            self._integral[index] + angle * gain * dt * (np.abs(angle) < CONVERGING), -INTEGRAL_MOST, INTEGRAL_MOST
        )
        self._integral[index] = np.where(gain > 0.0, grown, 0.0)
        angle = angle + self._integral[index]
        heading = np.arctan2(along[1], along[0]) + angle
        # Behind the line's start it flies there first; beyond its end, back to it.
        away = np.hypot(off[0], off[1])
        before = (away > ahead) & (gone < -CAPTURE * np.maximum(away, 1.0))
        beyond = ~before & (gone > length + PASSED_S * speed)
        heading = np.where(before, np.arctan2(-off[1], -off[0]), heading)
        heading = np.where(beyond, np.arctan2(direct[1], direct[0]), heading)
        eta = self._decide(index, wrap(heading - np.arctan2(vel[1], vel[0])), np.arctan2(direct[1], direct[0]), yaw)
        self.accel[index] = 4.0 * g["NAVL1_DAMPING"][index] ** 2 * speed * speed / ahead * np.sin(eta)
        self.bearing[index], self.error[index], self.cross_track[index] = wrap(heading), eta, cross
        self.circling[index] = False

    def _circle(self, index: Index, pos: Array, vel: Array, yaw: Array, dt: float) -> None:
        t, g = self._t, self._t.gains
        off = pos - t.end[:, index]
        radius, way = np.abs(t.radius[index]), np.where(t.radius[index] < 0.0, -1.0, 1.0)
        speed = np.maximum(np.hypot(vel[0], vel[1]), 1.0)
        away = np.hypot(off[0], off[1])
        out = np.where(away > 0.1, off / np.maximum(away, 0.1), vel / speed)
        damping, period = g["NAVL1_DAMPING"][index], g["NAVL1_PERIOD"][index]
        ahead = np.maximum(damping * period * speed * (1.0 / math.pi), 0.1)
        toward = -(vel[0] * out[0] + vel[1] * out[1])
        around = _cross(out, vel)
        bearing = np.arctan2(-out[1], -out[0])
        eta = self._decide(index, np.arctan2(around, toward), bearing, yaw)
        capture = 4.0 * damping**2 * speed * speed / ahead * np.sin(eta)
        omega = 2.0 * math.pi / period
        beyond = away - radius
        hold = beyond * omega * omega - toward * 2.0 * damping * omega
        tangent = around * way
        # Flying the wrong way round, inward is no help.
        hold = np.where((toward < 0.0) & (tangent < 0.0), np.maximum(hold, 0.0), hold)
        circle = way * (hold + tangent * tangent / np.maximum(np.maximum(0.5 * radius, away), 1.0))
        approaching = (beyond > 0.0) & (way * capture < way * circle)
        self.circling[index] |= ~approaching
        self.circling[index] &= ~approaching | (beyond < radius)
        self.accel[index] = np.where(approaching, capture, circle)
        self.bearing[index], self.cross_track[index] = bearing, beyond
        self.error[index] = np.where(approaching, eta, 0.0)
        self._integral[index] = 0.0

    def _heading(self, index: Index, pos: Array, vel: Array, yaw: Array, dt: float) -> None:
        t = self._t
        speed = np.hypot(vel[0], vel[1])
        eta = wrap(t.heading[index] - yaw)
        omega = math.sqrt(2.0) * math.pi / t.gains["NAVL1_PERIOD"][index]
        self.accel[index] = 2.0 * np.sin(clamp(eta, -RIGHT_ANGLE, RIGHT_ANGLE)) * speed * omega
        self.bearing[index], self.error[index] = wrap(t.heading[index]), eta
        self.cross_track[index] = self._integral[index] = 0.0
        self.circling[index] = False


def _cross(a: Array, b: Array) -> Array:
    """Third component of the product of horizontal vectors (2, N): positive where ``b`` is to the right of ``a``."""
    result: Array = a[0] * b[1] - a[1] * b[0]
    return result
