"""``zmav router``: a router without a vehicle, for a ground station or a relay."""

from __future__ import annotations

import asyncio

import click

from zmav.cli.common import listening, run, zenoh_options
from zmav.process import until_stopped
from zmav.session import SessionSettings, open_session


@click.command("router")
@zenoh_options
def router(settings: SessionSettings) -> None:
    """Run a Zenoh router: 'zmav router -l tcp/127.0.0.1:7447 -e "udp/10.77.0.1:7447?rel=1;mixed_rel=1"'.

    It listens on loopback only unless told otherwise. Ground programs are its clients; it relays to and for vehicles.
    """
    run(_route(listening(settings)))


async def _route(settings: SessionSettings) -> None:
    with await asyncio.to_thread(open_session, settings) as session:
        click.echo(f"router {session.info.zid()} on {' '.join(settings.listen)}", err=True)
        await until_stopped()
