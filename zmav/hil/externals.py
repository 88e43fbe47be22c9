"""All vehicles of a world that flight stacks outside the simulator fly: made, opened, paced and watched together."""

from __future__ import annotations

import collections
import math
import shutil
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from zmav.errors import BadConfig
from zmav.hil.ardupilot import JsonVehicle, json_port
from zmav.hil.binaries import Job, Program, ardupilot_job, find_ardupilot, find_px4, px4_job
from zmav.hil.craft import Craft, craft
from zmav.hil.hardware import HardwareVehicle
from zmav.hil.plant import Plant
from zmav.hil.px4 import Px4Vehicle, px4_port
from zmav.hil.vehicle import External
from zmav.mavlink import load_dialect
from zmav.sim.endpoints import Address, Wiring
from zmav.sim.environment import Environment
from zmav.sim.external import Externals as NoExternals
from zmav.sim.fleets.base import Surroundings
from zmav.sim.spec import PX4, Home, VehicleSpec, airframe_of
from zmav.sim.status import VehicleStatus

STEP_S = 1.0 / 400.0  # of a plant, until its stack asks for another
GRACE_S = 2.0  # of wall time, for all programs together, between being asked to end and being killed
WATCH_S = 1.0  # of wall time, between looks at the programs
MOST_NOTES = 1000
NOISE = "typical"  # flight stacks take sensors without any for broken ones


