"""A rover's controllers, vectorised: place or path -> velocity -> speed and turn rate -> throttle and steering.

Structure and gains after ArduRover's (ardupilot.org, "Rover: Tuning Speed and Throttle", "Tuning Turn Rate", "Tuning
Navigation"): a point moves along the path; its velocity plus what the position error asks for is the velocity wanted;
the acceleration that this takes sideways becomes a turn rate (``a / v``), its part ahead the speed. The speed is
driven by a feed-forward of CRUISE_THROTTLE at CRUISE_SPEED and a PI controller, the turn rate by a feed-forward and a
PI controller, within the lateral acceleration ATC_TURN_MAX_G.
"""

from __future__ import annotations

import math

import numpy as np

from zmav.rotation import wrap
from zmav.sim.arrays import Array, Flags, any_of, clamp, limit_length, yaw_of
from zmav.sim.control.cascade import Estimated
from zmav.sim.control.reference import root_speed
from zmav.sim.control.roversetpoints import COAST, DIRECT, HEADING, PATH, PLACE, STOP, TURN, RoverSetpoints

STEER_SPEED_MIN = 1.0  # m/s: what a lateral acceleration is divided by at least
TURN_RATE_MIN = math.radians(1.0)
STOPPED_FOR_S = 0.3  # a rover that has stopped is taken for stopped so long
PLACE_GAIN, SPEED_GAIN = 0.8, 3.0  # 1/s, of the moving point's way to a place
PLACE_DONE_M = 0.01
ASTERN = 0.05  # m/s^2


class Loop:
    """N controllers with a filtered error, an integrator with a limit, and a feed-forward, for a scalar each."""

    def __init__(self, tuning: dict[str, Array], name: str) -> None:
        self._k = {part: tuning[f"{name}_{part}"] for part in ("p", "i", "d", "ff", "imax", "filter")}
        n = len(self._k["p"])
        self._error: Array = np.zeros(n)
        self._sum: Array = np.zeros(n)
        self._fresh = np.ones(n, dtype=bool)

    def reset(self, which: Flags) -> None:
        self._sum[which] = 0.0
        self._fresh |= which

    def tune(self, dt: float) -> None:
        """Reckon what follows from the tuning; to be called after it changes."""
        cutoff = self._k["filter"]  # Hz, of a first-order low pass; 0: none
        self._share = np.where(cutoff > 0.0, 1.0 - np.exp(-2.0 * math.pi * np.maximum(cutoff, 1e-6) * dt), 1.0)

    def run(self, wanted: Array, actual: Array, saturated: Flags, dt: float) -> Array:
        """Output for this step; where it is ``saturated`` already the integrator only shrinks."""
        k, error = self._k, wanted - actual
        before = np.where(self._fresh, error, self._error)
        self._error = before + (error - before) * np.where(self._fresh, 1.0, self._share)
        self._fresh[:] = False
        grows = ~saturated | (self._sum * self._error < 0.0)
        self._sum = clamp(self._sum + self._error * k["i"] * (dt * grows), -k["imax"], k["imax"])
        slope = (self._error - before) / dt
        out: Array = self._error * k["p"] + self._sum + slope * k["d"] + wanted * k["ff"]
        return out


