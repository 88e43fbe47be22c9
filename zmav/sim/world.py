"""The world: steps all vehicles at a fixed rate and serves their links, in real time, faster, or as a caller steps
it.
"""

from __future__ import annotations

import math
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeout
from typing import TypeVar

import msgspec

from zmav.errors import BadConfig, TimedOut
from zmav.mavlink.dialect import load_dialect
from zmav.sim.build import Squad, as_specs, build
from zmav.sim.endpoints import expand, open_endpoint, parse_endpoint
from zmav.sim.environment import Environment, Vector
from zmav.sim.spec import ARDUCOPTER, PX4, Home, VehicleSpec, usual
from zmav.sim.vehicle import SimVehicle, VehicleStatus

T = TypeVar("T")

PHYSICS_HZ = 200
STEPS_PER_TICK = 2
TICK_S = STEPS_PER_TICK / PHYSICS_HZ
DEFAULT_READY_S = 4.0
REALISTIC_READY_S = 41.4
MOST = 1e6  # of any option that is a number: beyond it nothing makes sense
MOST_BEHIND_S = 0.25  # of wall time that is caught up with; what is more is given up


def _first_of(*choices: Sequence[str] | None) -> Sequence[str]:
    return next(choice for choice in choices if choice is not None)


class WorldStatus(msgspec.Struct, frozen=True):
    """A snapshot: simulated seconds, the speed asked for and the one reached lately, and every vehicle."""

    time_s: float
    speed: float
    speed_reached: float
    vehicles: tuple[VehicleStatus, ...]


