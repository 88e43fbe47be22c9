"""What the world steps: all vehicles of one airframe, with their physics, sensors, estimates and controllers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, NamedTuple

import msgspec
import numpy as np

from zmav.sim.air import density
from zmav.sim.arrays import Array
from zmav.sim.dynamics.battery import Battery, BatteryHandle, Pack
from zmav.sim.dynamics.body import Body
from zmav.sim.environment import Environment, Vector
from zmav.sim.fleets.still import Standstill
from zmav.sim.geo import Position
from zmav.sim.sensors.estimate import Belief, Estimator
from zmav.sim.sensors.noise import noise_profile
from zmav.sim.sensors.readings import GpsFix, Readings
from zmav.sim.sensors.suite import SensorSuite
from zmav.sim.sensors.troubles import Trouble

AIR_EVERY = 10  # ticks: the density of the air changes slowly
DEFAULT_PLACE = Position(-35.363261, 149.165230, 584.09)


class Surroundings(msgspec.Struct, frozen=True, kw_only=True):
    """What a fleet finds itself in.

    ``environment``: the air; ``place``: where the origin of the world's NED lies; ``seed``: of this fleet;
    ``noise``: of the sensors, a name of :data:`zmav.sim.sensors.noise.PROFILES`.
    """

    environment: Environment
    place: Position = DEFAULT_PLACE
    seed: tuple[int, ...] = (0,)
    noise: str = "none"


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


class Wanted(NamedTuple):
    """What the loops of one vehicle are asked for: m/s and m/s^2 NED, rad/s about the body's axes, and the share of
    the rotors' full thrust (None: there are none).
    """

    vel: Vector
    acc: Vector
    rate: Vector
    thrust: float | None = None


class Fleet(ABC):
    """N vehicles of one airframe; the order of vehicles is that of the columns of every array. ``dt``: seconds of a
    step of the physics. Controllers of a subclass see ``estimate`` and never the truth.
    """

    ACTUATORS: ClassVar[tuple[str, ...]] = ("throttle",)
    """the inputs of the dynamics, (..., N) each, which controllers set again each time they work"""

    THINKS_EVERY: ClassVar[int] = 1
    """ticks between two updates of its autopilots"""

    dynamics: Body

    def __init__(self, dynamics: Body, around: Surroundings, pack: Pack | None = None) -> None:
        self.dynamics = dynamics
        self.around = around
        self.pace = 1
        """ticks of the world for one at 100 Hz, by which slower loops are counted"""
        self.ticks = 0
        self.dynamics.wind[:] = np.array(around.environment.wind)[:, None]
        self.air = around.environment.air(dynamics.n, around.seed, dynamics.dt)
        self.battery = Battery(pack or Pack(), dynamics.n)
        noise = noise_profile(around.noise)
        self.sensors = SensorSuite(dynamics, around.place, around.seed, noise)
        self.estimate = Estimator(dynamics, self.sensors, around.seed)
        self._table: Array = np.zeros((len(Sense._fields), dynamics.n))
        self._still = Standstill()
        self._stands = False
        self._held: dict[int, dict[str, Array]] = {}  # of frozen autopilots: the last inputs of their bodies

    def blow(self, dt: float) -> None:
        """Let the wind of the next ``dt`` seconds blow; where there is only a mean one nothing changes."""
        if not self.air.calm:
            self.air.dt = dt
            self.dynamics.wind[:] = self.air.step(self.dynamics.pos, self.dynamics.vel)

    def advance(self, steps: int) -> None:
        """One tick: the controllers, ``steps`` steps of the physics, then the sensors."""
        dyn, tick = self.dynamics, steps * self.dynamics.dt
        self.blow(tick)
        self.control_tick(self.ticks, tick)
        self.ticks += 1
        stands = not self._held and self.stands()
        for _ in range(0 if stands else steps):
            self.control_step()
            self.overrule()
            dyn.step()
            self.estimate.refresh()
        self.estimate.observe(tick, moved=not stands)
        self.battery.step(dyn.current(), tick)

    def control_tick(self, number: int, tick_s: float) -> None:  # noqa: B027 - not every fleet has controllers
        """The controllers' part of tick ``number``, of ``tick_s`` seconds."""

    def control_step(self) -> None:  # noqa: B027 - nor loops as quick as that
        """Their part of each step of the physics."""

    def stands(self) -> bool:
        """A step of the physics would change nothing: nothing moves, and no actuator is asked to."""
        return self._stands

    def unchanged(self, numbers: tuple[float, ...], *loops: object) -> bool:
        """To be asked each time before controllers work, where all rest: neither these numbers and controllers, nor the
        bodies and what is sensed of them, differ from what they were. What is frozen, or sensed with errors that
        wander, counts as changed.
        """
        est = self.estimate
        return not self._held and est.exact and self._still.holds(numbers, self.dynamics, est, *loops)

    def thickness(self) -> Array:
        """Density of the air about each vehicle now, (N,), kg/m^3."""
        return density(self.around.place.alt_amsl_m - self.dynamics.pos[2])

    def senses(self) -> list[Sense]:
        """One row of plain floats per vehicle; a touch of the ground is reported once."""
        est, dyn, table = self.estimate, self.dynamics, self._table
        # In the order of Sense; what is missing here each kind of fleet adds in its own way.
        table[0:3] = est.pos
        table[3:6] = est.vel
        table[6:9] = est.euler
        table[9:12] = est.rate
        table[12:15] = est.force
        table[15:19] = est.q
        table[27] = self.battery.current
        table[28] = dyn.contact
        table[29] = dyn.impact
        table[31] = self.battery.volts
        table[32:35] = dyn.pos
        self.sense_more(table)
        dyn.impact[:] = 0.0
        return [Sense._make(row) for row in table.T.tolist()]

    def sense_more(self, table: Array) -> None:  # noqa: B027 - a fleet may have senses of its own
        """Fill in the rows of :class:`Sense` that this kind has in its own way, 19 to 26 and 30: velocity, attitude,
        heading and throttle that its controllers ask for, and the airspeed.
        """

    @abstractmethod
    def outputs(self, index: int) -> list[float]:
        """What one vehicle's actuators are told: rotors and throttles 0 to 1, surfaces and steering -1 to 1."""

    def rotor_speeds(self, index: int) -> list[float]:
        """Of one vehicle's rotors, as shares of the highest; none where there are none."""
        return []

    def wanted(self, index: int) -> Wanted:
        """What the loops of one vehicle are asked for now; nothing where there are no such loops."""
        still = (0.0, 0.0, 0.0)
        return Wanted(still, still, still)

    @property
    def efficiency(self) -> Array:
        """(motors, N): what each gives of its thrust, 0..1."""
        found: Array = getattr(self.dynamics, "efficiency", np.ones((0, self.dynamics.n)))
        return found

    def freeze(self, index: int, *, frozen: bool) -> None:
        """Hold the actuators of one vehicle where they are, whatever the controllers want, or no longer."""
        if frozen:
            inputs = {name: getattr(self.dynamics, name)[..., index].copy() for name in self.ACTUATORS}
            self._held.setdefault(index, inputs)
        else:
            self._held.pop(index, None)

    def overrule(self) -> None:
        """To be called between controllers and physics: what is frozen stays as it is."""
        if not self._held:
            return
        for name in self.ACTUATORS:
            inputs = getattr(self.dynamics, name).copy()
            for index, held in self._held.items():
                inputs[..., index] = held[name]
            setattr(self.dynamics, name, inputs)


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

    def wanted(self) -> Wanted:
        return self.fleet.wanted(self.index)

    def readings(self) -> Readings:
        """What its sensors measure now."""
        return self.fleet.sensors.readings(self.index)

    def trouble(self, cause: str, trouble: Trouble) -> None:
        """That is what ``cause`` does to its sensors from now on."""
        self.fleet.sensors.troubles.put(self.index, cause, trouble)

    @property
    def motors(self) -> int:
        """How many there are that can fail."""
        return len(self.fleet.efficiency)

    def weaken_motor(self, motor: int, left: float) -> None:
        """A motor (0, 1, ...) gives the share ``left`` (0..1) of its thrust; 1: it is whole."""
        self.fleet.efficiency[motor, self.index] = left

    def freeze(self, frozen: bool) -> None:
        """The actuators stay at what they have now, or obey again."""
        self.fleet.freeze(self.index, frozen=frozen)

    def fix(self) -> GpsFix:
        """The GPS's latest solution."""
        return self.fleet.sensors.fix(self.index)

    def belief(self) -> Belief:
        """What its autopilot's navigation filter steers."""
        return self.fleet.estimate.belief(self.index)

    def distance(self, *, nearest: float, farthest: float, mount: float) -> float:
        """Of a downward rangefinder of those limits, m; NaN beyond them."""
        return self.fleet.sensors.distance(self.index, nearest, farthest, mount)

    @property
    def clipped(self) -> float:
        """How often its accelerometers have reached their limit."""
        return float(self.fleet.sensors.clipped[self.index])

    @property
    def vibration(self) -> float:
        """Of its accelerometers, m/s^2 root mean square."""
        return self.fleet.sensors.vibration(self.index)

    @property
    def wind(self) -> Vector:
        """Of the air about it, m/s NED."""
        north, east, down = self.fleet.dynamics.wind[:, self.index].tolist()
        return north, east, down
