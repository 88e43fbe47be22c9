"""The world: steps all vehicles at a fixed rate and serves their links, in real time, faster, or as a caller steps
it.
"""

from __future__ import annotations

import functools
import math
import selectors
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any, TypeVar

from zmav.errors import BadConfig, BadInput, TimedOut
from zmav.mavlink.dialect import load_dialect
from zmav.sim.build import Squad, build
from zmav.sim.calls import Calls
from zmav.sim.camera.cameras import Cameras, SimCamera
from zmav.sim.camera.cast import cast, equip
from zmav.sim.camera.scene import Scene
from zmav.sim.camera.spec import CameraSpec, PadSpec
from zmav.sim.clock import Pacer
from zmav.sim.endpoints import Wiring, addresses, open_endpoint
from zmav.sim.environment import Environment, Terrain, Vector
from zmav.sim.faults import Faults, FaultStatus, make_fault
from zmav.sim.hil.externals import Externals
from zmav.sim.lineup import gather, line_up
from zmav.sim.listener import Listener
from zmav.sim.lockstep import Lockstep
from zmav.sim.requests import offers
from zmav.sim.spec import Home, VehicleSpec, usual
from zmav.sim.status import WorldStatus
from zmav.sim.vehicle import SimVehicle

T = TypeVar("T")

LEAST_PHYSICS_HZ = 200
TICK_HZ, MOST_TICK_HZ = 100, 1000
TICK_S = 1.0 / TICK_HZ
DEFAULT_READY_S = 4.0
REALISTIC_READY_S = 41.4
STACK_WAIT_S = 0.01  # of wall time, that the world listens for a flight stack which is behind, at a time
LOOK_S = 0.05  # of wall time, between looks at how long a client has kept the world waiting
MOST = 1e6  # of any option that is a number: beyond it nothing makes sense


def _first_of(*choices: Sequence[str] | None) -> Sequence[str]:
    return next(choice for choice in choices if choice is not None)


