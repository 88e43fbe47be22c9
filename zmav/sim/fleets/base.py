"""What the world steps: all vehicles of one airframe, with their physics, sensors, estimates and controllers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import msgspec
import numpy as np

from zmav.sim.dynamics.battery import Battery, BatteryHandle, Pack
from zmav.sim.dynamics.body import Body
from zmav.sim.environment import Environment, Vector
from zmav.sim.geo import Position
from zmav.sim.sensors.estimate import Belief, Estimator
from zmav.sim.sensors.noise import noise_profile
from zmav.sim.sensors.readings import Readings
from zmav.sim.sensors.suite import SensorSuite

DEFAULT_PLACE = Position(-35.363261, 149.165230, 584.09)


class Surroundings(msgspec.Struct, frozen=True, kw_only=True):
    """What a fleet finds itself in.

    ``environment``: ground and air; ``place``: where the origin of the world's NED lies; ``seed``: of this fleet;
    ``noise``: of the sensors, a name of :data:`zmav.sim.sensors.noise.PROFILES`; ``gps_noise_m``: standard deviation of
    a wandering GPS error per axis, beside that.
    """

    environment: Environment
    place: Position = DEFAULT_PLACE
    seed: tuple[int, ...] = (0,)
    noise: str = "none"
    gps_noise_m: float = 0.0

    def generator(self, name: str) -> np.random.Generator:
        """Random numbers for one purpose of this fleet: drawing more of them changes nothing for the others."""
        return np.random.default_rng([*self.seed, *name.encode("ascii")])


class Sense(NamedTuple):
    """What one autopilot knows at a tick: metres, m/s NED of the world; radians; m/s^2 body; fractions."""

    north: float
    east: float
    down: float
    vn: float
    ve: float
    vd: float
    roll: float
    pitch: float
    yaw: float
    p: float
    q: float
    r: float
    fx: float
    fy: float
    fz: float
    qw: float
    qx: float
    qy: float
    qz: float
    ref_vn: float  # velocity the reference asks for
    ref_ve: float
    want_qw: float  # attitude asked for
    want_qx: float
    want_qy: float
    want_qz: float
    want_yaw: float
    throttle: float  # mean of the rotors, 0..1
    current_a: float
    contact: float  # 1 on the ground
    impact: float  # down speed of a touch since the last tick, m/s
    airspeed: float  # m/s, true
    volts: float  # of the battery
    true_north: float
    true_east: float
    true_down: float


class Fleet(ABC):
    """N vehicles of one airframe; the order of vehicles is that of the columns of every array.

    ``advance`` of a subclass calls :meth:`blow` first, ``estimate.refresh()`` after each step of the physics, and at
    the end of the tick ``estimate.observe(dt)`` and ``battery.step(current, dt)``; its controllers see ``estimate`` and
    never the truth.
    """

    dynamics: Body

    def __init__(self, dynamics: Body, around: Surroundings, pack: Pack | None = None) -> None:
        self.dynamics = dynamics
        self.around = around
        self.dynamics.wind[:] = np.array(around.environment.wind)[:, None]
        self.air = around.environment.air(dynamics.n, around.generator("air"), dynamics.dt)
        self.battery = Battery(pack or Pack(), dynamics.n)
        noise = noise_profile(around.noise)
        self.sensors = SensorSuite(dynamics, around.place, around.seed, noise, around.gps_noise_m)
        self.estimate = Estimator(dynamics, self.sensors, around.seed)

    def blow(self, dt: float) -> None:
        """Let the wind of the next ``dt`` seconds blow; where there is only a mean one nothing changes."""
        if not self.air.calm:
            self.air.dt = dt
            self.dynamics.wind[:] = self.air.step(self.dynamics.pos, self.dynamics.vel)

    @abstractmethod
    def advance(self, steps: int) -> None:
        """One tick: ``steps`` steps of controllers and physics, then the sensors."""

    @abstractmethod
    def senses(self) -> list[Sense]:
        """One row of plain floats per vehicle; a touch of the ground is reported once."""

    @abstractmethod
    def outputs(self, index: int) -> list[float]:
        """What one vehicle's actuators are told: rotors and throttles 0 to 1, surfaces and steering -1 to 1."""

    def rotor_speeds(self, index: int) -> list[float]:
        """Of one vehicle's rotors, as shares of the highest; none where there are none."""
        return []

    def readings(self, index: int) -> Readings:
        """What one vehicle's sensors measure now."""
        return self.sensors.readings(index)

    def wind(self, index: int) -> Vector:
        """Of the air about one vehicle, m/s NED."""
        north, east, down = self.dynamics.wind[:, index].tolist()
        return north, east, down


class Seat:
    """One vehicle's place in its fleet."""

    def __init__(self, fleet: Fleet, index: int) -> None:
        self.fleet = fleet
        self.index = index

    def outputs(self) -> list[float]:
        return self.fleet.outputs(self.index)

    @property
    def battery(self) -> BatteryHandle:
        return BatteryHandle(self.fleet.battery, self.index)

    def rotor_speeds(self) -> list[float]:
        return self.fleet.rotor_speeds(self.index)

    def readings(self) -> Readings:
        return self.fleet.readings(self.index)

    def belief(self) -> Belief:
        """What its autopilot's navigation filter steers."""
        return self.fleet.estimate.belief(self.index)

    @property
    def vibration(self) -> float:
        """Of its accelerometers, m/s^2 root mean square."""
        return self.fleet.sensors.vibration(self.index)

    @property
    def wind(self) -> Vector:
        return self.fleet.wind(self.index)
