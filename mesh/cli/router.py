"""``zmav router``: a router without a vehicle, for a ground station or a relay."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import click

from mesh.cli.options import file_option, insecure_option, plan_host
from mesh.plan import RouterPlan
from mesh.router import Router
from mesh.running import until_outdated
from zmav.cli.common import run, zenoh_options
from zmav.process import log, restart
from zmav.session import SessionSettings


@click.command("router")
@file_option
@click.option("--name", help="The host's name in the fleet.  [default: the credentials', or the computer's]")
@click.option("--fleet", help="The fleet's name.  [default: demo, or the fleet file's]")
@insecure_option
@zenoh_options
def router(
    fleet_file: str | None, name: str | None, fleet: str | None, insecure: bool, settings: SessionSettings
) -> None:
    """Run a Zenoh router: 'zmav router --file fleet.toml --name ground'.

    It listens on loopback only unless the fleet file, -l or -e say otherwise, and beyond it only with --credentials or
    --insecure. Ground programs are its clients; it relays to and for vehicles.
    """
    plan = partial(plan_host, fleet_file, name, settings, fleet=fleet, insecure=insecure)
    run(_route(plan, settings))


async def _route(plan: Callable[[], RouterPlan], settings: SessionSettings) -> None:
    planned = plan()
    async with Router(planned, settings) as router:
        line = f"router {router.session.info.zid()} on {' '.join(planned.listens)}"
        why = await until_outdated(router, line, plan)
    if why:
        log(f"starting again: {why}")
        restart()
