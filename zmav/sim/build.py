"""Puts a world's vehicles together from their specifications."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np

from zmav.mavlink.dialect import Dialect
from zmav.sim.arrays import Array
from zmav.sim.autopilots.arducopter.copter import ArduCopter
from zmav.sim.autopilots.arduplane.plane import ArduPlane
from zmav.sim.autopilots.ardurover.rover import ArduRover
from zmav.sim.autopilots.base import Installation
from zmav.sim.autopilots.px4.copter import Px4Copter
from zmav.sim.autopilots.px4.tuning import rows_for
from zmav.sim.dynamics.airframe import airframe
from zmav.sim.dynamics.roverframe import CAR
from zmav.sim.dynamics.wing import TRAINER
from zmav.sim.environment import Environment
from zmav.sim.fleets.base import Seat, Sense, Surroundings
from zmav.sim.fleets.copter import CopterFleet
from zmav.sim.fleets.plane import PlaneFleet
from zmav.sim.fleets.rover import RoverFleet
from zmav.sim.geo import Position
from zmav.sim.protocol.ardupilot.copter import CopterNode
from zmav.sim.protocol.ardupilot.plane import PlaneNode
from zmav.sim.protocol.ardupilot.rover import RoverNode
from zmav.sim.protocol.params import ParamStore, defaults
from zmav.sim.protocol.px4.copter import Px4CopterNode
from zmav.sim.spec import AIRFRAMES, ARDUPLANE, ARDUROVER, PX4, PX4_FIRMWARE, Home, VehicleSpec, airframe_of
from zmav.sim.vehicle import SimVehicle

AnyFleet = CopterFleet | RoverFleet | PlaneFleet
ROVERS, PLANES = AIRFRAMES[ARDUROVER], AIRFRAMES[ARDUPLANE]


class Squad:
    """The vehicles of one fleet, in the fleet's order."""

    def __init__(self, fleet: AnyFleet) -> None:
        self.fleet = fleet
        self.vehicles: list[SimVehicle] = []

    @property
    def hurries(self) -> bool:
        """Somebody hears one of them more often than its autopilot thinks, and is to hear new numbers each time."""
        return any(vehicle.node.hurries for vehicle in self.vehicles)


def build(
    specs: Sequence[VehicleSpec],
    *,
    home: Home,
    seed: int,
    environment: Environment,
    ready_s: float,
    noise: str,
    dt: float,
    dialect: Dialect,
    epoch_us: int,
) -> list[tuple[Squad, SimVehicle]]:
    """All vehicles in the order of ``specs``, which :mod:`zmav.sim.lineup` has filled in, each with the squad it flies
    in.
    """
    built: dict[int, tuple[Squad, SimVehicle]] = {}
    for kind, autopilot in sorted({(airframe_of(spec), spec.autopilot) for spec in specs}):
        members = [i for i, spec in enumerate(specs) if (airframe_of(spec), spec.autopilot) == (kind, autopilot)]
        start = np.array([specs[i].start_ned_m for i in members]).T
        yaw = np.radians([specs[i].yaw_deg or 0.0 for i in members])
        # Random numbers from the seed and the kind: adding another kind changes nothing for this one.
        kind_seed = (seed, *f"{autopilot} {kind}".encode("ascii", "replace"))
        around = Surroundings(environment=environment, place=home.position, seed=kind_seed, noise=noise)
        squad = Squad(_fleet(kind, autopilot, start, yaw, dt, around))
        senses = squad.fleet.senses()
        for place, i in enumerate(members):
            uid = specs[i].uid
            uid = _uid(seed, i) if uid is None else uid
            first = (senses[place], home.position, ready_s)
            vehicle = _wire(specs[i], squad.fleet, place, first, dialect, uid=uid, epoch_us=epoch_us)
            vehicle.node.seat = Seat(squad.fleet, place)
            vehicle.brain.plug(vehicle.node.seat.battery)
            vehicle.brain.sit(vehicle.node.seat)
            squad.vehicles.append(vehicle)
            built[i] = (squad, vehicle)
    return [built[i] for i in range(len(specs))]


def _fleet(kind: str, autopilot: str, start: Array, yaw: Array, dt: float, around: Surroundings) -> AnyFleet:
    """The vehicles of one airframe under one autopilot."""
    if kind in ROVERS:
        return RoverFleet(CAR, start, yaw, dt, around)
    if kind in PLANES:
        return PlaneFleet(TRAINER, start, yaw, dt, around)
    return CopterFleet(airframe(kind), start, yaw, dt, around, px4=autopilot == PX4)


def _wire(
    spec: VehicleSpec, fleet: AnyFleet, place: int, first: tuple[Sense, Position, float], dialect: Dialect, **node: int
) -> SimVehicle:
    """An autopilot on a body, by its fleet and its place there, and its MAVLink face. ``first``: what it senses, the
    origin of the world, and seconds to readiness; ``node``: the uid and the epoch of its node.
    """
    own = rows_for(fleet.airframe) if spec.autopilot == PX4 and isinstance(fleet, CopterFleet) else ()
    params = ParamStore(defaults(spec.autopilot), own)
    params.preset(spec.params)
    params.set("MAV_SYS_ID" if spec.autopilot == PX4 else "MAV_SYSID", spec.sysid or 1)
    if isinstance(fleet, RoverFleet):
        rover = ArduRover(Installation(fleet.airframe, fleet.handle(place), params, *first))
        return SimVehicle(spec, rover, RoverNode(rover, dialect, **node))
    if isinstance(fleet, PlaneFleet):
        plane = ArduPlane(Installation(fleet.airframe, fleet.handle(place), params, *first))
        return SimVehicle(spec, plane, PlaneNode(plane, dialect, **node))
    into = Installation(fleet.airframe, fleet.handle(place), params, *first)
    if spec.autopilot == PX4:
        px4 = Px4Copter(into)
        return SimVehicle(spec, px4, Px4CopterNode(px4, firmware=spec.firmware or PX4_FIRMWARE[0], **node))
    copter = ArduCopter(into)
    return SimVehicle(spec, copter, CopterNode(copter, dialect, **node))


def _uid(seed: int, index: int) -> int:
    """A number that no other vehicle of any world is likely to have, and this one always has."""
    digest = hashlib.blake2b(f"zmav-sim {seed} {index}".encode(), digest_size=8).digest()
    return int.from_bytes(digest, "little") or 1
