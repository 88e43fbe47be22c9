"""Controllers on the embedded 3.2 kg PX4 hexarotor in lock-step: no sockets and no wall clock, so that a flight is the
same each time and on every machine.

    with Flight(wind=(4.0, 0.0, 0.0), gusts="light", noise="typical", seed=3) as flight:
        flight.fly_autopilot(circle(2.0, 2.5), 4.0, shadow=mine)    # it begins; ours is reset with every cycle
        log = flight.fly(mine, circle(2.0, 2.5), 12.0)              # ours takes over
    assert log.rms_position() < 0.3

The reference goes by the time since the takeoff, over all the calls of one flight. What several would fly one after
another they fly in one flight at once, each as if it were alone, which takes little longer than one of them:

    with Flight(ways=2, noise="typical", seed=3) as flight:
        theirs, ours = flight.together([flight[0].fly_autopilot(at, 9.0), flight[1].fly(mine, at, 9.0)])
"""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field
from typing import Protocol, TypeVar
from unittest import mock

import numpy as np

from agents.controllers import (
    Acceleration,
    Array,
    AttitudeThrust,
    Output,
    RatesThrust,
    Reference,
    State,
    Trim,
    Velocity,
)
from zmav.sim import VehicleSpec, World
from zmav.sim.air import WhiteNoise
from zmav.sim.autopilots.px4.modes import HOLD, OFFBOARD, Mode
from zmav.sim.autopilots.px4.offboard import NOTHING, Attitude, Motion, Partial, Rates, Torque, Wish
from zmav.sim.fleets.copter import CopterFleet
from zmav.sim.sensors.noise import NoiseRows

CYCLE = 0.004
TICK_HZ = 500
COARSE_CYCLE, COARSE_TICK_HZ = 0.005, 200
QUICK = {"MPC_TKO_RAMP_T": 0.0, "COM_SPOOLUP_TIME": 0.0}
"""PX4 parameters that only make the takeoff shorter"""
ReferenceAt = Callable[[float], Reference]
T = TypeVar("T")
Cycles = Generator[None, None, T]
"""what is flown: it goes on by one cycle at a time, and comes to a value"""


class Flies(Protocol):
    """A controller, or a stack of loops that ends in one."""

    def reset(self, state: State, reference: Reference, trim: Trim) -> None: ...

    def update(self, state: State, reference: Reference) -> Output: ...


@dataclass
class Log:
    """One row a cycle, beginning at the state that the cycle's output was made from."""

    t: Array
    """(K,) s since the takeoff"""
    pos: Array
    vel: Array
    q: Array
    rates: Array
    """(K, 3), (K, 3), (K, 4), (K, 3): by the autopilot's estimator, as controllers see them"""
    true_pos: Array
    motors: Array
    """(K, 6) what each is given, 0 to 1"""
    wrench: Array
    """(K, 4) what the motors would give at rest in still air if they followed at once: thrust (N), torque (N m)"""
    thrust: Array
    """(K,) that the autopilot asks of its mixer, 0 to 1"""
    attitude: Array
    asked_rates: Array
    """(K, 4), (K, 3) that the autopilot asks for"""
    reference: list[Reference]
    outputs: list[Output | None]
    """None: the autopilot flew"""
    signals: list[dict[str, float]] = field(default_factory=list)

    @property
    def ref_pos(self) -> Array:
        """(K, 3)"""
        return np.array([each.pos for each in self.reference])

    @property
    def ref_vel(self) -> Array:
        """(K, 3)"""
        return np.array([each.vel for each in self.reference])

    @property
    def ref_acc(self) -> Array:
        """(K, 3)"""
        return np.array([each.acc for each in self.reference])

    def distance(self) -> Array:
        """(K,) m from the reference's position, by the estimator."""
        found: Array = np.linalg.norm(self.pos - self.ref_pos, axis=1)
        return found

    def rms_position(self, after: float = 0.0) -> float:
        """m, over what is later than ``after`` seconds since the takeoff."""
        return math.sqrt(float((self.distance()[self.t >= after] ** 2).mean()))

    def rms_velocity(self, after: float = 0.0) -> float:
        """m/s"""
        miss = np.linalg.norm(self.vel - self.ref_vel, axis=1)[self.t >= after]
        return math.sqrt(float((miss**2).mean()))

    def lean(self) -> Array:
        """(K,) rad between the body's up axis and the world's."""
        cosine: Array = 1.0 - 2.0 * (self.q[:, 1] ** 2 + self.q[:, 2] ** 2)
        found: Array = np.arccos(np.clip(cosine, -1.0, 1.0))
        return found

    def signal(self, name: str) -> Array:
        """(K,) one of the controller's signals; nan where it did not tell it."""
        return np.array([each.get(name, math.nan) for each in self.signals])


