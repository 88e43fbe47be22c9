"""``zmav info``: the session, the routers and who is linked to whom."""

from __future__ import annotations

import json
from importlib.metadata import version
from typing import Any

import click

import zmav
from zmav.cli.common import dump, fleet_option, json_option, run, zenoh_options
from zmav.client import Answer, Client
from zmav.session import SessionSettings


@click.command("info")
@fleet_option
@json_option
@zenoh_options
def command(fleet: str, as_json: bool, settings: SessionSettings) -> None:
    """Show versions, this session, and every router with its links (from the routers' admin space)."""
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


async def routers(z: Client) -> list[dict[str, Any]]:
    """Every router that answers: its id and its sessions."""
    found = []
    for answer in await z.ask("@/*/router", timeout=2.0):
        if isinstance(answer, Answer):
            body = json.loads(answer.payload)
            links = [
                {
                    "peer": s["peer"],
                    "whatami": s["whatami"],
                    "links": [str(link.get("dst", link)) for link in s["links"]],
                }
                for s in body.get("sessions", [])
            ]
            found.append(
                {
                    "zid": answer.key.split("/")[1],
                    "version": str(body.get("version")).removeprefix("v").partition("-")[0],
                    "locators": body.get("locators", []),
                    "links": links,
                }
            )
    return found
