"""The world: steps all vehicles at a fixed rate and serves their links, in real time, faster, or as a caller steps
it.
"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from typing import Any, TypeVar

from zmav.errors import BadConfig, BadInput, TimedOut
from zmav.mavlink import load_dialect
from zmav.ratelimit import RateLimit
from zmav.sim.build import Squad, build
from zmav.sim.camera.cameras import Cameras, SimCamera, actors
from zmav.sim.camera.scene import Scene
from zmav.sim.camera.spec import CameraSpec, PadSpec
from zmav.sim.clock import LATE_S, Pacer
from zmav.sim.endpoints import Address, addresses, open_endpoint
from zmav.sim.environment import Environment, Vector
from zmav.sim.external import Externals, MakeExternals
from zmav.sim.faults import Fault, Faults, FaultStatus, make_fault
from zmav.sim.lineup import equip, gather, line_up
from zmav.sim.lockstep import Lockstep
from zmav.sim.loop import Loop
from zmav.sim.spec import Home, VehicleSpec, usual
from zmav.sim.status import WorldStatus
from zmav.sim.values import check_home
from zmav.sim.vehicle import SimVehicle

T = TypeVar("T")

LEAST_PHYSICS_HZ = 200
TICK_HZ, MOST_TICK_HZ = 100, 1000
TICK_S = 1.0 / TICK_HZ
DEFAULT_READY_S = 4.0
REALISTIC_READY_S = 41.4
BEHIND_SAID_S, SLOW_SAID_S = 1.0, 60.0
"""s behind real time that are worth a word, and s between two words"""
MOST = 1e6  # of any option that is a number: beyond it nothing makes sense
MOST_SEED = 1 << 64
MOST_EPOCH_S = 1e10  # UTC in the year 2286


def _check(field: str, value: float, most: float = MOST) -> None:
    if not 0.0 <= value < most:  # so that NaN is refused, too
        expected = f"0 or more, and less than {most:g}"
        raise BadConfig.wrong(field, value, expected, f"{field} {value}")


class World:
    """Vehicles, their autopilots and their links on one clock.

    ``vehicles``: one :class:`VehicleSpec` each; ``copters``, ``hexas``, ``rovers``, ``planes``, ``px4``: so many plain
    ones of a kind after them. Nothing at all is one ArduCopter.
    ``endpoint``: for those whose spec names none, see :mod:`zmav.sim.endpoints`; several may be given (None:
    "ardupilot" or "px4"). ``speed``: times real time, ``math.inf`` as fast as it goes; ``lockstep``: but
    not faster than clients see it, see :mod:`zmav.sim.lockstep`.
    ``wind``, ``gusts``: see :class:`Environment`. ``ready_s``: simulated seconds from boot to a position
    (:data:`REALISTIC_READY_S` is what the real autopilot takes; the other steps of its boot keep their proportions).
    ``noise``: of the sensors, a name of :data:`zmav.sim.sensors.noise.PROFILES`. ``tick_hz``: how often links are
    served, 100 to 1000 in hundreds: no stream is quicker, and a controller outside hears and is heard that often (each
    tick costs as much). ``epoch_s``: UTC at the start. ``scene``: what cameras see on the ground
    (:mod:`zmav.sim.camera`); ``cameras``, ``pads``: more of them, by vehicles' names.
    ``externals``: flies vehicles whose spec has a ``stack``, :class:`zmav.hil.externals.Externals`.

    ``with World(copters=3) as world:`` opens the endpoints and runs it in a thread of its own; :meth:`open` and
    :meth:`run` do so in the caller's; :meth:`step` advances without any clock. Raises :class:`BadConfig`,
    :class:`BadUrl`, :class:`PortInUse`.
    """

    def __init__(
        self,
        vehicles: Sequence[VehicleSpec] = (),
        *,
        copters: int = 0,
        hexas: int = 0,
        rovers: int = 0,
        planes: int = 0,
        px4: int = 0,
        home: Home | None = None,
        spacing_m: float = 10.0,
        endpoint: str | Sequence[str] | None = None,
        speed: float = 1.0,
        seed: int = 0,
        wind: Vector = (0.0, 0.0, 0.0),
        gusts: str = "none",
        lockstep: bool = False,
        ready_s: float = DEFAULT_READY_S,
        noise: str = "none",
        tick_hz: int = TICK_HZ,
        epoch_s: float | None = None,
        scene: Scene | None = None,
        cameras: Mapping[str, CameraSpec] | None = None,
        pads: Mapping[str, PadSpec] | None = None,
        externals: MakeExternals | None = None,
    ) -> None:
        self.epoch_s = time.time() if epoch_s is None else epoch_s
        _check("spacing_m", spacing_m)
        _check("ready_s", ready_s)
        _check("wind", sum(map(abs, wind)))
        _check("seed", seed, MOST_SEED)
        _check("epoch_s", self.epoch_s, MOST_EPOCH_S)
        if tick_hz not in range(TICK_HZ, MOST_TICK_HZ + 1, TICK_HZ):
            expected = f"{TICK_HZ} to {MOST_TICK_HZ} in hundreds"
            raise BadConfig.wrong("tick_hz", tick_hz, expected, f"tick_hz {tick_hz}")
        self.home = check_home(home or Home())
        self.ticks, self.tick_s = 0, 1.0 / tick_hz
        self._pace, self._steps = tick_hz // TICK_HZ, max(LEAST_PHYSICS_HZ // tick_hz, 1)
        self.pacer = Pacer(self.tick_s, speed)
        self.pacer.on_given_up = self._fell_behind
        self.pacer.on_slow = self._beat
        self._behind_s = 0.0
        self._slow: RateLimit[None] = RateLimit(SLOW_SAID_S, 1)
        self.environment = Environment(wind, gusts)
        counts = {"copter": copters, "hexa": hexas, "rover": rovers, "plane": planes, "px4": px4}
        specs = line_up(gather(vehicles, counts), self.home, spacing_m)
        specs = equip(specs, cameras or {}, pads or {})
        default = (endpoint,) if isinstance(endpoint, str) else endpoint
        named = ((spec.endpoints, default, usual(spec)) for spec in specs)
        reached = addresses([next(each for each in choices if each is not None) for choices in named])
        self.vehicles: list[SimVehicle] = []
        self._squads: list[Squad] = []
        self._addresses: list[list[Address]] = []
        self._build(specs, reached, seed=seed, ready_s=ready_s, noise=noise)
        self.externals = Externals()
        """the vehicles that flight stacks outside the simulator fly"""
        outside = next((spec.name for spec in specs if spec.stack is not None), None)
        if externals is not None:
            self.externals = externals(
                specs,
                reached,
                home=self.home,
                environment=self.environment,
                seed=seed,
                epoch_us=int(self.epoch_s * 1e6),
                speed=speed,
                noise=noise,
            )
        elif outside is not None:
            expected = "externals=zmav.hil.externals.Externals"
            raise BadConfig.wrong("stack", outside, expected, f"{outside} has a flight stack of its own")
        self.say: Callable[[str], None] = lambda text: None
        """takes what a person should know, a line at a time"""
        self.failures: list[tuple[SimVehicle, Exception]] = []
        """defects met while running, each with the vehicle whose autopilot had it; the others go on"""
        self.on_failure: Callable[[SimVehicle, Exception], None] = lambda vehicle, error: None
        self.lockstep = Lockstep(self.vehicles, lambda text: self.say(text)) if lockstep else None
        self._loop = Loop(
            self._tick, lambda: self.time_s, self.status, self.pacer, self.externals, self.lockstep, self._spare
        )
        self._faults = Faults(self, seed)
        self.cameras: Cameras | None = None
        if any(spec.camera is not None for spec in specs):
            seen, inside = actors(specs, self.vehicles, self.externals.vehicles), self._loop.inside
            self.cameras = Cameras(seen, scene or Scene(), seed, self.epoch_s, inside)

    def _build(self, specs: Sequence[VehicleSpec], reached: Sequence[list[Address]], **options: Any) -> None:
        """Make the vehicles that have an autopilot of the simulator's own."""
        own = [i for i, spec in enumerate(specs) if spec.stack is None]
        self._addresses = [reached[i] for i in own]
        built = build(
            [specs[i] for i in own],
            home=self.home,
            environment=self.environment,
            dt=self.tick_s / self._steps,
            dialect=load_dialect("ardupilotmega"),
            epoch_us=int(self.epoch_s * 1e6),
            **options,
        )
        self.vehicles += [vehicle for _, vehicle in built]
        self._squads += {id(squad): squad for squad, _ in built}.values()
        for vehicle in self.vehicles:
            vehicle.node.on_defect = functools.partial(self._met, vehicle)
        for squad in self._squads:
            squad.fleet.pace = self._pace

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
                    vehicle.endpoints.append(open_endpoint(address, vehicle.node, self._loop.wiring))
            self.externals.open(self._loop.wiring)
        except BaseException:
            self._close_endpoints()
            raise

    def start(self) -> None:
        """Open and run in a thread of its own. Nothing where it runs already; nor does a world go on that was stopped
        or has failed: :meth:`close` raises what it failed of.
        """
        self.open()
        self._loop.start()

    def run(self) -> None:
        """Open and run in this thread until :meth:`stop`; where that of :meth:`start` does, only wait for its end."""
        self.open()
        self._loop.run()

    def stop(self) -> None:
        """Ask :meth:`run` to end; any thread, and signal handlers, may."""
        self._loop.stop()

    def close(self) -> None:
        """Stop and close everything. Raises what ended the thread, or the first defect of a vehicle."""
        self.stop()
        self._loop.join()
        self._close_endpoints()
        self._loop.close()
        failure = self._loop.failure or next((error for _, error in self.failures), None)
        self._loop.failure = None
        self.failures.clear()
        if failure is not None:
            raise failure

    def _close_endpoints(self) -> None:
        if self.cameras is not None:
            self.cameras.close()
        self.externals.close()
        for vehicle in self.vehicles:
            for endpoint in vehicle.endpoints:
                endpoint.close()
            vehicle.endpoints.clear()

    # ---- time

    @property
    def time_s(self) -> float:
        """Simulated seconds since the start."""
        return self.ticks * self.tick_s

    @property
    def speed(self) -> float:
        """Times real time; infinite: as fast as it goes."""
        return self.pacer.speed

    def step(self, seconds: float = 0.0) -> None:
        """Advance by whole ticks (at least one) without a clock; only where no thread runs the world. Raises the defect
        of a vehicle that fails meanwhile.
        """
        known = len(self.failures)
        for _ in range(max(round(seconds / self.tick_s), 1)):
            self._tick()
        if len(self.failures) > known:
            _, error = self.failures.pop()
            raise error

    def set_speed(self, speed: float) -> None:
        """Run at ``speed`` times real time from now on; any thread may. :class:`BadConfig` unless it is 0.001 to a
        million, or infinite.
        """
        self._loop.inside(lambda: self.pacer.set_speed(speed))

    def pause(self) -> None:
        """Stand still: clients are answered, but no time passes. Any thread may."""
        self._loop.inside(self._loop.pause)

    def resume(self) -> None:
        """Go on. What was missed in the pause is not caught up with. Any thread may."""
        self._loop.inside(self.pacer.resume)

    def advance(self, seconds: float) -> Future[WorldStatus]:
        """Run for ``seconds`` of simulated time at the world's speed, and pause; any thread may. The future is set when
        they are over, or when somebody pauses the world before. :class:`BadInput` for no time, or more than a million
        seconds.
        """
        if not self.tick_s / 2 <= seconds <= MOST:
            expected = f"{self.tick_s:.3g} to {MOST:.0f}"
            raise BadInput.wrong("seconds", seconds, expected, f"{seconds} seconds")
        return self._loop.inside(lambda: self._loop.advance(round(seconds / self.tick_s)))

    def _tick(self) -> None:
        self.ticks += 1
        now = self.time_s
        self._faults.tick(now)
        for squad in self._squads:
            try:
                squad.fleet.advance(self._steps)
                thinks = self.ticks % (squad.fleet.THINKS_EVERY * self._pace) == 0
                senses = squad.fleet.senses() if thinks or squad.hurries else None
            except Exception as error:  # in the physics of one kind: no end of the others
                self._squads = [each for each in self._squads if each is not squad]
                for vehicle in squad.vehicles:
                    self._fail(vehicle, error)
                continue
            for index, vehicle in enumerate(squad.vehicles):
                if vehicle.failed is not None or vehicle.node.hung:
                    continue
                brain = vehicle.brain
                try:
                    if senses is None:
                        brain.now = now
                    elif thinks:
                        brain.update(now, senses[index], TICK_S * squad.fleet.THINKS_EVERY)
                    else:
                        brain.now, brain.sense = now, senses[index]
                    vehicle.node.tick()
                except Exception as error:  # a defect in one autopilot is no end of the others' flight
                    self._fail(vehicle, error)
        self.externals.grant(now)
        if self.cameras is not None:
            self.cameras.tick(now)

    def _spare(self) -> int:
        """How many ticks may come late: until the next that sends telemetry, and by :data:`LATE_S` at most, of the
        wall's time where that passes more quickly. None where somebody outside follows the clock tick by tick.
        """
        if self.lockstep is not None or self.cameras is not None or self.externals.vehicles or self.pacer.stepping:
            return 0
        speaking = (vehicle.node for vehicle in self.vehicles if not vehicle.node.hung)
        due_s = min([math.inf, *(node.next_due for node in speaking)])
        quiet_s = min(due_s - self.time_s, LATE_S * min(self.speed, 1.0))
        return max(math.ceil(quiet_s / self.tick_s) - 1, 0)

    def _fell_behind(self, seconds: float) -> None:
        """The computer is too slow, or slept. Receivers tell UTC all the same: its clock is not at fault."""
        if self.speed != 1.0 or self.lockstep is not None:
            return
        for vehicle in self.vehicles:
            vehicle.node.late_us += int(seconds * 1e6)
        if self.cameras is not None:
            self.cameras.epoch_s += seconds
        self._behind_s += seconds
        if self._behind_s >= BEHIND_SAID_S and self._slow.take(None) is not None:
            self.say(
                f"this computer is too slow for the simulation, or slept: simulated time fell {self._behind_s:.1f} s "
                "behind. Vehicles fly on, slower than real ones ('zmav sim status' says how much): simulate fewer"
            )
            self._behind_s = 0.0

    def _beat(self) -> None:
        """Time passes slowly. Who listens counts by a real clock, and takes an autopilot for dead after 3 s or so; in
        lock step who listens gives the time.
        """
        if self.lockstep is not None:
            return
        for vehicle in self.vehicles:
            if not vehicle.node.hung:
                try:
                    vehicle.node.beat()
                except Exception as error:  # as in a tick
                    self._fail(vehicle, error)

    def _fail(self, vehicle: SimVehicle, error: Exception) -> None:
        """Its autopilot does nothing from now on."""
        if vehicle.failed is None:
            vehicle.failed = error
            vehicle.node.hung = True  # nor does it answer
            self._record(vehicle, error)

    def _met(self, vehicle: SimVehicle, error: Exception) -> None:
        """A defect that does not stop the autopilot; in a stepped world it comes out where it was met."""
        if not self._loop.runs:
            raise error
        self._record(vehicle, error)

    def _record(self, vehicle: SimVehicle, error: Exception) -> None:
        """Keep and tell a defect, each once: a client may send what leads to it many times."""
        if all((vehicle, repr(error)) != (v, repr(e)) for v, e in self.failures):
            self.failures.append((vehicle, error))
            self.on_failure(vehicle, error)

    # ---- links, and calls from other threads

    def serve(self) -> None:
        """Hear and answer clients of a world that :meth:`step` advances; only where no thread runs it."""
        self._loop.serve()

    def call(self, function: Callable[[], T], timeout: float = 10.0) -> T:
        """Run ``function`` between two ticks in the world's thread; gives its result, or raises what it raised.

        Raises :class:`TimedOut` where the world does not run.
        """
        return self._loop.calls.call(function, timeout)

    def wait_for(self, true: Callable[[], bool], sim_s: float = 120.0) -> None:
        """Wait until ``true()`` holds, looked at after every tick; :class:`TimedOut` after ``sim_s`` simulated
        seconds.
        """
        end = self.time_s + sim_s
        with self._loop.ticked:
            while not true():
                if self._loop.failure is not None:
                    raise TimedOut(f"the simulated world has failed: {self._loop.failure!r}")
                if self.failures:
                    vehicle, error = self.failures[0]
                    raise TimedOut(f"{vehicle.name} has failed: {error!r}")
                if self.time_s > end:
                    raise TimedOut(f"not within {sim_s:g} s of simulated time")
                if not self._loop.ticked.wait(10.0):
                    raise TimedOut("the simulated world does not run")

    # ---- the pilots

    def take(self, name: str, mode: str | None, channels: Mapping[int, int]) -> None:
        """The hands of a vehicle's pilot: see :meth:`SimVehicle.hands`. Any thread may. :class:`BadInput` for a vehicle
        that is none of ours, or that a stack of its own flies: its radio is its own.
        """
        named = {vehicle.name: vehicle for vehicle in self.vehicles}
        if name not in named:
            expected = ", ".join(named) or "none"
            raise BadInput.wrong("vehicle", name, expected, f"{name}: no such vehicle with a simulated pilot")
        self._loop.inside(lambda: named[name].hands(mode, channels))

    # ---- faults

    def fault(self, vehicle: str, kind: str, *, for_s: float | None = None, **parameters: Any) -> list[FaultStatus]:
        """Let something go wrong with a vehicle (by name; "all": with each), for so many simulated seconds, or until it
        is cleared. :mod:`zmav.sim.faults` has the kinds and their parameters. Any thread may.

        Raises :class:`BadInput` naming what is not known, out of bounds, or not to be had by that vehicle.
        """
        return self.put_fault(vehicle, make_fault(kind, parameters), for_s)

    def put_fault(self, vehicle: str, fault: Fault, for_s: float | None = None) -> list[FaultStatus]:
        """As :meth:`fault`, with one that is made."""
        return self._loop.inside(lambda: self._faults.put(vehicle, fault, for_s))

    def clear(self, vehicle: str | None = None, kind: str | None = None) -> int:
        """End all faults, or those of one vehicle, of one kind, or of both; gives how many. Any thread may."""
        return self._loop.inside(lambda: self._faults.clear(vehicle, kind))

    def faults(self) -> list[FaultStatus]:
        """Those that are on. Any thread may ask."""
        return self._loop.inside(self._faults.all)

    # ---- what there is to see

    @property
    def urls(self) -> list[str]:
        """The first link URL of every vehicle."""
        return [vehicle.url for vehicle in self.vehicles]

    def camera(self, name: str) -> SimCamera:
        """The camera of the vehicle called ``name``; :class:`BadInput` names those that have one."""
        if self.cameras is None:
            expected = "VehicleSpec(camera=CameraSpec())"
            raise BadInput.wrong("camera", name, expected, "no vehicle has a camera")
        return self.cameras.get(name)

    def status(self) -> WorldStatus:
        """A snapshot; every thread may take one."""
        pacer = self.pacer
        return WorldStatus(
            time_s=self.time_s,
            speed=pacer.speed if math.isfinite(pacer.speed) else None,
            speed_reached=pacer.reached,
            paused=pacer.paused,
            behind=pacer.behind,
            lockstep=self.lockstep is not None,
            vehicles=self._faults.noted((*(vehicle.status() for vehicle in self.vehicles), *self.externals.status())),
        )
