"""Controllers on the embedded 3.2 kg PX4 hexarotor in lock-step: no sockets and no wall clock, so that a flight is the
same each time and on every machine.

    with Flight(wind=(4.0, 0.0, 0.0), gusts="light", noise="typical", seed=3) as flight:
        flight.fly_autopilot(circle(2.0, 2.5), 4.0, shadow=mine)    # it begins; ours is reset with every cycle
        log = flight.fly(mine, circle(2.0, 2.5), 12.0)              # ours takes over
    assert log.rms_position() < 0.3

The reference goes by the time since the takeoff, over all the calls of one flight.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

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
from zmav.sim.autopilots.px4.modes import OFFBOARD
from zmav.sim.autopilots.px4.offboard import NOTHING, Attitude, Motion, Partial, Rates, Torque, Wish
from zmav.sim.fleets.copter import CopterFleet

CYCLE = 0.004
TICK_HZ = 500
ReferenceAt = Callable[[float], Reference]


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


class Flight:
    """A hexarotor in the air, hovering at the origin ``height`` m up. ``wind`` (m/s NED), ``gusts``, ``noise`` and
    ``seed``: the world's; ``delay``: cycles between a state and the autopilot's hearing of the output made from it;
    ``params``: PX4's that differ.
    """

    def __init__(
        self,
        *,
        wind: tuple[float, float, float] = (0.0, 0.0, 0.0),
        gusts: str = "none",
        noise: str = "none",
        seed: int = 0,
        delay: int = 1,
        height: float = 5.0,
        params: dict[str, float] | None = None,
    ) -> None:
        spec = VehicleSpec(autopilot="px4", airframe="hexa", firmware="1.13", endpoints=(), params=params or {})
        self.world = World(
            [spec], epoch_s=0.0, ready_s=0.5, tick_hz=TICK_HZ, wind=wind, gusts=gusts, noise=noise, seed=seed
        )
        self.px4 = self.world.vehicles[0].px4
        seat = self.world.vehicles[0].node.seat
        assert isinstance(seat.fleet, CopterFleet)
        self.fleet = seat.fleet
        frame = self.fleet.airframe
        self.full_n = frame.thrust_max_n * len(frame.rotors)
        """N that all rotors give together at most, as the autopilot takes them"""
        self._shares = frame.wrench_matrix() * frame.thrust_max_n
        self._expo = frame.thrust_expo
        self._delay, self._queue = delay, deque[Wish]()
        self._begun = 0.0
        self._take_off(height)

    def __enter__(self) -> Flight:
        return self

    def __exit__(self, *exc: object) -> None:
        self.world.close()

    def _take_off(self, height: float) -> None:
        self._until(lambda: self.px4.checks_ok)
        assert self.px4.arm()
        up = Motion(pos=(0.0, 0.0, -height), yaw=0.0)
        self._until(lambda: self.px4.offboard.alive, up)  # PX4 wants to see a stream before it flies by it
        assert self.px4.set_mode(OFFBOARD)
        self._until(lambda: self._near(height), up)
        self._begun = self.world.time_s

    def _near(self, height: float) -> bool:
        state = self.state()
        return bool(np.linalg.norm(state.pos - (0.0, 0.0, -height)) < 0.5 and np.linalg.norm(state.vel) < 0.5)

    def _until(self, true: Callable[[], bool], wish: Wish | None = None) -> None:
        while not true():
            assert self.world.time_s < 60.0, "not in the air within a minute"
            if wish is not None:
                self._send(wish)
            self.world.step(CYCLE)

    # ---- what is

    @property
    def t(self) -> float:
        """s since the takeoff"""
        return self.world.time_s - self._begun

    def state(self) -> State:
        """As the autopilot's telemetry tells it, but exactly."""
        est = self.fleet.estimate
        pos, vel, q, rates = (rows[:, 0].copy() for rows in (est.pos, est.vel, est.q, est.rate))
        return State(self.world.time_s, CYCLE, pos, vel, q, rates, self.fleet.dynamics.throttle[:, 0].copy())

    def trim(self) -> Trim:
        """What the autopilot asks for now."""
        loops = self.fleet.cascade
        thrust = float(loops.thrust[0]) / self.full_n
        return Trim(thrust, loops.attitude[:, 0].copy(), loops.want_rate[:, 0].copy())

    # ---- flying

    def fly(self, controller: Flies, reference: ReferenceAt, seconds: float) -> Log:
        """Have ``controller`` fly; it is reset once before its first cycle."""
        controller.reset(self.state(), reference(self.t), self.trim())

        def decide(state: State, wanted: Reference) -> tuple[Wish, Output]:
            output = controller.update(state, wanted)
            return wish_of(output), output

        return self._run(decide, reference, seconds, lambda: getattr(controller, "signals", {}))

    def fly_autopilot(self, reference: ReferenceAt, seconds: float, shadow: Flies | None = None) -> Log:
        """Have the autopilot fly the same reference: from its level on inwards, with what is fed forward. ``shadow``
        is reset with every cycle, as a controller is that waits to take over.
        """

        def decide(state: State, wanted: Reference) -> tuple[Wish, None]:
            if shadow is not None:
                shadow.reset(state, wanted, self.trim())
            return followed(wanted), None

        return self._run(decide, reference, seconds, dict)

    def _run(
        self,
        decide: Callable[[State, Reference], tuple[Wish, Output | None]],
        reference: ReferenceAt,
        seconds: float,
        signals: Callable[[], dict[str, float]],
    ) -> Log:
        rows: list[tuple[float, State, Array, Trim]] = []
        references: list[Reference] = []
        outputs: list[Output | None] = []
        told: list[dict[str, float]] = []
        for _ in range(round(seconds / CYCLE)):
            at, state, wanted = self.t, self.state(), reference(self.t)
            rows.append((at, state, self.fleet.dynamics.pos[:, 0].copy(), self.trim()))
            references.append(wanted)
            wish, output = decide(state, wanted)
            outputs.append(output)
            told.append(dict(signals()))
            self._queue.append(wish)
            while len(self._queue) > self._delay:
                self._send(self._queue.popleft())
            self.world.step(CYCLE)
            assert self.px4.mode is OFFBOARD, f"PX4 flies in {self.px4.mode.name} after {self.t:.2f} s"
        return self._log(rows, references, outputs, told)

    def _send(self, wish: Wish) -> None:
        self.px4.offboard.beat(needs_position=isinstance(wish, Motion) and (wish.pos != NOTHING or wish.vel != NOTHING))
        self.px4.offboard.take(wish)

    def _log(
        self,
        rows: list[tuple[float, State, Array, Trim]],
        references: list[Reference],
        outputs: list[Output | None],
        told: list[dict[str, float]],
    ) -> Log:
        times, states, true, trims = zip(*rows, strict=True)
        motors = np.array([each.motors for each in states])
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
