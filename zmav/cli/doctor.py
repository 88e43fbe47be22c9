"""``zmav doctor``: one page of what is well and what is not, and what to do about each red line."""

from __future__ import annotations

import asyncio
import itertools
import os
import platform
from collections.abc import Iterable, Iterator
from pathlib import Path

import click
import msgspec

import zmav
from zmav import host
from zmav.cli import topics
from zmav.cli.common import dump, json_option, run, seconds_option, zenoh_options
from zmav.cli.examine import examine
from zmav.cli.filecheck import check_file, own_router
from zmav.cli.finding import GROUPS, HOST, VEHICLE, Finding, Level, shown
from zmav.cli.hostcheck import check_host, check_packages
from zmav.cli.linkcheck import examine_link, serial_of
from zmav.cli.lookround import look
from zmav.cli.trustcheck import check_folder
from zmav.config import FleetConfig, VehicleConfig
from zmav.errors import SessionError, ZmavError
from zmav.services.store import default_directory
from zmav.session import SessionSettings
from zmav.trust.credentials import Credentials
from zmav.waiting import within

WHOLE_S = 60.0
"""s beside the listening after which what is left of the fleet's examination is given up"""
FEW = 4
"""vehicles up to which each has its green lines on the page, too"""
MARKS = {
    Level.OK: click.style("ok ", fg="green"),
    Level.ADVICE: click.style("...", fg="yellow"),
    Level.RED: click.style("RED", fg="red", bold=True),
}


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


@click.command("doctor")
@click.option("--link", metavar="URL", help="Open this link instead, without any router, and say what is heard on it.")
@click.option("--file", "fleet_file", metavar="FILE", help="Fleet file: check it, too, and who of it is missing.")
@click.option("--name", help="With --file, which host of it this is: its link is looked at, too.")
@click.option("--user", help="Who runs zmav here, for the serial port.  [default: who asks; for root, zmav]")
@click.option("--disk", "disks", multiple=True, metavar="DIR", help="Look for room there, too (repeatable).")
@click.option("--dialect", help="For the link: common, an XML file...  [default: ardupilotmega, or the fleet file's]")
@click.option("--explain", is_flag=True, help="Say what each line means, and what to do about it; examine nothing.")
@click.option("--all", "whole", is_flag=True, help="Green lines of every vehicle, however many there are.")
@click.option("--fleet", help="Fleet to look at; '*' for all.  [default: the file's, $ZMAV_FLEET, or demo]")
@seconds_option
@json_option
@zenoh_options
def command(
    link: str | None, fleet_file: str | None, name: str | None, user: str | None, disks: tuple[str, ...],
    dialect: str | None, explain: bool, whole: bool, fleet: str | None, seconds: float, as_json: bool,
    settings: SessionSettings,
) -> None:  # fmt: skip
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
    if own is None and request.settings.credentials is not None:  # no session opens with credentials that are not good
        fleet: list[Finding] = []
        running = False
    else:
        fleet, running = await _examine_fleet(request, file, own)
    table = file.vehicles.get(request.name or "") if file else None
    link = await _examine_own_link(request, table, running) if table else []
    return here + link + fleet


async def _examine_own_link(request: Request, table: VehicleConfig, running: bool) -> list[Finding]:
    """The link of this vehicle: listened to only where no ``zmav up`` does."""
    dialect = request.dialect or table.dialect
    if running and serial_of(table.link) is None:
        return [topics.OPEN.well(f"{table.link}: left to 'zmav up', which runs")]
    return await asyncio.to_thread(examine_link, table.link, dialect, request.seconds, request.user)


async def _examine_fleet(
    request: Request, file: FleetConfig | None, own: Credentials | None
) -> tuple[list[Finding], bool]:
    """Findings, and whether the agent of this very vehicle is there."""
    settings, name = request.settings, request.name
    if file is not None and name is not None and not settings.connect and not settings.file:
        settings = msgspec.structs.replace(settings, connect=(own_router(file, name),))
    fleet = request.fleet or (file.fleet if file else None) or os.environ.get("ZMAV_FLEET", "demo")
    try:
        async with zmav.open(fleet=fleet, settings=settings) as z:
            seen = await within(WHOLE_S + request.seconds, look(z, request.seconds, own, file, name))
            found = list(examine(seen))
            return found, name is not None and any(v.name == name and v.present for v in seen.vehicles)
    except SessionError as e:
        return [
            topics.ROUTER.wrong(e.message, "start 'zmav up' or 'zmav router' (systemctl status zmav-vehicle)")
        ], False
    except asyncio.TimeoutError:
        return [topics.DOCTOR.wrong("the fleet was not examined in time", "look at hosts one by one with -e")], False
    except ZmavError as e:
        return [topics.ROUTER.wrong(e.message, "mend what is named, and ask again")], False


# The page.


def page(findings: list[Finding], whole: bool = False) -> Iterator[str]:
    """The findings as lines, grouped; of many vehicles only those in trouble have lines of their own."""
    groups: dict[str, list[Finding]] = {}
    for finding in sorted(findings, key=_place):
        groups.setdefault(finding.heading, []).append(finding)
    hosts = [heading for heading, found in groups.items() if found[0].group == VEHICLE]
    quiet = [h for h in hosts if all(f.level is Level.OK for f in groups[h])]
    hidden = set(quiet) if len(hosts) > FEW and not whole else set()
    for heading, found in groups.items():
        if heading in hidden:
            continue
        if len(hosts) > FEW and heading in hosts and not whole:
            found = [finding for finding in found if finding.level is not Level.OK]
        yield click.style(shown(f"{heading} ({platform.node()})" if heading == HOST else heading), bold=True)
        for finding in found:
            yield from _lines(finding)
    if hidden:
        yield f"{click.style('all is well', fg='green')} at {shown(', '.join(sorted(hidden)))}  (--all shows it)"
    yield _sum(findings)


def _place(finding: Finding) -> tuple[int, str]:
    return GROUPS.index(finding.group), finding.who if finding.group == VEHICLE else ""


def _lines(finding: Finding) -> Iterator[str]:
    topic = finding.topic if finding.group == VEHICLE else finding.subject
    yield f"  {MARKS[finding.level]} {shown(topic)}: {shown(finding.found)}"
    if finding.advice:
        yield f"        -> {shown(finding.advice)}"


def _sum(findings: Iterable[Finding]) -> str:
    counts = {level: len(list(group)) for level, group in itertools.groupby(sorted(f.level.value for f in findings))}
    red, amber, green = (counts.get(level.value, 0) for level in (Level.RED, Level.ADVICE, Level.OK))
    more = f"{green} ok" + (f", {amber} to consider" if amber else "")
    return f"{red} red, {more}" if red else f"all is well: {more}"
