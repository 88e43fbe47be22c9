"""The process of one vehicle: the router, and beside it the adapter and the services."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

import zenoh

from mesh.credentials.rosterwatch import RosterWatch
from mesh.plan import RouterPlan
from mesh.router import Router
from mesh.running import until_outdated
from zmav import keys, systemd, wire
from zmav.bus import Alive
from zmav.client import Client
from zmav.errors import BadInput
from zmav.onboard import Onboard, OnboardSettings
from zmav.process import log, restart
from zmav.session import SessionSettings


async def run_vehicle(
    vehicle: OnboardSettings, plan: RouterPlan, settings: SessionSettings, plan_again: Callable[[], RouterPlan]
) -> None:
    async with Router(plan, settings) as router:
        client = Client(settings, vehicle.fleet, vehicle.dialect)
        client.adopt(router.session)

        async def tell(agent: str, verb: str, args: dict[str, Any]) -> dict[str, Any]:
            return await client.vehicle(vehicle.name).tell(agent, verb, **args)

        onboard = Onboard(router.session, vehicle, tell=tell)
        for watch in router.running:
            if isinstance(watch, RosterWatch):
                watch.tell(onboard.take_roster)
        onboard.bus.on(Alive, lambda told: systemd.notify("WATCHDOG=1"))
        router.session.declare_subscriber(keys.EVENT.key(vehicle.fleet, vehicle.name), _log)
        async with onboard:
            line = f"{vehicle.fleet}/{vehicle.name}: {vehicle.link} on {' '.join(plan.listens)}"
            why = await until_outdated(
                router, line, plan_again, lambda: not onboard.identity.armed and onboard.leases.holder is None
            )
    if why:
        log(f"starting again: {why}")
        restart()


def _log(sample: zenoh.Sample) -> None:
    """An event as a line of the process's log: what happens to the link and the autopilot, and what was refused."""
    with contextlib.suppress(BadInput):  # somebody else's: ours are what they should be
        event = wire.decode(sample.payload.to_bytes(), wire.Event, "event")
        log(f"{event.severity}: {event.text}")
