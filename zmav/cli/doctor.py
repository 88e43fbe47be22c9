"""``zmav doctor``: one page of what is well and what is not, and what to do about each red line."""

from __future__ import annotations

import asyncio
import os
import platform
from pathlib import Path
from typing import Any

import click
import msgspec

import zmav
from zmav import host
from zmav.cli.common import dump, json_option, run, seconds_option, zenoh_options
from zmav.config import FleetConfig, VehicleConfig
from zmav.doctor import topics
from zmav.doctor.computer import check_bits, check_host, check_packages
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


class Options(msgspec.Struct, frozen=True):
    """What the options ask for."""

    link: str | None
    file: str | None
    name: str | None
    user: str | None
    disks: tuple[str, ...]
    seconds: float
    fleet: str | None
    settings: SessionSettings


@click.command("doctor")
@click.option("--link", metavar="URL", help="Open this link instead, without any router, and say what is heard on it.")
@click.option("--file", metavar="FILE", help="Fleet file: check it, too, and who of it is missing.")
@click.option("--name", help="With --file, which host of it this is: its link is looked at, too.")
@click.option("--user", help="Who runs zmav here, for the serial port.  [default: who asks; for root, zmav]")
@click.option("--disk", "disks", multiple=True, metavar="DIR", help="Look for room there, too (repeatable).")
@click.option("--fleet", help="Fleet to look at; '*' for all.  [default: the file's, $ZMAV_FLEET, or demo]")
@seconds_option
@json_option
@zenoh_options
def command(as_json: bool, **given: Any) -> None:
    """Examine this host, the routers and the vehicles: 'zmav doctor'; on a vehicle, with its serial port: 'zmav doctor
    --file /etc/zmav/vehicle.toml --name quad1'; or a link alone: 'zmav doctor --link /dev/ttyACM0'.

    Ends with 0 if nothing is red, else with 1. A serial port that some program has open is left to it.
    """
    options = Options(**given)
    if options.name is not None and options.file is None:
        raise click.UsageError("--name is a host of the fleet file: give --file, too")
    run(_doctor(options, as_json))


async def _doctor(options: Options, as_json: bool) -> None:
    findings = await _examine(options)
    if as_json:
        for finding in findings:
            click.echo(dump(finding.document()))
    else:
        for line in page(findings):
            click.echo(line)
    if any(not finding.ok for finding in findings):
        raise SystemExit(1)


async def _examine(options: Options) -> list[Finding]:
    """What is told of this host, the link and the fleet, in the page's order."""
    disks: list[str | Path] = ["/", default_directory(), *options.disks]
    own_report = await asyncio.to_thread(host.report, platform.node(), "", disks)
    here = [*check_bits(), *check_packages(), *check_host(own_report)]
    told, own = check_folder(options.settings.credentials)
    here += told
    if options.link is not None:
        found = await asyncio.to_thread(examine_link, options.link, "ardupilotmega", options.seconds, options.user)
        return here + found
    file = None
    if options.file is not None:
        told, file = check_file(options.file, options.name, own)
        here += told
    fleet: list[Finding] = []
    hears = None
    if own is not None or options.settings.credentials is None:  # no session opens with credentials that are not good
        fleet, hears = await _examine_fleet(options, file, own)
    table = file.vehicles.get(options.name or "") if file else None
    return here + (await _examine_own_link(options, table, hears) if table else []) + fleet


async def _examine_own_link(options: Options, table: VehicleConfig, hears: bool | None) -> list[Finding]:
    """The link of this vehicle: listened to only where no ``zmav up`` does (None), which ``hears`` its autopilot."""
    if hears is None:
        return await asyncio.to_thread(examine_link, table.link, table.dialect, options.seconds, options.user)
    found = await asyncio.to_thread(examine_device, table.link, options.user)
    if hears:
        return [*found, topics.OPEN.well(f"{table.link}: left to 'zmav up', which hears the autopilot")]
    text = f"{table.link}: left to 'zmav up', which hears no autopilot on it"
    advice = "to have the link listened to here, and baud rates tried, stop it first: systemctl stop zmav-vehicle"
    return [*found, topics.OPEN.advise(text, advice)]


async def _examine_fleet(
    options: Options, file: FleetConfig | None, own: Credentials | None
) -> tuple[list[Finding], bool | None]:
    """Findings, and whether the agent of this very vehicle hears its autopilot; None: none runs."""
    settings, name = options.settings, options.name
    named = settings.connect or settings.file or os.environ.get(CONNECT)
    if file is not None and name is not None and not named:
        settings = msgspec.structs.replace(settings, connect=(own_router(file, name),))
    fleet = options.fleet or (file.fleet if file else None) or os.environ.get("ZMAV_FLEET", "demo")
    try:
        async with zmav.open(fleet=fleet, settings=settings) as z:
            seen = await within(WHOLE_S + options.seconds, look(z, options.seconds, own, file, name))
            states = [v.last_state for v in seen.vehicles if v.name == name and v.present]
            return list(examine(seen)), any(s and s.connected for s in states) if states else None
    except SessionError as e:
        trouble = topics.ROUTER.wrong(e.message, "start 'zmav up' or 'zmav router' (systemctl status zmav-vehicle)")
    except asyncio.TimeoutError:
        trouble = topics.DOCTOR.wrong("the fleet was not examined in time", "look at hosts one by one with -e")
    except ZmavError as e:
        trouble = topics.ROUTER.wrong(e.message, "mend what is named, and ask again")
    return [trouble], None