class RoverControl:
    """Controllers of N rovers; :meth:`update` sets ``steering`` and ``throttle`` (N,), -1 to 1.

    ``speed`` and ``turn`` (N,) are what is asked for now, after all limits; ``point`` (2, N) is the moving point.
    """

    def __init__(self, setpoints: RoverSetpoints, start: Array) -> None:
        n = start.shape[1]
        self.setpoints = setpoints
        self.steering: Array = np.zeros(n)
        self.throttle: Array = np.zeros(n)
        self.speed: Array = np.zeros(n)
        self.turn: Array = np.zeros(n)
        self.point: Array = start[:2].astype(float).copy()
        self.point_vel: Array = np.zeros((2, n))
        self.point_acc: Array = np.zeros((2, n))
        self._speed_loop = Loop(setpoints.tuning, "speed")
        self._turn_loop = Loop(setpoints.tuning, "turn")
        self.loops = self._speed_loop, self._turn_loop
        self._vel_error: Array = np.zeros((2, n))
        self._vel_sum: Array = np.zeros((2, n))
        self._on_path = np.zeros(n, dtype=bool)
        self._driven = np.zeros(n, dtype=bool)  # the speed was controlled in the last step
        self._steered = np.zeros(n, dtype=bool)
        self._stopped_for: Array = np.zeros(n)
        self._full_throttle = np.zeros(n, dtype=bool)
        self._full_lock = np.zeros(n, dtype=bool)
        self._tuned: tuple[int, float] | None = None

    def update(self, est: Estimated, dt: float) -> None:
        """One step of all loops."""
        sp = self.setpoints
        if self._tuned != (sp.tuned, dt):
            self._tune(dt)
        yaw = yaw_of(est.q)
        c, s = np.cos(yaw), np.sin(yaw)
        ahead = est.vel[0] * c + est.vel[1] * s
        task = np.where(sp.armed, sp.task, COAST)
        path = (task == PATH) | (task == PLACE)
        speed, turn = sp.speed.copy(), sp.turn.copy()
        if any_of(path):
            self._lead(task, path, est, dt)
            self._chase(path, est, c, s, ahead, speed, turn, dt)
        self._on_path = path
        heading = task == HEADING
        if any_of(heading):
            turn[heading] = self._toward(yaw)[heading]
        stop = task == STOP
        speed[stop] = turn[stop] = 0.0
        driven = path | heading | stop | (task == TURN)
        throttle = self._drive(driven, speed, ahead, dt)
        steered = driven & ~(stop & (self._stopped_for > 0.0))
        steering = self._steer(steered, turn, est.rate[2], ahead, dt)
        by_hand = task == DIRECT
        self.throttle = self._slew(np.where(by_hand, sp.throttle, throttle))
        self.steering = self._scale(np.where(by_hand, sp.steering, steering), driven, ahead)

    def _tune(self, dt: float) -> None:
        """Reckon what follows from the tuning alone; a limit of zero is none."""
        sp, k = self.setpoints, self.setpoints.tuning
        self._tuned = sp.tuned, dt
        self._speed_loop.tune(dt)
        self._turn_loop.tune(dt)
        self._vel_share = 1.0 - np.exp(-2.0 * math.pi * np.maximum(k["vel_filter"], 1e-3) * dt)
        self._turn_step = np.where(k["turn_accel"] > 0.0, k["turn_accel"] * dt, np.inf)
        self._turn_most = np.where(k["turn_max"] > 0.0, k["turn_max"], np.inf)
        self._cruise = np.where(
            k["cruise_speed"] > 0.0, k["cruise_throttle"] / np.maximum(k["cruise_speed"], 1e-3), 0.0
        )
        self._throttle_step = np.where(k["slew"] > 0.0, k["slew"] * dt, np.inf)
        self._throttle_most = clamp(k["throttle_max"], 0.05, 1.0)

    # ---- the moving point

    def _lead(self, task: Array, path: Flags, est: Estimated, dt: float) -> None:
        """The moving point: as given on a path; on the way to a place shaped by speed, acceleration and jerk."""
        sp = self.setpoints
        place = task == PLACE
        fresh = place & (sp.fresh | ~self._on_path)
        sp.fresh[:] = False
        if any_of(fresh):
            self.point[:, fresh] = est.pos[:2, fresh]
            self.point_vel[:, fresh] = est.vel[:2, fresh]
            self.point_acc[:, fresh] = 0.0
        if any_of(place):
            error = sp.pos - self.point
            distance = np.maximum(np.sqrt((error * error).sum(0)), 1e-9)
            pace = np.minimum(root_speed(distance, PLACE_GAIN, 0.5 * sp.accel_limit), sp.speed_limit)
            acc = limit_length((error * (pace / distance) - self.point_vel) * SPEED_GAIN, sp.accel_limit)
            acc = self.point_acc + limit_length(acc - self.point_acc, SPEED_GAIN * sp.jerk_limit * dt)
            vel = self.point_vel + acc * dt
            there = (distance < PLACE_DONE_M) & ((vel * vel).sum(0) < PLACE_DONE_M**2)
            acc, vel = acc * ~there, vel * ~there
            point = np.where(there, sp.pos, self.point + vel * dt)
            self.point = np.where(place, point, self.point)
            self.point_vel = np.where(place, vel, self.point_vel)
            self.point_acc = np.where(place, acc, self.point_acc)
        given = path & ~place
        if any_of(given):
            self.point = np.where(given, sp.pos, self.point)
            self.point_vel = np.where(given, sp.vel, self.point_vel)
            self.point_acc = np.where(given, sp.acc, self.point_acc)

    def _chase(
        self, path: Flags, est: Estimated, c: Array, s: Array, ahead: Array, speed: Array, turn: Array, dt: float
    ) -> None:
        """Speed and turn rate that keep to the moving point; written where ``path`` says."""
        sp, k = self.setpoints, self.setpoints.tuning
        wanted = limit_length(self.point_vel + (self.point - est.pos[:2]) * k["pos_p"], sp.speed_limit)
        stopping = (self.point_vel == 0.0).all(0)
        error = wanted - est.vel[:2]
        begins = path & ~self._on_path
        self._vel_error = np.where(begins, error, self._vel_error + (error - self._vel_error) * self._vel_share)
        self._vel_sum = np.where(begins, 0.0, self._vel_sum + self._vel_error * k["vel_i"] * dt)
        self._vel_sum = limit_length(self._vel_sum, k["vel_imax"])
        across = self._vel_sum[1] * c - self._vel_sum[0] * s  # what is ahead is the speed loop's
        self._vel_sum = np.stack([-s * across, c * across])
        acc = self._vel_error * k["vel_p"] + self._vel_sum + self.point_acc
        lateral = acc[1] * c - acc[0] * s
        forward = wanted[0] * c + wanted[1] * s
        # Exactly astern there is no side to turn to. Noise decides on a real rover; here, it is the right.
        astern = (forward < 0.0) & (np.abs(lateral) < ASTERN)
        lateral = np.where(stopping, 0.0, np.where(astern, ASTERN, lateral))
        # In a turn it goes no slower than it can take with half the lateral acceleration it may.
        least = np.sqrt(np.maximum(0.5 * k["lateral"] * k["turn_radius"], 0.0))
        least = np.minimum(np.sqrt((wanted * wanted).sum(0)), least) * ~stopping
        pace = np.where(stopping, forward, np.maximum(least, forward))
        pace = self._limited(pace, self._begun(ahead), dt)
        speed[path] = pace[path]
        turn[path] = (lateral / _divisor(pace))[path]

    # ---- turn rate

    def _toward(self, yaw: Array) -> Array:
        """Turn rate toward a heading: no faster than can be braked."""
        sp, k = self.setpoints, self.setpoints.tuning
        error = wrap(sp.heading - yaw)
        rate = error * k["angle_p"]
        brake = np.where(k["turn_decel"] > 0.0, k["turn_decel"], k["turn_accel"])
        most = np.where(brake > 0.0, np.sqrt(2.0 * np.abs(error) * np.maximum(brake, 0.0)), np.inf)
        return clamp(rate, -most, most)

    def _steer(self, steered: Flags, turn: Array, actual: Array, ahead: Array, dt: float) -> Array:
        """Steering that gives the turn rate."""
        k = self.setpoints.tuning
        begins = steered & ~self._steered
        self._steered = steered
        self._turn_loop.reset(begins)
        before = np.where(begins, actual, self.turn)
        turn = clamp(turn, before - self._turn_step, before + self._turn_step)
        by_grip = np.maximum(k["lateral"] / np.maximum(np.abs(ahead), STEER_SPEED_MIN), TURN_RATE_MIN)
        most = np.minimum(self._turn_most, by_grip)
        self.turn = clamp(turn, -most, most) * steered
        # Front wheels give no turn without speed: nothing is to be learnt then.
        saturated = self._full_lock | (np.abs(ahead) <= k["steer_base"])
        return self._turn_loop.run(self.turn, actual, saturated, dt) * steered

    def _scale(self, steering: Array, driven: Flags, ahead: Array) -> Array:
        """The wheels turn less the faster it goes, and the other way where it goes back."""
        base = self.setpoints.tuning["steer_base"]
        fast = driven & (base > 0.0) & (np.abs(ahead) > base)
        steering = steering * np.where(fast, base / np.maximum(np.abs(ahead), 1e-3), 1.0)
        steering = np.where(driven & (ahead < 0.0), -steering, steering)
        self._full_lock = np.abs(steering) >= 1.0
        return clamp(steering, -1.0, 1.0)

    # ---- speed

    def _begun(self, ahead: Array) -> Array:
        """The speed asked for so far; where none was, the one there is."""
        return np.where(self._driven, self.speed, ahead)

    def _limited(self, speed: Array, before: Array, dt: float) -> Array:
        """Within the acceleration allowed."""
        k = self.setpoints.tuning
        slower = (np.abs(speed) < np.abs(before)) & (k["decel"] > 0.0)
        step = np.where(slower, k["decel"], k["accel"]) * dt
        step = np.where((k["accel"] > 0.0) & self._driven, step, np.inf)
        return clamp(speed, before - step, before + step)

    def _drive(self, driven: Flags, speed: Array, ahead: Array, dt: float) -> Array:
        """Throttle that gives the speed; a stop ends with the motors still."""
        k = self.setpoints.tuning
        before = self._begun(ahead)
        wanted = self._limited(speed, before, dt)
        halts = driven & (speed == 0.0) & (wanted == 0.0)
        still = halts & ((np.abs(ahead) <= np.abs(k["stop_speed"])) | (self._stopped_for > 0.0))
        self._stopped_for = np.where(still, STOPPED_FOR_S, np.maximum(self._stopped_for - dt, 0.0) * halts)
        self._speed_loop.reset(still | (driven & ~self._driven))
        self._driven = driven
        self.speed = np.where(driven & ~still, wanted, 0.0)
        out = self._speed_loop.run(self.speed, ahead, self._full_throttle, dt) + self.speed * self._cruise
        # Without a brake the throttle never goes against the way wanted.
        coasts = (k["brake"] == 0.0) & (((self.speed >= 0.0) & (out < 0.0)) | ((self.speed <= 0.0) & (out > 0.0)))
        out = np.where(coasts, 0.0, out)
        self._full_throttle = coasts | (np.abs(out) >= 1.0)
        given: Array = out * (driven & ~still)
        return given

    def _slew(self, throttle: Array) -> Array:
        """Within the motors' limits, and no faster than MOT_SLEWRATE there."""
        step, most = self._throttle_step, self._throttle_most
        out = clamp(clamp(throttle, self.throttle - step, self.throttle + step), -most, most)
        return out * self.setpoints.armed


def _divisor(speed: Array) -> Array:
    """A speed to divide a lateral acceleration by: never near zero."""
    return np.where(speed < 0.0, np.minimum(speed, -STEER_SPEED_MIN), np.maximum(speed, STEER_SPEED_MIN))
