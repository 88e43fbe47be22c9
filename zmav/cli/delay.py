"""``zmav delay``: how far away a vehicle is, in time."""

from __future__ import annotations

import asyncio
import statistics
import time

import click
import zenoh

import zmav
from zmav import keys, wire
from zmav.cli.common import fleet_option, json_option, run, zenoh_options
from zmav.cli.hz import show
from zmav.client import Client
from zmav.errors import NoSuchVehicle, Stale
from zmav.session import SessionSettings
from zmav.waiting import within


@click.command("delay")
@click.argument("vehicles", nargs=-1)
@click.option("-n", "--count", type=click.IntRange(1), default=20, show_default=True, help="Round trips a vehicle.")
@fleet_option
@json_option
@zenoh_options
def command(vehicles: tuple[str, ...], count: int, fleet: str, as_json: bool, settings: SessionSettings) -> None:
    """Measure round trips to vehicles (all by default), and the age of their state on arrival.

    The age compares two clocks: it is as good as their synchronisation. Round trips need none.
    """
    run(_delay(vehicles, count, fleet, as_json, settings))


async def _delay(vehicles: tuple[str, ...], count: int, fleet: str, as_json: bool, settings: SessionSettings) -> None:
    async with zmav.open(fleet=fleet, settings=settings) as z:
        found = await (z.wait_for(*vehicles) if vehicles else z.settle())
        if not found:
            raise NoSuchVehicle(f"no vehicle is present in fleet {fleet}")
        rows = []
        for vehicle in found:
            trips = [1e3 * await vehicle.ping() for _ in range(count)]
            rows.append(
                {
                    "vehicle": vehicle.name,
                    "min_ms": min(trips),
                    "median_ms": statistics.median(trips),
                    "max_ms": max(trips),
                    "state_age_ms": 1e3 * statistics.median(await ages(z, vehicle)),
                }
            )
    show(rows, as_json, ("vehicle", "min_ms", "median_ms", "max_ms", "state_age_ms"))


async def ages(z: Client, vehicle: zmav.Vehicle, count: int = 3) -> list[float]:
    """Seconds between writing and hearing of the next states, by two clocks; raises :class:`Stale`."""
    found: list[float] = []
    async with z.subscribe(keys.STATE.key(vehicle.fleet, vehicle.name), _age) as states:
        try:
            while len(found) < count:
                found.append(await within(keys.STATE.stale_after or 0.0, states.get()))
        except asyncio.TimeoutError:
            raise Stale(f"{vehicle.name} answers but does not publish its state", vehicle=vehicle.name) from None
    return found


def _age(sample: zenoh.Sample) -> float:
    """``t`` is of the moment the state was built; a subscription's reader is awake within a millisecond."""
    return time.time() - wire.decode(sample.payload.to_bytes(), wire.VehicleState, "state").t
