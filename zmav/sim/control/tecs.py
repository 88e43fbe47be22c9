"""Total energy control of N planes: throttle for the sum of potential and kinetic energy, pitch for their balance.

Source: Lambregts, "Vertical Flight Path and Speed Control Autopilot Design Using Total Energy Principles", AIAA
83-2239. Parameters and their meaning as ArduPilot's TECS has them (ardupilot.org, "TECS (Total Energy Control System)
for Speed and Height Tuning Guide"). All energies are specific, m^2/s^2:

    E_T = g h + V^2 / 2,   E_B = w_h g h - w_s V^2 / 2
    throttle = trim + (dE_T/dt wanted) / k + (E_T missing + damping * dE_T/dt missing) / (k T) + integral
    pitch = (dE_B/dt wanted + damping * dE_B/dt missing + integral) / (g V)

where k is what full throttle adds to dE_T/dt: g (TECS_CLMB_MAX + TECS_SINK_MIN).
"""

from __future__ import annotations

import math

import numpy as np

from zmav.sim.arrays import Array, Flags, any_of, clamp
from zmav.sim.control.planetargets import ENERGY, FLARE, LAND, TAKEOFF, PlaneTargets
from zmav.sim.dynamics.airframe import GRAVITY

SLOWEST = 3.0  # m/s: of the airspeed that is reckoned with
UNDERSPEED, RECOVERED = 0.9, 1.15  # of the lowest airspeed
UNDERSPEED_S = 3.0
BAD_DESCENT = 200.0  # m^2/s^2 missing
RATE_FILTER_S = 0.5  # of the missing energy rate
MARGIN = math.radians(5.0)  # beyond the pitch limits, for the integrator
THROTTLE_MARGIN = 0.1
LIGHT, HEAVY = 0.5, 0.9  # shares of the energy rates that speeding up and slowing down may take