class World:
    """Vehicles, their autopilots and their links on one clock.

    ``vehicles``: one :class:`VehicleSpec` each; ``copters``, ``hexas``, ``rovers``, ``planes``, ``px4``: so many plain
    ones of a kind after them. Nothing at all is one ArduCopter.
    ``endpoint``: for those whose spec names none, see :mod:`zmav.sim.endpoints`; several may be given (None:
    "ardupilot" or "px4"). ``speed``: times real time, ``math.inf`` as fast as it goes; ``lockstep``: but
    not faster than clients see it, see :mod:`zmav.sim.lockstep`.
    ``wind``, ``gusts``, ``terrain``: see :class:`Environment`. ``ready_s``: simulated seconds from boot to a position
    (:data:`REALISTIC_READY_S` is what the real autopilot takes; the other steps of its boot keep their proportions).
    ``noise``: of the sensors, a name of :data:`zmav.sim.sensors.noise.PROFILES`; ``gps_noise_m``: standard deviation
    per axis. ``tick_hz``: how often links are served, 100 to 1000 in hundreds: no stream is quicker, and a controller
    outside hears and is heard that often (each tick costs as much). ``epoch_s``: UTC at the start. ``scene``: what
    cameras see on the ground (:mod:`zmav.sim.camera`); ``cameras``, ``pads``: more of them, by vehicles' names.

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
        terrain: Terrain | None = None,
        lockstep: bool = False,
        ready_s: float = DEFAULT_READY_S,
        noise: str = "none",
        gps_noise_m: float = 0.0,
        tick_hz: int = TICK_HZ,
        epoch_s: float | None = None,
        scene: Scene | None = None,
        cameras: Mapping[str, CameraSpec] | None = None,
        pads: Mapping[str, PadSpec] | None = None,
    ) -> None:
        numbers = {"spacing_m": spacing_m, "ready_s": ready_s, "gps_noise_m": gps_noise_m, "wind": sum(map(abs, wind))}
        for field, value in numbers.items():
            if not 0.0 <= value < MOST:
                raise BadConfig(f"{field} {value}; expected 0 or more", field=field, value=value, expected="0 or more")
        if tick_hz not in range(TICK_HZ, MOST_TICK_HZ + 1, TICK_HZ):
            expected = f"{TICK_HZ} to {MOST_TICK_HZ} in hundreds"
            text = f"tick_hz {tick_hz}; expected {expected}"
            raise BadConfig(text, field="tick_hz", value=tick_hz, expected=expected)
        self.home = home or Home()
        self.ticks = 0
        self.tick_s = 1.0 / tick_hz
        self._pace, self._steps = tick_hz // TICK_HZ, max(LEAST_PHYSICS_HZ // tick_hz, 1)
        self.pacer = Pacer(self.tick_s, speed)
        counts = {"copter": copters, "hexa": hexas, "rover": rovers, "plane": planes, "px4": px4}
        self.environment = Environment(wind, terrain, gusts)
        specs = line_up(gather(vehicles, counts), self.home, spacing_m, self.environment.terrain)
        specs = equip(specs, cameras or {}, pads or {})
        default = (endpoint,) if isinstance(endpoint, str) else endpoint
        reached = addresses([_first_of(spec.endpoints, default, usual(spec)) for spec in specs])
        own = [i for i, spec in enumerate(specs) if spec.stack is None]
        self._specs, self._addresses = [specs[i] for i in own], [reached[i] for i in own]
        self.epoch_s = time.time() if epoch_s is None else epoch_s
        built = build(
            self._specs,
            home=self.home,
            seed=seed,
            environment=self.environment,
            ready_s=ready_s,
            noise=noise,
            gps_noise_m=gps_noise_m,
            dt=self.tick_s / self._steps,
            dialect=load_dialect("ardupilotmega"),
            epoch_us=int(self.epoch_s * 1e6),
        )
        self.vehicles: list[SimVehicle] = [vehicle for _, vehicle in built]
        for vehicle in self.vehicles:
            vehicle.node.on_defect = functools.partial(self._met, vehicle)
        self.externals = Externals(
            specs, reached, home=self.home, environment=self.environment, seed=seed, epoch_us=int(self.epoch_s * 1e6),
            speed=speed,
        )  # fmt: skip
        """the vehicles that flight stacks outside the simulator fly"""
        self._faults = Faults(self, seed)
        self._squads: list[Squad] = list({id(squad): squad for squad, _ in built}.values())
        for squad in self._squads:
            squad.fleet.pace = self._pace
        self.cameras: Cameras | None = None
        if any(spec.camera is not None for spec in specs):
            actors = cast(specs, self.vehicles, self.externals.vehicles)
            self.cameras = Cameras(actors, scene or Scene(), self.environment.terrain, seed, self.epoch_s, self._inside)
        self._selector = selectors.DefaultSelector()
        self.say: Callable[[str], None] = lambda text: None
        """takes what a person should know, a line at a time"""
        self.lockstep = Lockstep(self.vehicles, lambda text: self.say(text)) if lockstep else None
        self._wiring = Wiring(self._selector, set(), lambda: self.time_s)
        self._calls = Calls(self._selector)
        self._ticked = threading.Condition()
        self._thread: threading.Thread | None = None
        self._stopping = False
        self._runner: int | None = None  # the thread that runs the world, where one does
        self._failure: BaseException | None = None
        self.failures: list[tuple[SimVehicle, Exception]] = []
        """defects met while running, each with the vehicle whose autopilot had it; the others go on"""
        self.on_failure: Callable[[SimVehicle, Exception], None] = lambda vehicle, error: None
        self._listener: Listener | None = None
        self._advancing: Future[WorldStatus] | None = None

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

    def open(self, control: Path | None = None) -> None:
        """Open the endpoints, and the control socket at ``control`` (:mod:`zmav.sim.remote`). Raises
        :class:`PortInUse`; nothing stays open then.
        """
        try:
            for vehicle, addresses in zip(self.vehicles, self._addresses, strict=True):
                for address in addresses[len(vehicle.endpoints) :]:
                    vehicle.endpoints.append(open_endpoint(address, vehicle, self._wiring))
            self.externals.open(self._wiring)
            if control is not None and self._listener is None:
                self._listener = Listener(control, self._selector, offers(self))
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
        self._calls.ring()

    def close(self) -> None:
        """Stop and close everything. Raises what ended the thread, or the first defect of a vehicle."""
        self.stop()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        self._close_endpoints()
        self._selector.close()
        self._calls.close()
        self._advanced(TimedOut("the simulator has ended"))
        failure = self._failure or next((error for _, error in self.failures), None)
        self._failure = None
        self.failures.clear()
        if failure is not None:
            raise failure

    def _close_endpoints(self) -> None:
        if self.cameras is not None:
            self.cameras.close()
        if self._listener is not None:
            self._listener.close()
            self._listener = None
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
        """Run at ``speed`` times real time from now on; any thread may. :class:`BadConfig` unless it is more than 0."""
        self._inside(lambda: self.pacer.set_speed(speed))

    def pause(self) -> None:
        """Stand still: clients are answered, but no time passes. Any thread may."""
        self._inside(self._pause)

    def _pause(self) -> None:
        self.pacer.pause()
        self._advanced()

    def resume(self) -> None:
        """Go on. What was missed in the pause is not caught up with. Any thread may."""
        self._inside(self.pacer.resume)

    def advance(self, seconds: float) -> Future[WorldStatus]:
        """Run for ``seconds`` of simulated time at the world's speed, and pause; any thread may. The future is set when
        they are over, or when somebody pauses the world before. :class:`BadInput` for no time, or more than a million
        seconds.
        """
        if not self.tick_s / 2 <= seconds <= MOST:
            expected = f"{self.tick_s:.3g} to {MOST:.0f}"
            raise BadInput(f"{seconds} seconds; expected {expected}", field="seconds", value=seconds, expected=expected)
        return self._inside(lambda: self._advance(round(seconds / self.tick_s)))

    def _advance(self, ticks: int) -> Future[WorldStatus]:
        self._advanced()
        self._advancing = Future()
        self.pacer.allow(ticks)
        return self._advancing

    def _advanced(self, error: Exception | None = None) -> None:
        """Whoever waits for the end of :meth:`advance` need wait no longer."""
        waiting, self._advancing = self._advancing, None
        if waiting is None:
            return
        if error is None:
            waiting.set_result(self.status())
        else:
            waiting.set_exception(error)

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

    def _fail(self, vehicle: SimVehicle, error: Exception) -> None:
        """Its autopilot does nothing from now on."""
        if vehicle.failed is None:
            vehicle.failed = error
            self._record(vehicle, error)

    def _met(self, vehicle: SimVehicle, error: Exception) -> None:
        """A defect that does not stop the autopilot; in a stepped world it comes out where it was met."""
        if self._runner is None:
            raise error
        self._record(vehicle, error)

    def _record(self, vehicle: SimVehicle, error: Exception) -> None:
        """Keep and tell a defect, each once: a client may send what leads to it many times."""
        if all((vehicle, repr(error)) != (v, repr(e)) for v, e in self.failures):
            self.failures.append((vehicle, error))
            self.on_failure(vehicle, error)

    def _run_guarded(self) -> None:
        try:
            self._run()
        except BaseException as error:
            self._failure = error
            with self._ticked:
                self._ticked.notify_all()

    def _run(self) -> None:
        self._runner = threading.get_ident()
        self.pacer.restart()
        try:
            while not self._stopping:
                wait = self.pacer.wait_s()
                if wait == 0.0 and self.externals.behind():
                    wait = STACK_WAIT_S
                if wait > 0.0:
                    self._serve(wait)
                    self._flush()
                    continue
                if self.lockstep is not None and not self.lockstep.ready():
                    self._serve(LOOK_S)
                    self._flush()
                    continue
                self._serve(0.0)
                self._tick()
                if self.lockstep is not None:
                    self.lockstep.ticked(self.time_s)
                self._flush()
                with self._ticked:
                    self._ticked.notify_all()
                self.pacer.ticked()
                if self._advancing is not None and not self.pacer.stepping:
                    self._advanced()
        finally:
            self._runner = None

    # ---- links, and calls from other threads

    def serve(self) -> None:
        """Hear and answer clients of a world that :meth:`step` advances; only where no thread runs it."""
        self._serve(0.0)
        self._flush()

    def _serve(self, timeout: float) -> None:
        """Hear clients and calls for ``timeout`` seconds at most (infinite: until one comes)."""
        for key, _ in self._selector.select(timeout if math.isfinite(timeout) else None):
            ready: Callable[[], None] = key.data
            ready()
        self._calls.do()

    def _flush(self) -> None:
        self.externals.flush()
        waiting = self._wiring.waiting
        for each in list(waiting):
            if each.flush():
                waiting.discard(each)

    def _inside(self, function: Callable[[], T]) -> T:
        """Have the world's thread do it, where one runs and it is not this one."""
        return function() if self._runner in (None, threading.get_ident()) else self.call(function)

    def call(self, function: Callable[[], T], timeout: float = 10.0) -> T:
        """Run ``function`` between two ticks in the world's thread; gives its result, or raises what it raised.

        Raises :class:`TimedOut` where the world does not run.
        """
        return self._calls.call(function, timeout)

    def wait_for(self, true: Callable[[], bool], sim_s: float = 120.0) -> None:
        """Wait until ``true()`` holds, looked at after every tick; :class:`TimedOut` after ``sim_s`` simulated
        seconds.
        """
        end = self.time_s + sim_s
        with self._ticked:
            while not true():
                if self._failure is not None:
                    raise TimedOut(f"the simulated world has failed: {self._failure!r}")
                if self.failures:
                    vehicle, error = self.failures[0]
                    raise TimedOut(f"{vehicle.name} has failed: {error!r}")
                if self.time_s > end:
                    raise TimedOut(f"not within {sim_s:g} s of simulated time")
                if not self._ticked.wait(10.0):
                    raise TimedOut("the simulated world does not run")

    # ---- faults

    def fault(self, vehicle: str, kind: str, *, for_s: float | None = None, **parameters: Any) -> list[FaultStatus]:
        """Let something go wrong with a vehicle (by name; "all": with each), for so many simulated seconds, or until it
        is cleared. :mod:`zmav.sim.faults` has the kinds and their parameters. Any thread may.

        Raises :class:`BadInput` naming what is not known, out of bounds, or not to be had by that vehicle.
        """
        fault = make_fault(kind, parameters)
        return self._inside(lambda: self._faults.put(vehicle, fault, for_s))

    def clear(self, vehicle: str | None = None, kind: str | None = None) -> int:
        """End all faults, or those of one vehicle, of one kind, or of both; gives how many. Any thread may."""
        return self._inside(lambda: self._faults.clear(vehicle, kind))

    def faults(self) -> list[FaultStatus]:
        """Those that are on. Any thread may ask."""
        return self._inside(self._faults.all)

    # ---- what there is to see

    @property
    def urls(self) -> list[str]:
        """The first link URL of every vehicle."""
        return [vehicle.url for vehicle in self.vehicles]

    def camera(self, name: str) -> SimCamera:
        """The camera of the vehicle called ``name``; :class:`BadInput` names those that have one."""
        if self.cameras is None:
            expected = "VehicleSpec(camera=CameraSpec())"
            raise BadInput(
                f"no vehicle has a camera; expected {expected}", field="camera", value=name, expected=expected
            )
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
            given_up_s=pacer.given_up_s,
            cpu_share=pacer.cpu_share,
            clients=sum(endpoint.clients() for vehicle in self.vehicles for endpoint in vehicle.endpoints),
            lockstep=self.lockstep is not None,
            vehicles=self._faults.noted((*(vehicle.status() for vehicle in self.vehicles), *self.externals.status())),
        )
