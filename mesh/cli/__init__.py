"""``zmav mesh``: the network between the vehicles, its credentials and its measurements. One verb a file."""

from __future__ import annotations

import click

from zmav.cli.common import Verbs


@click.command("mesh", cls=Verbs, package="mesh.cli", files=("bench", "ca", "config", "graph"))
def mesh() -> None:
    """Routers that relay for each other: how they are linked, how well, who may do what, and what it costs."""
