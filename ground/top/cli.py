"""``zmav top``."""

from __future__ import annotations

import click

from zmav.cli.common import fleet_option, zenoh_options
from zmav.errors import BadConfig
from zmav.session import SessionSettings


@click.command("top")
@fleet_option
@zenoh_options
def command(fleet: str, settings: SessionSettings) -> None:
    """Watch the fleet in the terminal."""
    raise BadConfig("top is not here yet")
