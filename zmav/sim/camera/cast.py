"""Who is to be seen in a world, and who has a camera or a landing pad."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import msgspec

from zmav.errors import BadConfig
from zmav.sim.camera.spec import CameraSpec, PadSpec, check_camera, check_pad
from zmav.sim.external import External
from zmav.sim.fleets.base import Fleet
from zmav.sim.spec import VehicleSpec
from zmav.sim.vehicle import SimVehicle


class Actor(NamedTuple):
    """One vehicle: the one in that column of its fleet."""

    name: str
    camera: CameraSpec | None
    pad: PadSpec | None
    fleet: Fleet
    column: int


def equip(
    specs: Sequence[VehicleSpec], cameras: Mapping[str, CameraSpec], pads: Mapping[str, PadSpec]
) -> list[VehicleSpec]:
    """``specs``, which have names, with these cameras and pads, by vehicles' names. :class:`BadConfig` names a vehicle
    that is not there, or what is wrong with its camera or pad.
    """
    there = [spec.name for spec in specs]
    for field, names in (("camera", cameras), ("pad", pads)):
        for name in names:
            if name not in there:
                expected = ", ".join(each or "" for each in there)
                text = f"{field} for {name!r}, but there is no such vehicle; expected one of {expected}"
                raise BadConfig(text, field=field, value=name, expected=expected)
    for name, camera in cameras.items():
        check_camera(camera, f"{name}: camera")
    for name, pad in pads.items():
        check_pad(pad, f"{name}: pad")
    return [
        msgspec.structs.replace(
            spec, camera=cameras.get(spec.name or "", spec.camera), pad=pads.get(spec.name or "", spec.pad)
        )
        for spec in specs
    ]


def cast(specs: Sequence[VehicleSpec], own: Sequence[SimVehicle], external: Sequence[External]) -> list[Actor]:
    """Everybody in the order of ``specs``: vehicles that the simulator flies, and those that other flight stacks do."""
    ours, theirs = iter(own), iter(external)
    actors = []
    for spec in specs:
        if spec.stack is None:
            vehicle = next(ours)
            seat = vehicle.node.seat
            actors.append(Actor(vehicle.name, spec.camera, spec.pad, seat.fleet, seat.index))
        else:
            other = next(theirs)
            actors.append(Actor(other.name, spec.camera, spec.pad, other.plant, 0))
    return actors