class Hexarotor:
    """One of a flight's. ``delay``: cycles between a state and the autopilot's hearing of the output made from it."""

    def __init__(self, flight: Flight, column: int, delay: int) -> None:
        vehicle = flight.world.vehicles[column]
        self.px4, self._flight, self._column = vehicle.px4, flight, column
        assert isinstance(vehicle.node.seat.fleet, CopterFleet)
        self.fleet = vehicle.node.seat.fleet
        frame = self.fleet.airframe
        self._full_n = frame.thrust_max_n * len(frame.rotors)
        """N that all rotors give together at most, as the autopilot takes them"""
        self._shares = frame.wrench_matrix() * frame.thrust_max_n
        self._expo = frame.thrust_expo
        self.delay, self._queue = delay, deque[Wish]()
        self.hear()

    # ---- what is

    def state(self) -> State:
        """As the autopilot's telemetry tells it, but exactly."""
        est = self.fleet.estimate
        pos, vel, q, rates = (rows[:, self._column].copy() for rows in (est.pos, est.vel, est.q, est.rate))
        return State(self._flight.world.time_s, self._flight.cycle, pos, vel, q, rates, self._told[1])

    def trim(self) -> Trim:
        """What the autopilot asks for, as last told."""
        return self._told[0]

    def hear(self) -> None:
        """Its autopilot tells what it asks for, and what the motors get."""
        self._told = self._asks(), self._motors()

    def _motors(self) -> Array:
        """(6,) what each is given now, 0 to 1"""
        return self.fleet.dynamics.throttle[:, self._column].copy()

    def _asks(self) -> Trim:
        loops, k = self.fleet.cascade, self._column
        return Trim(float(loops.thrust[k]) / self._full_n, loops.attitude[:, k].copy(), loops.want_rate[:, k].copy())

    # ---- flying

    def take_off(self, height: float, over: Callable[[], bool]) -> Cycles[None]:
        """Up, and stay there until all is ``over``."""
        yield from self._until(lambda: self.px4.checks_ok)
        assert self.px4.arm()
        up = Motion(pos=(0.0, 0.0, -height), yaw=0.0)
        yield from self._until(lambda: self.px4.offboard.alive, up)  # PX4 wants to see a stream before it flies by it
        assert self.px4.set_mode(OFFBOARD)
        yield from self._until(over, up)

    def near(self, height: float) -> bool:
        state = self.state()
        return bool(np.linalg.norm(state.pos - (0.0, 0.0, -height)) < 0.5 and np.linalg.norm(state.vel) < 0.5)

    def _until(self, true: Callable[[], bool], wish: Wish | None = None) -> Cycles[None]:
        deadline = self._flight.world.time_s + 60.0
        while not true():
            assert self._flight.world.time_s < deadline, "it did not come true within a minute"
            if wish is not None:
                self._send(wish)
            yield

    def fly(self, controller: Flies, reference: ReferenceAt, seconds: float) -> Cycles[Log]:
        """Have ``controller`` fly; it is reset once before its first cycle."""
        controller.reset(self.state(), reference(self._flight.t), self.trim())

        def decide(state: State, wanted: Reference) -> tuple[Wish, Output]:
            output = controller.update(state, wanted)
            return wish_of(output), output

        return (yield from self._run(decide, reference, seconds, lambda: getattr(controller, "signals", {})))

    def fly_autopilot(self, reference: ReferenceAt, seconds: float, shadow: Flies | None = None) -> Cycles[Log]:
        """Have the autopilot fly the same reference: from its level on inwards, with what is fed forward. ``shadow``
        is reset with every cycle, as a controller is that waits to take over.
        """

        def decide(state: State, wanted: Reference) -> tuple[Wish, None]:
            if shadow is not None:
                shadow.reset(state, wanted, self.trim())
            return followed(wanted), None

        return (yield from self._run(decide, reference, seconds, dict))

    def hand_back(self, seconds: float) -> Cycles[Log]:
        """Have the autopilot hold its position by itself, as the switch does, and then ask for OFFBOARD again."""
        here, yaw = self.state().pos, self.state().yaw
        assert self.px4.set_mode(HOLD)
        self._queue.clear()
        nothing: ReferenceAt = lambda t: Reference(pos=here, yaw=yaw)  # noqa: E731
        log = yield from self._run(lambda state, wanted: (None, None), nothing, seconds, dict, HOLD)
        stay = Motion(pos=_three(self.state().pos), yaw=self.state().yaw)
        yield from self._until(lambda: self.px4.offboard.alive, stay)
        assert self.px4.set_mode(OFFBOARD)
        return log

    def _run(
        self,
        decide: Callable[[State, Reference], tuple[Wish | None, Output | None]],
        reference: ReferenceAt,
        seconds: float,
        signals: Callable[[], dict[str, float]],
        mode: Mode = OFFBOARD,
    ) -> Cycles[Log]:
        rows: list[tuple[float, State, Array, Array, Trim]] = []
        references: list[Reference] = []
        outputs: list[Output | None] = []
        told: list[dict[str, float]] = []
        for _ in range(round(seconds / self._flight.cycle)):
            at = self._flight.t
            state, wanted = self.state(), reference(at)
            rows.append((at, state, self.fleet.dynamics.pos[:, self._column].copy(), self._motors(), self._asks()))
            references.append(wanted)
            wish, output = decide(state, wanted)
            outputs.append(output)
            told.append(dict(signals()))
            if wish is not None:
                self._queue.append(wish)
            while len(self._queue) > self.delay:
                self._send(self._queue.popleft())
            yield
            assert self.px4.mode is mode, f"PX4 flies in {self.px4.mode.name} after {self._flight.t:.2f} s"
        return self._log(rows, references, outputs, told)

    def _send(self, wish: Wish) -> None:
        self.px4.offboard.beat(needs_position=isinstance(wish, Motion) and (wish.pos != NOTHING or wish.vel != NOTHING))
        self.px4.offboard.take(wish)

    def _log(
        self,
        rows: list[tuple[float, State, Array, Array, Trim]],
        references: list[Reference],
        outputs: list[Output | None],
        told: list[dict[str, float]],
    ) -> Log:
        times, states, true, given, trims = zip(*rows, strict=True)
        motors = np.array(given)
        shares = motors * (1.0 - self._expo) + motors * motors * self._expo
        return Log(
            t=np.array(times),
            pos=np.array([each.pos for each in states]),
            vel=np.array([each.vel for each in states]),
            q=np.array([each.q for each in states]),
            rates=np.array([each.rates for each in states]),
            true_pos=np.array(true),
            motors=motors,
            wrench=shares @ self._shares.T,
            thrust=np.array([each.thrust for each in trims]),
            attitude=np.array([each.attitude for each in trims]),
            asked_rates=np.array([each.rates for each in trims]),
            reference=references,
            outputs=outputs,
            signals=told,
        )


