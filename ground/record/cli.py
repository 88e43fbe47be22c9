"""``zmav record``."""

from __future__ import annotations

import click

from zmav.cli.common import fleet_option, zenoh_options
from zmav.errors import BadConfig
from zmav.session import SessionSettings


@click.command("record")
@fleet_option
@zenoh_options
def command(fleet: str, settings: SessionSettings) -> None:
    """Record the fleet, and answer questions of what was."""
    raise BadConfig("record is not here yet")