class Tecs:
    """What comes out: ``pitch`` (rad), ``throttle`` (0 to 1); ``speed_error`` (m/s, true airspeed)."""

    def __init__(self, targets: PlaneTargets) -> None:
        n = targets.lateral.shape[0]
        self._t = targets
        self.pitch: Array = np.zeros(n)
        self.throttle: Array = np.zeros(n)
        self.speed: Array = np.full(n, SLOWEST)  # filtered true airspeed
        self.underspeed: Flags = np.zeros(n, dtype=bool)
        self.speed_wanted: Array = np.zeros(n)
        self._speed_bias: Array = np.zeros(n)
        self._gain: Array = np.zeros(n)  # of speed, m/s^2, and its slow part
        self._gain_slow: Array = np.zeros(n)
        self._wanted_slow: Array = np.zeros(n)
        self._height_limited: Array = np.zeros(n)
        self._height_slow: Array = np.zeros(n)
        self.height_wanted: Array = np.zeros(n)
        self._missing_rate: Array = np.zeros(n)
        self._throttle_i: Array = np.zeros(n)
        self._throttle_last: Array = np.zeros(n)
        self._balance_i: Array = np.zeros(n)
        self._kinetic_i: Array = np.zeros(n)
        self._slow_since: Array = np.full(n, math.inf)
        self._bad_descent: Flags = np.zeros(n, dtype=bool)
        self._running: Flags = np.zeros(n, dtype=bool)
        self._climbing: Flags = np.zeros(n, dtype=bool)  # the take-off's first, full power has done its work
        self._flare_from: Array = np.zeros(n)
        self._flare_sink: Array = np.zeros(n)
        self._flare_pitch: Array = np.zeros(n)
        self._flaring: Flags = np.zeros(n, dtype=bool)

    @property
    def speed_error(self) -> Array:
        """Wanted minus actual."""
        return self.speed_wanted - self.speed

    def sense(self, airspeed: Array, gain: Array, dt: float) -> None:
        """Follow the measured true airspeed and its rate of change along the path (m/s^2) with a complementary filter
        of second order (TECS_SPD_OMEGA).
        """
        t = self._t
        omega = t.gains["TECS_SPD_OMEGA"]
        self._gain = gain
        keep = dt / (dt + t.gains["TECS_TIME_CONST"])
        self._gain_slow += (gain - self._gain_slow) * keep
        miss = airspeed - self.speed
        self._speed_bias += miss * omega * omega * dt
        self.speed = np.maximum(self.speed + (self._speed_bias + gain + miss * omega * math.sqrt(2.0)) * dt, SLOWEST)
        fresh = ~self._running
        if any_of(fresh):
            self.speed[fresh] = np.maximum(airspeed[fresh], SLOWEST)
            self._speed_bias[fresh] = 0.0

    def update(
        self, height: Array, climb: Array, pitch: Array, roll: Array, load: Array, eas2tas: float, dt: float
    ) -> None:
        """``height`` m over the world's origin, ``climb`` m/s, attitude (rad), ``load`` factor of the bank; (N,)."""
        t = self._t
        on = t.upright == ENERGY
        landing = (t.stage == LAND) | (t.stage == FLARE)
        takeoff = t.stage == TAKEOFF
        self._begin(on, height, pitch)
        if not any_of(on):
            return
        low, high = self._speeds(load, eas2tas)
        self._want_speed(low, high, eas2tas, dt)
        rate = self._want_height(height, climb, takeoff, landing, dt)
        self._watch(low, height, takeoff, dt)
        g = t.gains
        constant = np.where(landing, g["TECS_LAND_TCONST"], g["TECS_TIME_CONST"])
        potential, kinetic = GRAVITY * height, 0.5 * self.speed * self.speed
        more_potential = GRAVITY * self.height_wanted - potential
        more_kinetic = 0.5 * self.speed_wanted * self.speed_wanted - kinetic
        kinetic_rate_wanted = self.speed * (self._speed_rate - self._wanted_slow)
        kinetic_rate = self.speed * (self._gain - self._gain_slow)
        self._push(
            more_potential, more_kinetic, climb, kinetic_rate_wanted, kinetic_rate, constant, (low, high), roll, dt
        )
        self._balance(potential, kinetic, rate, climb, kinetic_rate, constant, height, dt)

    def _begin(self, on: Flags, height: Array, pitch: Array) -> None:
        """Who was not flown by energy so far starts from where it is."""
        fresh = on & ~self._running
        self._running = on
        if not any_of(fresh):
            return
        t = self._t
        for state in (self._height_limited, self._height_slow, self.height_wanted):
            state[fresh] = height[fresh]
        self.speed_wanted[fresh] = self.speed[fresh]
        for state in (self._throttle_i, self._balance_i, self._kinetic_i, self._missing_rate, self._wanted_slow):
            state[fresh] = 0.0
        self._throttle_last[fresh] = t.gains["TRIM_THROTTLE"][fresh] * 0.01
        self.pitch[fresh] = pitch[fresh]
        self.underspeed[fresh] = self._bad_descent[fresh] = self._climbing[fresh] = False

    def _speeds(self, load: Array, eas2tas: float) -> tuple[Array, Array]:
        """The lowest and the highest true airspeed now; in a bank the lowest is higher, so that it does not stall."""
        g = self._t.gains
        low = g["AIRSPEED_MIN"] * np.where(g["STALL_PREVENTION"] > 0.0, np.sqrt(load), 1.0) * eas2tas
        return low, np.maximum(g["AIRSPEED_MAX"] * eas2tas, low)

    def _want_speed(self, low: Array, high: Array, eas2tas: float, dt: float) -> None:
        t, g = self._t, self._t.gains
        goal = np.where(self.underspeed | self._bad_descent, low, clamp(t.airspeed * eas2tas, low, high))
        faster = LIGHT * GRAVITY * g["TECS_CLMB_MAX"] / self.speed
        slower = HEAVY * GRAVITY * g["TECS_SINK_MIN"] / self.speed
        step = clamp(goal - self.speed_wanted, -slower * dt, faster * dt)
        takeoff = t.stage == TAKEOFF
        step = np.where(takeoff, goal - self.speed_wanted, step)
        self._speed_rate = np.where(takeoff, 0.0, step / dt)
        self.speed_wanted = clamp(self.speed_wanted + step, low, high)
        self._wanted_slow += (self._speed_rate - self._wanted_slow) * (dt / (dt + g["TECS_TIME_CONST"]))

    def _want_height(self, height: Array, climb: Array, takeoff: Flags, landing: Flags, dt: float) -> Array:
        """The height on its way to the target: as fast as allowed, and through a lag; gives its rate, m/s."""
        t, g = self._t, self._t.gains
        flare = t.stage == FLARE
        # Where throttle or pitch is at its end there is no use in asking for more.
        full = (self.throttle >= t.throttle_max - 1e-3) & (self.speed < self.speed_wanted)
        up = np.where(
            full & ~takeoff & ~landing, np.minimum(g["TECS_CLMB_MAX"], np.maximum(climb, 0.0) + 1.0), g["TECS_CLMB_MAX"]
        )
        before = self._height_limited
        self._height_limited = before + clamp(t.height - before, -g["TECS_SINK_MAX"] * dt, up * dt)
        lag = g["TECS_HDEM_TCONST"]
        rate = (self._height_limited - self._height_slow) / np.maximum(lag, dt)
        self._height_slow = self._height_slow + rate * np.minimum(dt, lag)
        # On a glide slope the lag is made up for.
        self.height_wanted = np.where(landing, self._height_limited, self._height_slow)
        if any_of(takeoff):
            self._height_limited[takeoff] = self.height_wanted[takeoff] = height[takeoff]
            self._height_slow[takeoff] = height[takeoff]
            rate[takeoff] = 0.0
        if any_of(flare):
            rate = self._flare(flare, height, climb, rate, dt)
        else:
            self._flaring[:] = False
        return rate

    def _flare(self, flare: Flags, height: Array, climb: Array, rate: Array, dt: float) -> Array:
        """The sink rate goes down with the height, to TECS_LAND_SINK over the ground."""
        t, g = self._t, self._t.gains
        above = np.maximum(height - t.ground_height, 0.0)
        fresh = flare & ~self._flaring
        self._flare_from[fresh] = np.maximum(above[fresh], 0.5)
        self._flare_sink[fresh], self._flare_pitch[fresh] = climb[fresh], self.pitch[fresh]
        self._flaring = flare.copy()
        done = clamp(1.0 - above / np.maximum(self._flare_from, 0.5), 0.0, 1.0)
        sink = self._flare_sink * (1.0 - done) - g["TECS_LAND_SINK"] * done
        self._done = done
        self.height_wanted = np.where(flare, height + sink * dt, self.height_wanted)
        self._height_limited = np.where(flare, height, self._height_limited)
        self._height_slow = np.where(flare, height, self._height_slow)
        result: Array = np.where(flare, sink, rate)
        return result

    def _watch(self, low: Array, height: Array, takeoff: Flags, dt: float) -> None:
        """Too slow at full power, for three seconds at least: speed comes before height."""
        t = self._t
        slow = self.speed < UNDERSPEED * low
        straining = self.throttle >= 0.95 * t.throttle_max
        starts = slow & straining & (t.stage != FLARE) & ~takeoff
        self._slow_since = np.where(slow, 0.0, self._slow_since + dt)
        over = (self.speed >= RECOVERED * low) & (self._slow_since > UNDERSPEED_S)
        stays = self.underspeed & (height < self.height_wanted) & ~over
        self.underspeed = starts | (stays & ~takeoff)

    def _push(
        self,
        more_potential: Array,
        more_kinetic: Array,
        climb: Array,
        kinetic_rate_wanted: Array,
        kinetic_rate: Array,
        constant: Array,
        speeds: tuple[Array, Array],
        roll: Array,
        dt: float,
    ) -> None:
        """The throttle, for the total."""
        t, g = self._t, self._t.gains
        low, high = speeds
        kinetic = 0.5 * self.speed * self.speed
        # A height error counts no more than what speed could be given away or taken up for it.
        most = np.maximum(kinetic - 0.5 * low * low, 0.0)
        least = np.minimum(kinetic - 0.5 * high * high, 0.0)
        missing = clamp(more_potential, least, most) + more_kinetic
        up, down = GRAVITY * g["TECS_CLMB_MAX"], -GRAVITY * g["TECS_SINK_MIN"]
        wanted = clamp(more_potential / constant + kinetic_rate_wanted, down, up)
        missing_rate = wanted - GRAVITY * climb - kinetic_rate
        self._missing_rate += (missing_rate - self._missing_rate) * min(dt / RATE_FILTER_S, 1.0)
        self._bad_descent = (
            (missing > BAD_DESCENT) & (GRAVITY * climb + kinetic_rate < 0.0) & (self.throttle >= 0.9 * t.throttle_max)
        ) | (self._bad_descent & (missing > 0.0))
        power = (up - down) / np.maximum(t.throttle_max - np.maximum(t.throttle_min, 0.0), 0.01)
        turning = g["TECS_RLL2THR"] * (1.0 / clamp(np.cos(roll) ** 2, 0.1, 1.0) - 1.0)
        trim = g["TRIM_THROTTLE"] * 0.01 + (wanted + turning) / power
        throttle = (missing + self._missing_rate * g["TECS_THR_DAMP"]) / (constant * power) + trim
        takeoff = t.stage == TAKEOFF
        half = 0.5 * (t.throttle_max - t.throttle_min)
        grown = self._throttle_i + missing * g["TECS_INTEG_GAIN"] * dt / (constant * power)
        ceiling = clamp(t.throttle_max - throttle + THROTTLE_MARGIN, -half, half)
        floor = clamp(t.throttle_min - throttle - THROTTLE_MARGIN, -half, half)
        self._throttle_i = np.where(takeoff, self._throttle_i, clamp(grown, floor, ceiling))
        slew = np.where(g["THR_SLEWRATE"] > 0.0, g["THR_SLEWRATE"] * 0.01 * dt, 1.0)
        throttle = clamp(throttle, self._throttle_last - slew, self._throttle_last + slew)
        self._throttle_last = clamp(throttle, -0.5, 1.5)
        self.throttle = clamp(throttle + self._throttle_i, t.throttle_min, t.throttle_max)
        self.throttle = np.where(self.underspeed, t.throttle_max, self.throttle)

    def _balance(
        self,
        potential: Array,
        kinetic: Array,
        rate: Array,
        climb: Array,
        kinetic_rate: Array,
        constant: Array,
        height: Array,
        dt: float,
    ) -> None:
        """The pitch, for the difference."""
        t, g = self._t, self._t.gains
        takeoff, flare, landing = t.stage == TAKEOFF, t.stage == FLARE, t.stage >= LAND
        speed_weight = np.where(self.underspeed | takeoff, 2.0, g["TECS_SPDWEIGHT"])
        speed_weight = np.where(flare, 0.0, speed_weight)
        height_weight = np.minimum(2.0 - speed_weight, 1.0)
        speed_weight = np.minimum(speed_weight, 1.0)
        wanted = height_weight * GRAVITY * self.height_wanted - speed_weight * 0.5 * self.speed_wanted**2
        error = wanted - (height_weight * potential - speed_weight * kinetic)
        push = clamp(
            rate * GRAVITY * height_weight + error / constant,
            -GRAVITY * g["TECS_SINK_MAX"],
            GRAVITY * g["TECS_CLMB_MAX"],
        )
        missing = push - (GRAVITY * climb * height_weight - kinetic_rate * speed_weight)
        damping = np.where(flare, g["TECS_LAND_DAMP"], g["TECS_PTCH_DAMP"])
        total = push + missing * damping
        per_rad = self.speed * GRAVITY
        low, high = self._pitch_limits(flare, landing)
        total = np.where(takeoff, total + low * per_rad, total)
        unlimited = (total + self._balance_i + self._kinetic_i) / per_rad
        grows = missing * g["TECS_INTEG_GAIN"] * dt
        held = ((unlimited > high) & (grows > 0.0)) | ((unlimited < low) & (grows < 0.0)) | takeoff
        fading = 1.0 - dt / (dt + constant)
        more_kinetic = (kinetic - 0.5 * self.speed_wanted**2) * speed_weight * dt / constant
        self._balance_i = np.where(held, self._balance_i * fading, self._balance_i + grows)
        self._kinetic_i = np.where(held, self._kinetic_i * fading, self._kinetic_i + more_kinetic)
        self._balance_i = clamp(self._balance_i, per_rad * (low - MARGIN) - total, per_rad * (high + MARGIN) - total)
        quarter = 0.25 * (high - low) * per_rad
        self._kinetic_i = clamp(self._kinetic_i, -quarter, quarter)
        pitch = clamp((total + self._balance_i + self._kinetic_i) / per_rad, low, high)
        step = dt * g["TECS_VERT_ACC"] / self.speed
        self.pitch = clamp(pitch, self.pitch - step, self.pitch + step)

    def _pitch_limits(self, flare: Flags, landing: Flags) -> tuple[Array, Array]:
        """Radians from and to; in the flare the nose comes up to LAND_PITCH_DEG by the time it touches down."""
        t, g = self._t, self._t.gains
        high = np.where(g["TECS_PITCH_MAX"] > 0.0, g["TECS_PITCH_MAX"], g["PTCH_LIM_MAX_DEG"])
        low, high = np.radians(g["PTCH_LIM_MIN_DEG"]), np.radians(high)
        low, high = np.maximum(low, t.pitch_min), np.minimum(high, t.pitch_max)
        if any_of(flare):
            up = self._flare_pitch * (1.0 - self._done) + np.radians(g["LAND_PITCH_DEG"]) * self._done
            low = np.where(flare, np.maximum(low, np.minimum(up, high)), low)
            most = np.where(g["TECS_LAND_PMAX"] > 0.0, np.radians(g["TECS_LAND_PMAX"]), high)
            high = np.where(flare, np.maximum(most, low), high)
        return np.minimum(low, high), high
