"""``zmav plan``: plan for a file."""

from __future__ import annotations

import click


@click.command("plan")
def command() -> None:
    """Plan the motion of a whole swarm from a scene file."""
    raise NotImplementedError
