"""``zmav mesh config``: what a host's router is opened with, and where each value came from."""

from __future__ import annotations

import json
from typing import Any

import click
from rich.table import Table
from rich.text import Text

from mesh.bearer.bearers import borne, foreseen
from mesh.cli.options import file_option, insecure_option, plan_host
from zmav.cli.common import console, dump, json_option, zenoh_options
from zmav.session import SessionSettings

WIDEST = 200


@click.command("config")
@file_option
@click.option("--name", help="The host's name in the fleet.  [default: the credentials', or the computer's]")
@insecure_option
@json_option
@zenoh_options
def command(fleet_file: str | None, name: str | None, insecure: bool, as_json: bool, settings: SessionSettings) -> None:
    """What results from the fleet file: 'zmav mesh config --file fleet.toml --name quad1'.

    'zmav up' and 'zmav router' open their Zenoh router with these values. Interfaces are those of this computer.
    """
    plan, fars = foreseen(plan_host(fleet_file, name, settings, insecure=insecure))
    rows = {path: {"value": setting.value, "source": setting.source} for path, setting in sorted(plan.settings.items())}
    if as_json:
        about = {"fleet": plan.fleet, "name": plan.name, "profile": plan.profile}
        ways = {n.name: [[w.radio.interface, w.address, w.port] for w in n.ways] for n in plan.neighbours}
        bearers = {far.name: [[borne(plan)[place].address, *to, cost] for place, to, cost in far.ways] for far in fars}
        click.echo(dump({**about, "neighbours": ways, "bearers": bearers, "settings": rows}, pretty=False))
        return
    table = Table("path", "value", "from", title=f"{plan.fleet}/{plan.name}, profile {plan.profile}")
    for path, row in rows.items():
        table.add_row(
            path, Text(_short(row["value"]), overflow="fold"), Text(str(row["source"]))
        )  # brackets are no markup
    console().print(table)
    for far in fars:
        paths = ", ".join(
            f"{borne(plan)[place].address} > {to[0]}:{to[1]} (cost {cost})" for place, to, cost in far.ways
        )
        click.echo(f"bearer to {far.name}: {paths}; the link is opened by {'us' if far.opens else far.name}")
    for radio in plan.radios:
        state = f"{radio.address}" if radio.address else "no address"
        click.echo(f"radio {radio.name}: {state}{'' if radio.present else ', not there yet: it will be waited for'}")


def _short(value: Any) -> str:
    if isinstance(value, list) and all(isinstance(each, str) for each in value):
        return "\n".join(value) or "none"
    text = json.dumps(value)
    return text if len(text) <= WIDEST else f"{text[:WIDEST]}... ({len(text)} characters; --json shows them)"