class Flight:
    """Hexarotors in the air, hovering at the origin ``height`` m up: as many as there are ``ways`` to fly, which do not
    see each other. ``wind`` (m/s NED), ``gusts``, ``noise`` and ``seed``: the world's; ``alike``: gusts and noise of
    all are those of the first, else each has its own; ``delay``: of each, see :class:`Hexarotor`; ``slow``: cycles
    between two words of what the autopilot asks for and what the motors get, 10 (coarse: 8) for the 25 Hz that a
    real one's streams of it have; ``params``: PX4's that differ; ``coarse``: ticks and cycles of 5 ms, at half the
    cost, where what is proven is no matter of the inner loops.
    """

    def __init__(
        self,
        *,
        wind: tuple[float, float, float] = (0.0, 0.0, 0.0),
        gusts: str = "none",
        noise: str = "none",
        seed: int = 0,
        delay: int = 1,
        slow: int = 1,
        height: float = 5.0,
        params: dict[str, float] | None = None,
        ways: int = 1,
        alike: bool = True,
        coarse: bool = False,
    ) -> None:
        spec = VehicleSpec(
            autopilot="px4",
            airframe="hexa",
            firmware="1.13",
            endpoints=(),
            params=QUICK | (params or {}),
            start_ned_m=(0.0, 0.0, 0.0),
        )
        with contextlib.ExitStack() as stack:
            if alike:
                stack.enter_context(mock.patch("zmav.sim.air.WhiteNoise", SameWhiteNoise))
                for user in ("suite", "estimate"):
                    stack.enter_context(mock.patch(f"zmav.sim.sensors.{user}.NoiseRows", SameNoiseRows))
            weather = {"wind": wind, "gusts": gusts, "noise": noise, "seed": seed}
            tick_hz = COARSE_TICK_HZ if coarse else TICK_HZ
            self.world = World([spec] * ways, epoch_s=0.0, ready_s=0.5, tick_hz=tick_hz, **weather)  # type: ignore[arg-type]
        self.cycle = COARSE_CYCLE if coarse else CYCLE
        """s"""
        self._slow, self._cycles = slow, 0
        self._begun = 0.0
        self._flying = [Hexarotor(self, column, delay) for column in range(ways)]
        self.fleet = self._flying[0].fleet
        over = lambda: all(each.near(height) for each in self._flying)  # noqa: E731
        self.together([each.take_off(height, over) for each in self._flying])
        self._begun = self.world.time_s

    def __enter__(self) -> Flight:
        return self

    def __exit__(self, *exc: object) -> None:
        self.world.close()

    def __getitem__(self, way: int) -> Hexarotor:
        return self._flying[way]

    @property
    def t(self) -> float:
        """s since the takeoff"""
        return self.world.time_s - self._begun

    def trim(self) -> Trim:
        """See :class:`Hexarotor`; of the first, as what follows."""
        return self._flying[0].trim()

    def fly(self, controller: Flies, reference: ReferenceAt, seconds: float) -> Log:
        return self.together([self._flying[0].fly(controller, reference, seconds)])[0]

    def fly_autopilot(self, reference: ReferenceAt, seconds: float, shadow: Flies | None = None) -> Log:
        return self.together([self._flying[0].fly_autopilot(reference, seconds, shadow)])[0]

    def together(self, ways: Sequence[Cycles[T]]) -> list[T]:
        """Fly all of them at once, each to its end; what each comes to."""
        ended: dict[int, T] = {}
        while True:
            for number, way in enumerate(ways):
                if number not in ended:
                    try:
                        next(way)
                    except StopIteration as end:
                        ended[number] = end.value
            if len(ended) == len(ways):
                return [ended[number] for number in range(len(ways))]
            self.world.step(self.cycle)
            self._cycles += 1
            if self._cycles % self._slow == 0:
                for each in self._flying:
                    each.hear()


