"""``zmav mesh``: the network between the vehicles, its credentials and its measurements. One verb a file."""

from __future__ import annotations

import importlib

import click

VERBS: tuple[str, ...] = ("bench", "ca", "config", "graph")
"""each is ``command`` in its own file here"""


class Verbs(click.Group):
    """Loads a verb's file only when the verb is used."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted(VERBS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in VERBS:
            return None
        found = importlib.import_module(f"mesh.cli.{name}").command
        assert isinstance(found, click.Command)
        return found


@click.command("mesh", cls=Verbs)
def mesh() -> None:
    """Routers that relay for each other: how they are linked, how well, who may do what, and what it costs."""
