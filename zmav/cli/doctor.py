"""``zmav doctor``: one page of what is well and what is not, and what to do about each red line."""

from __future__ import annotations

import asyncio
import os
import platform
from pathlib import Path

import click
import msgspec

import zmav
from zmav import host
from zmav.cli.common import dump, json_option, run, seconds_option, zenoh_options
from zmav.config import FleetConfig, VehicleConfig
from zmav.doctor import topics
from zmav.doctor.computer import check_host, check_packages
from zmav.doctor.credentials import check_folder
from zmav.doctor.findings import Finding
from zmav.doctor.fleet_file import check_file, own_router
from zmav.doctor.link import examine_device, examine_link
from zmav.doctor.page import page
from zmav.doctor.survey import look
from zmav.doctor.vehicles import examine
from zmav.errors import SessionError, ZmavError
from zmav.services.files.store import default_directory
from zmav.session import CONNECT, SessionSettings
from zmav.trust.credentials import Credentials
from zmav.waiting import within

WHOLE_S = 60.0
"""s beside the listening after which what is left of the fleet's examination is given up"""


class Request(msgspec.Struct, frozen=True):
    """What the options ask for."""

    link: str | None
    file: str | None
    name: str | None
    user: str | None
    disks: tuple[str, ...]
    dialect: str | None
    seconds: float
    fleet: str | None
    settings: SessionSettings


class Agent(msgspec.Struct, frozen=True):
    """The ``zmav up`` of the vehicle that this host is."""

    hears: bool
    """its autopilot"""


@click.command("doctor")
@click.option("--link", metavar="URL", help="Open this link instead, without any router, and say what is heard on it.")
@click.option("--file", "fleet_file", metavar="FILE", help="Fleet file: check it, too, and who of it is missing.")
@click.option("--name", help="With --file, which host of it this is: its link is looked at, too.")
@click.option("--user", help="Who runs zmav here, for the serial port.  [default: who asks; for root, zmav]")
@click.option("--disk", "disks", multiple=True, metavar="DIR", help="Look for room there, too (repeatable).")
@click.option("--dialect", help="For the link: common, development...  [default: ardupilotmega, or the fleet file's]")
@click.option("--explain", is_flag=True, help="Say what each line means, and what to do about it; examine nothing.")
@click.option("--all", "whole", is_flag=True, help="Green lines of every vehicle, however many there are.")
@click.option("--fleet", help="Fleet to look at; '*' for all.  [default: the file's, $ZMAV_FLEET, or demo]")
@seconds_option
@json_option
@zenoh_options
def command(
    link: str | None,
    fleet_file: str | None,
    name: str | None,
    user: str | None,
    disks: tuple[str, ...],
    dialect: str | None,
    explain: bool,
    whole: bool,
    fleet: str | None,
    seconds: float,
    as_json: bool,
    settings: SessionSettings,
) -> None:
    """Examine this host, the routers and the vehicles: 'zmav doctor'; on a vehicle, with its serial port: 'zmav doctor
    --file /etc/zmav/vehicle.toml --name quad1'; or a link alone: 'zmav doctor --link /dev/ttyACM0'.

    Ends with 0 if nothing is red, else with 1. A serial port that some program has open is left to it.
    """
    if explain:
        click.echo(topics.explain(), nl=False)
        return
    if name is not None and fleet_file is None:
        raise click.UsageError("--name is a host of the fleet file: give --file, too")
    request = Request(link, fleet_file, name, user, disks, dialect, seconds, fleet, settings)
    run(_doctor(request, as_json, whole))


async def _doctor(request: Request, as_json: bool, whole: bool) -> None:
    findings = await _examine(request)
    if as_json:
        for finding in findings:
            click.echo(dump(finding.document(), pretty=False))
    else:
        for line in page(findings, whole):
            click.echo(line)
    if any(not finding.ok for finding in findings):
        raise SystemExit(1)


async def _examine(request: Request) -> list[Finding]:
    """What is told of this host, the link and the fleet, in the page's order."""
    disks: list[str | Path] = ["/", default_directory(), *request.disks]
    own_report = await asyncio.to_thread(host.report, platform.node(), "", disks)
    here = [*check_packages(), *check_host(own_report)]
    told, own = check_folder(request.settings.credentials)
    here += told
    if request.link is not None:
        dialect = request.dialect or "ardupilotmega"
        return here + await asyncio.to_thread(examine_link, request.link, dialect, request.seconds, request.user)
    file = None
    if request.file is not None:
        told, file = check_file(request.file, request.name, own)
        here += told
    fleet: list[Finding] = []
    agent = None
    if own is not None or request.settings.credentials is None:  # no session opens with credentials that are not good
        fleet, agent = await _examine_fleet(request, file, own)
    table = file.vehicles.get(request.name or "") if file else None
    return here + (await _examine_own_link(request, table, agent) if table else []) + fleet


async def _examine_own_link(request: Request, table: VehicleConfig, agent: Agent | None) -> list[Finding]:
    """The link of this vehicle: listened to only where no ``zmav up`` does."""
    if agent is None:
        dialect = request.dialect or table.dialect
        return await asyncio.to_thread(examine_link, table.link, dialect, request.seconds, request.user)
    found = await asyncio.to_thread(examine_device, table.link, request.user)
    if agent.hears:
        return [*found, topics.OPEN.well(f"{table.link}: left to 'zmav up', which hears the autopilot")]
    text = f"{table.link}: left to 'zmav up', which hears no autopilot on it"
    advice = "to have the link listened to here, and baud rates tried, stop it first: systemctl stop zmav-vehicle"
    return [*found, topics.OPEN.advise(text, advice)]


async def _examine_fleet(
    request: Request, file: FleetConfig | None, own: Credentials | None
) -> tuple[list[Finding], Agent | None]:
    """Findings, and the agent of this very vehicle where it runs."""
    settings, name = request.settings, request.name
    named = settings.connect or settings.file or os.environ.get(CONNECT)
    if file is not None and name is not None and not named:
        settings = msgspec.structs.replace(settings, connect=(own_router(file, name),))
    fleet = request.fleet or (file.fleet if file else None) or os.environ.get("ZMAV_FLEET", "demo")
    try:
        async with zmav.open(fleet=fleet, settings=settings) as z:
            seen = await within(WHOLE_S + request.seconds, look(z, request.seconds, own, file, name))
            own_agents = [v for v in seen.vehicles if v.name == name and v.present]
            states = [v.last_state for v in own_agents]
            return list(examine(seen)), Agent(any(s and s.connected for s in states)) if own_agents else None
    except SessionError as e:
        return [
            topics.ROUTER.wrong(e.message, "start 'zmav up' or 'zmav router' (systemctl status zmav-vehicle)")
        ], None
    except asyncio.TimeoutError:
        return [topics.DOCTOR.wrong("the fleet was not examined in time", "look at hosts one by one with -e")], None
    except ZmavError as e:
        return [topics.ROUTER.wrong(e.message, "mend what is named, and ask again")], None
