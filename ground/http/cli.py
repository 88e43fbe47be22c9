"""``zmav http``."""

from __future__ import annotations

import click

from zmav.cli.common import fleet_option, zenoh_options
from zmav.errors import BadConfig
from zmav.session import SessionSettings


@click.command("http")
@fleet_option
@zenoh_options
def command(fleet: str, settings: SessionSettings) -> None:
    """Serve the fleet over HTTP and WebSocket."""
    raise BadConfig("http is not here yet")