class SameWhiteNoise(WhiteNoise):
    """The first vehicle's for each."""

    def __init__(self, rng: np.random.Generator, rows: int, n: int) -> None:
        super().__init__(rng, rows, 1)
        self._n = n

    def draw(self) -> Array:
        return np.repeat(super().draw(), self._n, axis=1)


class SameNoiseRows(NoiseRows):
    """The first vehicle's for each."""

    def __init__(self, seed: tuple[int, ...], purpose: str, vehicles: int, width: int) -> None:
        super().__init__(seed, purpose, 1, width)
        self._n = vehicles

    def row(self, count: int) -> Array:
        return np.repeat(super().row(count), self._n, axis=1)


# ---- what the autopilot is told


def wish_of(output: Output) -> Wish:
    """The setpoint that carries a controller's output."""
    if isinstance(output, Velocity):
        return Motion(vel=_three(output.vel), yaw=output.yaw, yaw_rate=output.yaw_rate)
    if isinstance(output, Acceleration):
        return Motion(acc=_three(output.acc), yaw=output.yaw, yaw_rate=output.yaw_rate)
    if isinstance(output, AttitudeThrust):
        return _attitude(output.attitude, output.thrust)
    if isinstance(output, RatesThrust):
        p, q, r = output.rates.tolist()
        return Rates(p, q, r, _share(output.thrust))
    roll, pitch, yaw = output.torque.tolist()
    return Torque(roll, pitch, yaw, _share(output.thrust))


