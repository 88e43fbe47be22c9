"""``zmav doctor``: what is well and what is not, a line each, and what to do about it."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import click
import msgspec

import zmav
from zmav.cli.common import dump, fleet_option, json_option, run, seconds_option, zenoh_options
from zmav.cli.examine import CHECKS, look, versions
from zmav.cli.finding import Finding
from zmav.cli.linkcheck import examine_link
from zmav.cli.trustcheck import check_folder
from zmav.errors import SessionError
from zmav.session import SessionSettings
from zmav.trust.credentials import Credentials


@click.command("doctor")
@click.option("--link", metavar="URL", help="Open this link instead, without any router, and say what is heard on it.")
@click.option("--dialect", default="ardupilotmega", show_default=True, help="With --link: common, an XML file...")
@seconds_option
@fleet_option
@json_option
@zenoh_options
def command(
    link: str | None, dialect: str, seconds: float, fleet: str, as_json: bool, settings: SessionSettings
) -> None:
    """Examine this host, the routers and the vehicles, or a link: 'zmav doctor --link /dev/ttyACM0'.

    Ends with 0 only if nothing is wrong.
    """
    run(_examine(link, dialect, seconds, fleet, as_json, settings))


async def _examine(
    link: str | None, dialect: str, seconds: float, fleet: str, as_json: bool, settings: SessionSettings
) -> None:
    findings = _tell(versions(), as_json)
    if link is not None:
        findings += _tell(await asyncio.to_thread(examine_link, link, dialect, seconds), as_json)
    else:
        told, own = check_folder(settings.credentials)
        findings += _tell(told, as_json)
        if own is not None or settings.credentials is None:  # no session opens with credentials that are not good
            findings += await _examine_fleet(fleet, settings, own, seconds, as_json)
    wrong = sum(not finding.ok for finding in findings)
    if not as_json:
        click.echo(f"{wrong} of {len(findings)} need attention" if wrong else "all is well")
    if wrong:
        raise SystemExit(1)


async def _examine_fleet(
    fleet: str, settings: SessionSettings, own: Credentials | None, seconds: float, as_json: bool
) -> list[Finding]:
    findings = []
    try:
        async with zmav.open(fleet=fleet, settings=settings) as z:
            seen = await look(z, seconds, own)
            for check in CHECKS:
                findings += _tell(check(seen), as_json)
    except SessionError as e:
        findings += _tell([Finding(False, "router", e.message)], as_json)
    return findings


def _tell(findings: list[Finding] | Iterator[Finding], as_json: bool) -> list[Finding]:
    """Say each as it is found."""
    told = []
    for finding in findings:
        told.append(finding)
        if as_json:
            click.echo(dump(msgspec.to_builtins(finding), pretty=False))
            continue
        mark = click.style("ok ", fg="green") if finding.ok else click.style("BAD", fg="red", bold=True)
        click.echo(f"{mark} {finding.subject}: {finding.found}")
        if finding.advice:
            click.echo(f"    {finding.advice}")
    return told