class Externals(NoExternals):
    """``specs``: all of the world's vehicles, of which those with a ``stack`` are made here; ``addresses``: of the
    endpoints of each. The instance number of a stack, unless it is given, is its place among the world's vehicles with
    such an autopilot; of a PX4 that is started here, whose system id follows from it, one less than that. ``speed``:
    the world's. ``say``: takes what a person should know, a line at a time; None: the last ones are kept.
    """

    def __init__(
        self,
        specs: Sequence[VehicleSpec],
        addresses: Sequence[Sequence[Address]],
        *,
        home: Home,
        environment: Environment,
        seed: int,
        epoch_us: int,
        speed: float,
        noise: str = "none",
        say: Callable[[str], None] | None = None,
    ) -> None:
        self.notes: collections.deque[str] = collections.deque(maxlen=MOST_NOTES)
        self.say = say or self.notes.append
        self._home = home
        self._noise = NOISE if noise == "none" else noise
        self._environment = environment
        self._seed = seed
        self._dialect = load_dialect("ardupilotmega")
        self._epoch_us = epoch_us
        self._asked_speed = speed
        self._speed = speed if math.isfinite(speed) else 1.0
        self._programs: dict[str, Program] = {}
        self._jobs: list[tuple[External, Path, Callable[[Path], Job]]] = []
        self._temporary: Path | None = None
        self._next_look = 0.0
        self._open = False
        self.vehicles: list[External] = []
        instances = {True: 0, False: 0}  # by whether it is a PX4
        for spec, reached in zip(specs, addresses, strict=True):
            if spec.stack is not None:
                instance = spec.stack.instance
                if instance is None:
                    started = spec.autopilot == PX4 and spec.stack.program is not None
                    instance = (spec.sysid or 1) - 1 if started else instances[spec.autopilot == PX4]
                self.vehicles.append(self._make(instance, spec, reached))
            instances[spec.autopilot == PX4] += 1

    # ---- making them

    def _make(self, i: int, spec: VehicleSpec, addresses: Sequence[Address]) -> External:
        stack, name, sysid = spec.stack, spec.name or "", spec.sysid or 1
        assert stack is not None
        frame = craft(airframe_of(spec))
        if spec.autopilot == PX4 and stack.program is not None and not frame.px4_airframe:
            text = f"{name}: no PX4 is started for the body {frame.name!r}; expected quad or sih"
            raise BadConfig(text, field="airframe", value=frame.name, expected="quad or sih")
        plant = self._plant(spec, frame)
        vehicle: External
        if stack.device is not None:
            if self._asked_speed != 1.0:
                text = f"{name}: real hardware flies in real time, not at {self._asked_speed:g} times that"
                raise BadConfig(text, field="speed", value=self._asked_speed, expected="1")
            vehicle = HardwareVehicle(
                name, sysid, plant, self.say, self._dialect, self._epoch_us, stack.device, addresses
            )
        elif spec.autopilot == PX4:
            port = px4_port(i) if stack.port is None else stack.port
            vehicle = Px4Vehicle(name, sysid, plant, self.say, self._dialect, self._epoch_us, port)
        else:
            port = json_port(i) if stack.port is None else stack.port
            vehicle = JsonVehicle(name, sysid, plant, self.say, port)
        if stack.program is not None:
            self._plan(i, spec, frame, vehicle)
        return vehicle

    def _plant(self, spec: VehicleSpec, frame: Craft) -> Plant:
        seed = (self._seed, *(spec.name or "").encode("ascii"))
        around = Surroundings(environment=self._environment, place=self._home.position, seed=seed, noise=self._noise)
        return Plant(frame, spec.start_ned_m or (0.0, 0.0, 0.0), math.radians(spec.yaw_deg or 0.0), STEP_S, around)

    def _plan(self, i: int, spec: VehicleSpec, frame: Craft, vehicle: External) -> None:
        """Find its binary now, so that what is missing is said before anything is opened."""
        stack = spec.stack
        assert stack is not None and stack.program is not None
        path, heading, home = Path(stack.program), spec.yaw_deg or 0.0, vehicle.plant.place
        binary = find_px4(path) if spec.autopilot == PX4 else find_ardupilot(path, frame.program)

        def job(directory: Path) -> Job:
            given: dict[str, Any] = {"instance": i, "sysid": vehicle.sysid, "home": home, "heading_deg": heading}
            given["speed"] = self._speed
            if isinstance(vehicle, JsonVehicle):
                return ardupilot_job(binary, frame, directory=directory, port=vehicle.port, **given)
            return px4_job(binary, frame, **given)

        self._jobs.append((vehicle, Path(stack.directory) if stack.directory else Path(), job))

    # ---- life

    def open(self, wiring: Wiring) -> None:
        """Open everything, then start the programs; nothing where that is done. Raises :class:`PortInUse`,
        :class:`BadUrl`, :class:`BadConfig`; :meth:`close` is for the caller to call then.
        """
        if self._open:
            return
        self._open = True
        for vehicle in self.vehicles:
            vehicle.open(wiring)
        for vehicle, kept, job in self._jobs:
            directory = (kept / vehicle.name).expanduser().absolute() if kept != Path() else self._scratch(vehicle.name)
            found = job(directory)
            self._programs[vehicle.name] = Program(found.command, directory, found.environment)
            vehicle.reached = found.urls

    def _scratch(self, name: str) -> Path:
        if self._temporary is None:
            self._temporary = Path(tempfile.mkdtemp(prefix="zmav-sim-"))
        return self._temporary / name

    def close(self) -> None:
        self._open = False
        programs = list(self._programs.values())
        self._programs.clear()
        for program in programs:
            program.ask()
        end = time.monotonic() + GRACE_S
        for program in programs:
            program.stop(max(end - time.monotonic(), 0.0))
        for vehicle in self.vehicles:
            vehicle.close()
        if self._temporary is not None:
            shutil.rmtree(self._temporary, ignore_errors=True)
            self._temporary = None

    # ---- time

    def grant(self, now: float) -> None:
        """The world has come to ``now``, seconds."""
        for vehicle in self.vehicles:
            vehicle.grant(now)
        if self._programs and time.monotonic() >= self._next_look:
            self._next_look = time.monotonic() + WATCH_S
            self._look()

    def behind(self) -> bool:
        """The world has to wait for one of them."""
        return any(vehicle.behind() for vehicle in self.vehicles)

    def flush(self) -> None:
        for vehicle in self.vehicles:
            vehicle.flush()

    def _look(self) -> None:
        """Say which program has ended; the others go on."""
        for vehicle in self.vehicles:
            program = self._programs.get(vehicle.name)
            how = program.ended() if program is not None else None
            if program is not None and how is not None:
                del self._programs[vehicle.name]
                vehicle.lost(how)
                said = program.last_lines()
                self.say(
                    f"{vehicle.name}: {program.command[0]} has ended ({how})"
                    + (f"; its last lines:\n{said}" if said else "")
                )

    # ---- what there is to see

    def pids(self) -> dict[str, int]:
        """Process ids of the programs that run, by vehicle."""
        return {name: program.pid for name, program in self._programs.items()}

    def status(self) -> tuple[VehicleStatus, ...]:
        return tuple(vehicle.status() for vehicle in self.vehicles)
