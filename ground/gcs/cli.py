"""``zmav gcs``."""

from __future__ import annotations

import click

from zmav.cli.common import fleet_option, zenoh_options
from zmav.errors import BadConfig
from zmav.session import SessionSettings


@click.command("gcs")
@fleet_option
@zenoh_options
def command(fleet: str, settings: SessionSettings) -> None:
    """Connect any ground control station to the whole fleet."""
    raise BadConfig("gcs is not here yet")