def followed(reference: Reference) -> Wish:
    """The setpoint that has the autopilot follow a reference by itself."""
    if reference.level == "position":
        pos, vel, acc = (_three(each) for each in (reference.pos, reference.vel, reference.acc))
        return Motion(pos, vel, acc, yaw=reference.yaw)
    if reference.level == "velocity":
        return Motion(vel=_three(reference.vel), acc=_three(reference.acc), yaw=reference.yaw)
    if reference.level == "rates":
        p, q, r = reference.rates.tolist()
        return Rates(p, q, r, _share(reference.thrust))
    assert reference.level == "attitude", "PX4 has no setpoint of attitude and height"
    return _attitude(reference.attitude, reference.thrust)


def _attitude(attitude: Array, thrust: float) -> Attitude:
    roll, pitch, yaw = State(q=attitude).euler.tolist()
    return Attitude(roll, pitch, yaw, None, _share(thrust))


def _three(vector: Array) -> Partial:
    x, y, z = vector.tolist()
    return x, y, z


def _share(thrust: float) -> float:
    return min(max(float(thrust), 0.0), 1.0)


# ---- references


def hover(north: float = 0.0, east: float = 0.0, height: float = 5.0, yaw: float = 0.0) -> ReferenceAt:
    """Stay there."""
    point = np.array([north, east, -height])
    return lambda t: Reference(pos=point, yaw=yaw)


def circle(radius: float, speed: float, height: float = 5.0, build_up: float = 2.0, yaw: float = 0.0) -> ReferenceAt:
    """A circle through the origin about a point ``radius`` m east of it, clockwise from above; velocity and
    acceleration are fed forward. The turn builds up to ``speed`` (m/s) within ``build_up`` seconds.
    """
    full = speed / radius

    def at(t: float) -> Reference:
        share = min(max(t / build_up, 0.0), 1.0)
        # A turn rate that rises as the smooth step 3 s² - 2 s³: neither it nor the acceleration jumps.
        rate, spin = full * share * share * (3.0 - 2.0 * share), full * 6.0 * share * (1.0 - share) / build_up
        angle = full * build_up * (share**3 - 0.5 * share**4) + full * max(t - build_up, 0.0)
        c, s = math.cos(angle), math.sin(angle)
        pos = np.array([radius * s, radius * (1.0 - c), -height])
        vel = np.array([c, s, 0.0]) * (radius * rate)
        acc = np.array([-s, c, 0.0]) * (radius * rate * rate) + np.array([c, s, 0.0]) * (radius * spin)
        return Reference(pos=pos, vel=vel, acc=acc, yaw=yaw)

    return at


def steps(size: float = 2.0, every: float = 5.0, height: float = 5.0) -> ReferenceAt:
    """Jumps of the position: north, east, up and back, and round again."""
    corners = np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [1.0, 1.0, -1.0], [0.0, 0.0, 0.0]]) * size
    corners[:, 2] -= height
    return lambda t: Reference(pos=corners[int(t / every) % len(corners)])
