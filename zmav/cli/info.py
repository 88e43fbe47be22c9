"""``zmav info``: the session, the routers, who is linked to whom and how well."""

from __future__ import annotations

import contextlib
from importlib.metadata import version
from typing import Any

import click
import msgspec
from rich.table import Table

import zmav
from zmav import keys, wire
from zmav.cli.common import console, dump, fleet_option, json_option, run, zenoh_options
from zmav.client import Answer, Client
from zmav.doctor.admin import routers
from zmav.errors import BadInput
from zmav.session import SessionSettings


@click.command("info")
@fleet_option
@json_option
@zenoh_options
def command(fleet: str, as_json: bool, settings: SessionSettings) -> None:
    """Show versions, this session, every router with its links, and what routers measured of their neighbours.

    Loss has two values: to the neighbour and from it. 'zmav mesh graph' finds each vehicle's weakest hop in this.
    """
    run(_info(fleet, as_json, settings))


async def _info(fleet: str, as_json: bool, settings: SessionSettings) -> None:
    async with zmav.open(fleet=fleet, settings=settings) as z:
        await z.settle()
        known: dict[str, Any] = {
            "versions": {name: version(name) for name in ("zmav", "eclipse-zenoh", "pymavlink", "msgspec")},
            "session": str(z.session.info.zid()),
            "connected_to": [str(zid) for zid in z.session.info.routers_zid()],
            "routers": await routers(z),
            "vehicles": {v.name: v.last_state.instance if v.last_state else None for v in z.fleet()},
        }
        measured = await neighbours(z)
    known["neighbours"] = [{"host": host, **msgspec.to_builtins(quality)} for host, quality in measured]
    if as_json:
        click.echo(dump(known, pretty=False))
        return
    click.echo("  ".join(f"{k} {v}" for k, v in known["versions"].items()))
    click.echo(f"session {known['session']}, connected to {', '.join(known['connected_to'])}")
    names = {instance: name for name, instance in known["vehicles"].items()}
    for router in known["routers"]:
        click.echo(f"router {router['zid']}  {names.get(router['zid'], '')}")
        for link in router["links"]:
            click.echo(
                f"  {link['whatami']:7} {link['peer']}  {names.get(link['peer'], '')}  {' '.join(link['links'])}"
            )
    if measured:
        console().print(neighbour_view(measured))


async def neighbours(z: Client) -> list[tuple[str, wire.NeighbourQuality]]:
    """What each host's router says of its neighbours, by their names."""
    found = {}
    for answer in await z.ask(keys.LINK.key(z.fleet_name, "*", link="*"), timeout=1.0, channel=keys.LINK):
        if isinstance(answer, Answer):
            with contextlib.suppress(BadInput):
                parts, quality = keys.match(answer.key)[1], wire.decode_link(answer.payload)
                if isinstance(quality, wire.NeighbourQuality) and quality.name == keys.check_name(parts["link"]):
                    found[parts["vehicle"], quality.name] = quality
    return [(host, found[host, name]) for host, name in sorted(found)]


def neighbour_view(measured: list[tuple[str, wire.NeighbourQuality]]) -> Table:
    """A dash for what is not known; what is not up is red."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("host", "neighbour", "state", "RTT ms", "loss", "heard"):
        table.add_column(name, justify="right" if name in ("RTT ms", "heard") else "left", no_wrap=True)
    for host, q in measured:
        losses = " / ".join("-" if loss is None else f"{loss:.0%}" for loss in (q.loss_out, q.loss_in))
        rtt = "-" if q.rtt is None else f"{1e3 * q.rtt:.1f}"
        heard = "-" if q.age is None else f"{q.age:.1f} s"
        table.add_row(host, q.name, q.state, rtt, losses, heard, style="" if q.state == "up" else "red")
    return table
