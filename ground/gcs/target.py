"""Whom a client's frame is for, as far as those who answer in the vehicles' place are concerned: autopilots only."""

from __future__ import annotations

import zmav
from ground.gcs.answerer import GcsClient, Ground
from zmav.mavlink import Frame, targets


def is_for_autopilots(ground: Ground, client: GcsClient, frame: Frame) -> bool:
    """It is for one autopilot that the client may see, or for all of them. Any thread."""
    system, component = targets(frame, ground.dialect)
    if not system:
        return bool(ground.systems())
    return component in (0, ground.component(system)) and bool(vehicles(ground, client, frame))


def vehicles(ground: Ground, client: GcsClient, frame: Frame) -> list[tuple[int, zmav.Vehicle]]:
    """The vehicles whose autopilots are meant, by system id; none that the client does not see, nor any of those that
    share an id. Any thread.
    """
    system, _ = targets(frame, ground.dialect)
    present = ground.systems()
    wanted = [system] if system in present else [] if system else present
    found = [(sysid, vehicle) for sysid in wanted if (vehicle := ground.vehicle(sysid)) is not None]
    return [(sysid, vehicle) for sysid, vehicle in found if client.options.sees(vehicle.name)]
