"""Puts a world's vehicles together from their specifications."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence

import numpy as np

from zmav.errors import BadConfig
from zmav.mavlink.dialect import Dialect
from zmav.sim.autopilots.arducopter.copter import ArduCopter
from zmav.sim.autopilots.px4.copter import Px4Copter
from zmav.sim.control.setpoints import SetpointHandle
from zmav.sim.dynamics.airframe import Airframe, airframe
from zmav.sim.environment import Environment
from zmav.sim.fleets.base import Seat, Sense, Surroundings
from zmav.sim.fleets.copter import CopterFleet
from zmav.sim.geo import Position
from zmav.sim.protocol.ardupilot.copter import CopterNode
from zmav.sim.protocol.base import Node
from zmav.sim.protocol.params import ParamStore, defaults
from zmav.sim.protocol.px4.node import Px4Node
from zmav.sim.spec import PX4, Home, VehicleSpec, airframe_of, check
from zmav.sim.vehicle import Autopilot, SimVehicle


class Squad:
    """The vehicles of one fleet, in the fleet's order."""

    def __init__(self, fleet: CopterFleet) -> None:
        self.fleet = fleet
        self.vehicles: list[SimVehicle] = []


def as_specs(vehicles: Sequence[VehicleSpec], counts: Mapping[str, int]) -> list[VehicleSpec]:
    """The vehicles named, and so many plain ones of each autopilot; one ArduCopter where nothing is asked for.
    :class:`BadConfig` for more than there are system ids.
    """
    specs = list(vehicles)
    for autopilot, count in counts.items():
        if count < 0:
            raise BadConfig(f"{count} vehicles; expected 0 or more", field="copters", value=count, expected="0 or more")
        specs += [VehicleSpec(autopilot=autopilot) for _ in range(count)]
    specs = specs or [VehicleSpec()]
    if not 1 <= len(specs) <= 255:
        raise BadConfig(
            f"{len(specs)} vehicles; expected 1 to 255", field="vehicles", value=len(specs), expected="1 to 255"
        )
    return specs


def build(
    specs: Sequence[VehicleSpec],
    *,
    home: Home,
    spacing_m: float,
    seed: int,
    environment: Environment,
    ready_s: float,
    gps_noise_m: float,
    dt: float,
    dialect: Dialect,
    epoch_us: int,
) -> list[tuple[Squad, SimVehicle]]:
    """All vehicles in the order of ``specs``, each with the squad it flies in."""
    for i, spec in enumerate(specs):
        check(spec, _name(spec, i))
    starts = [spec.start_ned_m or (0.0, i * spacing_m, 0.0) for i, spec in enumerate(specs)]
    yaws = [math.radians(home.yaw_deg if spec.yaw_deg is None else spec.yaw_deg) for spec in specs]
    built: dict[int, tuple[Squad, SimVehicle]] = {}
    for kind in sorted({airframe_of(spec) for spec in specs}):
        members = [i for i, spec in enumerate(specs) if airframe_of(spec) == kind]
        start = np.array([starts[i] for i in members]).T
        yaw = np.array([yaws[i] for i in members])
        # Random numbers from the seed and the kind: adding another kind changes nothing for this one.
        kind_seed = (seed, *kind.encode("ascii", "replace"))
        around = Surroundings(environment=environment, place=home.position, seed=kind_seed, gps_noise_m=gps_noise_m)
        squad = Squad(CopterFleet(airframe(kind), start, yaw, dt, around))
        senses = squad.fleet.senses()
        for place, i in enumerate(members):
            uid = specs[i].uid
            vehicle = _wire(
                specs[i],
                i,
                (squad.fleet.airframe, squad.fleet.handle(place), senses[place], home.position, ready_s),
                dialect,
                uid=_uid(seed, i) if uid is None else uid,
                epoch_us=epoch_us,
            )
            vehicle.node.seat = Seat(squad.fleet, place)
            squad.vehicles.append(vehicle)
            built[i] = (squad, vehicle)
    return [built[i] for i in range(len(specs))]


def _name(spec: VehicleSpec, index: int) -> str:
    return spec.name or f"copter{index + 1}"


def _wire(
    spec: VehicleSpec,
    index: int,
    body: tuple[Airframe, SetpointHandle, Sense, Position, float],
    dialect: Dialect,
    *,
    uid: int,
    epoch_us: int,
) -> SimVehicle:
    """An autopilot on a ``body`` (airframe, controllers, senses, origin of the world, seconds to readiness), and its
    MAVLink face.
    """
    frame, setpoint, sense, world, ready_s = body
    params = ParamStore(defaults(spec.autopilot))
    params.preset(spec.params)
    params.set("MAV_SYS_ID" if spec.autopilot == PX4 else "MAV_SYSID", spec.sysid or index + 1)
    brain: Autopilot
    node: Node
    if spec.autopilot == PX4:
        brain = Px4Copter(frame, params, setpoint, sense, world, ready_s)
        node = Px4Node(brain, uid=uid, epoch_us=epoch_us)
    else:
        brain = ArduCopter(frame, params, setpoint, sense, world, ready_s)
        node = CopterNode(brain, dialect, uid=uid, epoch_us=epoch_us)
    return SimVehicle(_name(spec, index), brain, node)


def _uid(seed: int, index: int) -> int:
    """A number that no other vehicle of any world is likely to have, and this one always has."""
    digest = hashlib.blake2b(f"zmav-sim {seed} {index}".encode(), digest_size=8).digest()
    return int.from_bytes(digest, "little") or 1
