"""``zmav delay``: how far away a vehicle is, in time."""

from __future__ import annotations

import statistics
import time

import click

import zmav
from zmav import keys
from zmav.cli.common import fleet_option, json_option, run, zenoh_options
from zmav.cli.hz import show
from zmav.client import Client
from zmav.session import SessionSettings


@click.command("delay")
@click.argument("vehicles", nargs=-1)
@click.option("-n", "--count", default=20, show_default=True, help="Round trips a vehicle.")
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
        if vehicles:
            await z.wait_for(*vehicles)
        else:
            await z.news(1.5)
        rows = []
        for name in vehicles or tuple(v.name for v in z.fleet()):
            trips = sorted([1e3 * await z.vehicle(name).ping() for _ in range(count)])
            ages = await _ages(z, name)
            rows.append(
                {
                    "vehicle": name, "min_ms": trips[0], "median_ms": statistics.median(trips), "max_ms": trips[-1],
                    "state_age_ms": statistics.median(ages),
                }
            )  # fmt: skip
    show(rows, as_json, ("vehicle", "min_ms", "median_ms", "max_ms", "state_age_ms"))


async def _ages(z: Client, name: str) -> list[float]:
    """Milliseconds between writing and hearing of three states."""
    ages = []
    async with z.subscribe(keys.STATE.key(z.fleet_name, name)) as states:
        for _ in range(3):
            sample = await states.get()
            state = zmav.wire.decode(sample.payload.to_bytes(), zmav.VehicleState, "state")
            ages.append(1e3 * (time.time() - state.t))
    return ages