class World:
    """Vehicles, their autopilots and their links on one clock.

    ``vehicles``: one :class:`VehicleSpec` each; ``copters``, ``px4``: so many plain ArduCopters and PX4s after them.
    Nothing at all is one ArduCopter.
    ``endpoint``: for those whose spec names none, see :mod:`zmav.sim.endpoints`; several may be given (None: "tcp" for
    an ArduCopter, "px4" for a PX4). ``speed``: times real time, ``math.inf`` as fast as it goes.
    ``wind``: steady, m/s NED (where it blows to). ``ready_s``: simulated seconds from boot to a position
    (:data:`REALISTIC_READY_S` is what the real autopilot takes; the other steps of its boot keep their proportions).
    ``gps_noise_m``: standard deviation per axis. ``epoch_s``: UTC at the start.

    ``with World(copters=3) as world:`` opens the endpoints and runs it in a thread of its own; :meth:`open` and
    :meth:`run` do so in the caller's; :meth:`step` advances without any clock. Raises :class:`BadConfig`,
    :class:`BadUrl`, :class:`PortInUse`.
    """

    def __init__(
        self,
        vehicles: Sequence[VehicleSpec] = (),
        *,
        copters: int = 0,
        home: Home | None = None,
        spacing_m: float = 10.0,
        px4: int = 0,
        endpoint: str | Sequence[str] | None = None,
        speed: float = 1.0,
        seed: int = 0,
        wind: Vector = (0.0, 0.0, 0.0),
        ready_s: float = DEFAULT_READY_S,
        gps_noise_m: float = 0.0,
        epoch_s: float | None = None,
    ) -> None:
        if not speed > 0.0:
            raise BadConfig(f"speed {speed}; expected more than 0", field="speed", value=speed, expected="more than 0")
        numbers = {"spacing_m": spacing_m, "ready_s": ready_s, "gps_noise_m": gps_noise_m, "wind": sum(map(abs, wind))}
        for field, value in numbers.items():
            if not 0.0 <= value < MOST:
                raise BadConfig(f"{field} {value}; expected 0 or more", field=field, value=value, expected="0 or more")
        self.home = home or Home()
        self.speed = speed
        self.ticks = 0
        self._specs = as_specs(vehicles, {ARDUCOPTER: copters, PX4: px4})
        default = (endpoint,) if isinstance(endpoint, str) else endpoint
        self._addresses = [
            [parse_endpoint(text, i) for text in expand(_first_of(spec.endpoints, default, usual(spec)))]
            for i, spec in enumerate(self._specs)
        ]
        built = build(
            self._specs,
            home=self.home,
            spacing_m=spacing_m,
            seed=seed,
            environment=Environment(wind),
            ready_s=ready_s,
            gps_noise_m=gps_noise_m,
            dt=1.0 / PHYSICS_HZ,
            dialect=load_dialect("ardupilotmega"),
            epoch_us=int((time.time() if epoch_s is None else epoch_s) * 1e6),
        )
        self.vehicles: list[SimVehicle] = [vehicle for _, vehicle in built]
        self._squads: list[Squad] = list({id(squad): squad for squad, _ in built}.values())
        self._selector = selectors.DefaultSelector()
        self._calls: deque[Callable[[], None]] = deque()
        self._ticked = threading.Condition()
        self._thread: threading.Thread | None = None
        self._stopping = False
        self._failure: BaseException | None = None
        self._speed_reached = 0.0
        self._bell, self._ear = socket.socketpair()
        self._bell.setblocking(False)
        self._ear.setblocking(False)
        self._selector.register(self._ear, selectors.EVENT_READ, self._hear)

    # ---- life

    def __enter__(self) -> World:
        try:
            self.start()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def open(self) -> None:
        """Open the endpoints. Raises :class:`PortInUse`; nothing stays open then."""
        try:
            for vehicle, addresses in zip(self.vehicles, self._addresses, strict=True):
                for address in addresses[len(vehicle.endpoints) :]:
                    vehicle.endpoints.append(open_endpoint(address, vehicle.node, self._selector))
        except BaseException:
            self._close_endpoints()
            raise

    def start(self) -> None:
        """Open and run in a thread of its own."""
        self.open()
        self._thread = threading.Thread(target=self._run_guarded, name="zmav-sim", daemon=True)
        self._thread.start()

    def run(self) -> None:
        """Open and run in this thread until :meth:`stop`."""
        self.open()
        self._run()

    def stop(self) -> None:
        """Ask :meth:`run` to end; any thread, and signal handlers, may."""
        self._stopping = True
        self._ring()

    def close(self) -> None:
        """Stop and close everything. Raises what ended the thread, if an error did."""
        self.stop()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        self._close_endpoints()
        self._selector.close()
        self._bell.close()
        self._ear.close()
        if self._failure is not None:
            failure, self._failure = self._failure, None
            raise failure

    def _close_endpoints(self) -> None:
        for vehicle in self.vehicles:
            for endpoint in vehicle.endpoints:
                endpoint.close()
            vehicle.endpoints.clear()

    # ---- time

    @property
    def time_s(self) -> float:
        """Simulated seconds since the start."""
        return self.ticks * TICK_S

    def step(self, seconds: float = TICK_S) -> None:
        """Advance by whole ticks without a clock; only where no thread runs the world."""
        for _ in range(max(round(seconds / TICK_S), 1)):
            self._tick()

    def _tick(self) -> None:
        self.ticks += 1
        now = self.time_s
        for squad in self._squads:
            squad.fleet.advance(STEPS_PER_TICK)
            for vehicle, sense in zip(squad.vehicles, squad.fleet.senses(), strict=True):
                vehicle.brain.update(now, sense, TICK_S)
                vehicle.node.tick()

    def _run_guarded(self) -> None:
        try:
            self._run()
        except BaseException as error:
            self._failure = error
            with self._ticked:
                self._ticked.notify_all()

    def _run(self) -> None:
        due = measured = time.monotonic()
        measured_ticks = self.ticks
        while not self._stopping:
            now = time.monotonic()
            if now < due:
                self._serve(due - now)
                continue
            self._serve(0.0)
            self._tick()
            self._flush()
            with self._ticked:
                self._ticked.notify_all()
            due += TICK_S / self.speed if math.isfinite(self.speed) else 0.0
            if now - due > MOST_BEHIND_S:
                due = now
            if now - measured > 1.0:
                self._speed_reached = (self.ticks - measured_ticks) * TICK_S / (now - measured)
                measured, measured_ticks = now, self.ticks

    # ---- links, and calls from other threads

    def _serve(self, timeout: float) -> None:
        for key, _ in self._selector.select(timeout):
            ready: Callable[[], None] = key.data
            ready()
        while self._calls:
            self._calls.popleft()()

    def _flush(self) -> None:
        for vehicle in self.vehicles:
            for endpoint in vehicle.endpoints:
                endpoint.flush()

    def _ring(self) -> None:
        # A full buffer means that it rings already; a closed one, that nobody is left to hear.
        try:
            self._bell.send(b"\0")
        except OSError:
            return

    def _hear(self) -> None:
        try:
            self._ear.recv(4096)
        except BlockingIOError:
            return

    def call(self, function: Callable[[], T], timeout: float = 10.0) -> T:
        """Run ``function`` between two ticks in the world's thread; gives its result, or raises what it raised.

        Raises :class:`TimedOut` where the world does not run.
        """
        future: Future[T] = Future()

        def task() -> None:
            try:
                future.set_result(function())
            except BaseException as error:
                future.set_exception(error)

        self._calls.append(task)
        self._ring()
        try:
            return future.result(timeout)
        except FutureTimeout:
            if future.done():
                raise  # the function's own
            raise TimedOut("the simulated world does not run") from None

    def wait_for(self, true: Callable[[], bool], sim_s: float = 120.0) -> None:
        """Wait until ``true()`` holds, looked at after every tick; :class:`TimedOut` after ``sim_s`` simulated
        seconds.
        """
        end = self.time_s + sim_s
        with self._ticked:
            while not true():
                if self._failure is not None:
                    raise TimedOut(f"the simulated world has failed: {self._failure!r}")
                if self.time_s > end:
                    raise TimedOut(f"not within {sim_s:g} s of simulated time")
                if not self._ticked.wait(10.0):
                    raise TimedOut("the simulated world does not run")

    # ---- what there is to see

    @property
    def urls(self) -> list[str]:
        """The first link URL of every vehicle."""
        return [vehicle.url for vehicle in self.vehicles]

    def status(self) -> WorldStatus:
        return WorldStatus(self.time_s, self.speed, self._speed_reached, tuple(v.status() for v in self.vehicles))
