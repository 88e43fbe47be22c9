"""Puts a world's vehicles together from their specifications."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence

import numpy as np

from zmav.errors import BadConfig
from zmav.mavlink.dialect import Dialect
from zmav.sim.autopilots.arducopter import ArduCopter
from zmav.sim.control.setpoints import Vector
from zmav.sim.dynamics.airframe import airframe
from zmav.sim.fleet import CopterFleet
from zmav.sim.protocol.node import MavNode
from zmav.sim.protocol.params import ParamStore, defaults
from zmav.sim.spec import Home, VehicleSpec, check
from zmav.sim.vehicle import SimVehicle


class Squad:
    """The vehicles of one fleet, in the fleet's order."""

    def __init__(self, fleet: CopterFleet) -> None:
        self.fleet = fleet
        self.vehicles: list[SimVehicle] = []


def as_specs(copters: int | Sequence[VehicleSpec]) -> list[VehicleSpec]:
    """So many plain copters, or the list itself; :class:`BadConfig` for fewer than one or more than there are system
    ids.
    """
    specs = [VehicleSpec() for _ in range(copters)] if isinstance(copters, int) else list(copters)
    if not 1 <= len(specs) <= 255:
        raise BadConfig(
            f"{len(specs)} vehicles; expected 1 to 255", field="copters", value=len(specs), expected="1 to 255"
        )
    return specs


def build(
    specs: Sequence[VehicleSpec],
    *,
    home: Home,
    spacing_m: float,
    seed: int,
    wind: Vector,
    ready_s: float,
    gps_noise_m: float,
    dt: float,
    dialect: Dialect,
    epoch_us: int,
) -> list[tuple[Squad, SimVehicle]]:
    """All vehicles in the order of ``specs``, each with the squad it flies in."""
    for i, spec in enumerate(specs):
        check(spec, spec.name or f"copter{i + 1}")
    starts = [spec.start_ned_m or (0.0, i * spacing_m, 0.0) for i, spec in enumerate(specs)]
    yaws = [math.radians(home.yaw_deg if spec.yaw_deg is None else spec.yaw_deg) for spec in specs]
    built: dict[int, tuple[Squad, SimVehicle]] = {}
    for kind in sorted({spec.airframe for spec in specs}):
        members = [i for i, spec in enumerate(specs) if spec.airframe == kind]
        start = np.array([starts[i] for i in members]).T
        yaw = np.array([yaws[i] for i in members])
        # One generator per fleet, from the seed and the kind: adding another kind changes nothing for this one.
        rng = np.random.default_rng([seed, *kind.encode("ascii", "replace")])
        squad = Squad(CopterFleet(airframe(kind), start, yaw, dt, rng, gps_noise_m))
        squad.fleet.dynamics.wind[:] = np.array(wind)[:, None]
        senses = squad.fleet.senses()
        for place, i in enumerate(members):
            params = ParamStore(defaults("arducopter"))
            params.preset(specs[i].params)
            params.set("MAV_SYSID", specs[i].sysid or i + 1)
            copter = ArduCopter(
                squad.fleet.airframe, params, squad.fleet.handle(place), senses[place], home.position, ready_s
            )
            uid = specs[i].uid
            node = MavNode(copter, dialect, uid=_uid(seed, i) if uid is None else uid, epoch_us=epoch_us)
            node.wind = wind
            node.throttles = _column(squad.fleet, "throttle", place)
            node.rotor_speeds = _column(squad.fleet, "rotor", place)
            vehicle = SimVehicle(specs[i].name or f"copter{i + 1}", copter, node)
            squad.vehicles.append(vehicle)
            built[i] = (squad, vehicle)
    return [built[i] for i in range(len(specs))]


def _column(fleet: CopterFleet, name: str, place: int) -> Callable[[], list[float]]:
    """Reads one vehicle's rotors out of an array of the physics."""
    return lambda: [float(value) for value in getattr(fleet.dynamics, name)[:, place]]


def _uid(seed: int, index: int) -> int:
    """A number that no other vehicle of any world is likely to have, and this one always has."""
    digest = hashlib.blake2b(f"zmav-sim {seed} {index}".encode(), digest_size=8).digest()
    return int.from_bytes(digest, "little") or 1
