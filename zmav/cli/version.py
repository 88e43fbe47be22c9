"""``zmav --version``: which zmav, and with ``--json`` what others rely on: packages, dialect, key space."""

from __future__ import annotations

import inspect
from importlib.metadata import version

import click

from zmav.cli.common import dump


def show(as_json: bool) -> None:
    """Print it."""
    if not as_json:
        click.echo(f"zmav, version {version('zmav')}")
        return
    from zmav import client, schemas
    from zmav.host import versions

    dialect = inspect.signature(client.connect).parameters["dialect"].default
    channels = {each.name: each.version for each in schemas.spoken()}
    told = {"versions": versions(), "dialect": dialect, "schema": schemas.digest(), "channels": channels}
    click.echo(dump({"zmav": version("zmav"), **told}))
