"""``zmav view``."""

from __future__ import annotations

import click

from zmav.cli.common import fleet_option, zenoh_options
from zmav.errors import BadConfig
from zmav.session import SessionSettings


@click.command("view")
@fleet_option
@zenoh_options
def command(fleet: str, settings: SessionSettings) -> None:
    """Show the fleet in three dimensions."""
    raise BadConfig("view is not here yet")
