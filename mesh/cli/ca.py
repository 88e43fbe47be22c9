"""``zmav mesh ca``: the fleet's authority: who is a member, as what, until when, and who no longer."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable
from pathlib import Path

import click
import msgspec

import zmav
from mesh.credentials import files
from mesh.credentials.ca import DAYS, Authority, together
from mesh.credentials.certify import day
from mesh.credentials.ledger import LEDGER, read_ledger
from zmav.cli.common import dump, json_option, run, show_table, tell, zenoh_options
from zmav.doctor.credentials import rosters
from zmav.errors import BadConfig, BadInput, ZmavError
from zmav.session import SessionSettings
from zmav.trust.certificate import Role
from zmav.trust.credentials import ROSTER, Credentials
from zmav.trust.roster import HeldRoster

PASSPHRASE = "ZMAV_CA_PASSPHRASE"
DEFAULT = "fleet-ca"
PATIENCE_S = 10.0
"""for routers to answer, some of them over bad links"""

ca_option = click.option(
    "--ca",
    "folder",
    metavar="DIR",
    default=lambda: os.environ.get("ZMAV_CA", DEFAULT),
    show_default=f"{DEFAULT}, or $ZMAV_CA",
    help="The authority's folder.",
)
days_option = click.option(
    "--days", type=click.IntRange(1, 3650), default=DAYS, show_default=True, help="How long it is valid."
)


def out_option(what: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    return click.option("--out", metavar="FOLDER", help=f"{what}  [default: members/NAME in the authority's folder]")


@click.group("ca")
def command() -> None:
    """The fleet's authority: certificates of its members, and the roster of who is one.

    Its folder belongs on a computer that does not fly. A member's folder goes to that member and nowhere else.
    """


@command.command("init")
@click.argument("directory", required=False)
@click.option("--fleet", default=lambda: os.environ.get("ZMAV_FLEET", "demo"), show_default="demo, or $ZMAV_FLEET")
@click.option("--passphrase", is_flag=True, help=f"Encrypt the key: asked for, or ${PASSPHRASE}.")
def init(directory: str | None, fleet: str, passphrase: bool) -> None:
    """Make an authority: 'zmav mesh ca init --fleet alpha --passphrase'."""
    folder = directory or os.environ.get("ZMAV_CA", DEFAULT)
    Authority.create(folder, fleet, _new_passphrase() if passphrase or PASSPHRASE in os.environ else None)
    click.echo(f"authority of {fleet} in {folder}: keep ca-key.pem to yourself, and a copy in a safe place")


@command.command("issue")
@click.argument("name")
@click.option("--role", type=click.Choice([role.value for role in Role]), required=True)
@days_option
@out_option("Where the member's folder is made.")
@click.option("--again", is_flag=True, help="Although a certificate of that name was revoked and has not ended.")
@ca_option
def issue(name: str, role: str, days: int, out: str | None, again: bool, folder: str) -> None:
    """Admit a member: 'zmav mesh ca issue quad1 --role vehicle --out quad1'.

    A vehicle's name is its name in the fleet file, so is a ground host's.
    """
    authority = _open(folder)
    made = authority.issue(name, Role(role), days, out, again=again)
    click.echo(f"{made}: carry it to {name}, and start it there with --credentials")
    authority.refresh()


@command.command("renew")
@click.argument("name", required=False)
@click.option("--all", "every", is_flag=True, help="All that end within 30 days.")
@days_option
@out_option("Where the member's folder is made, in the place of the one there.")
@ca_option
def renew(name: str | None, every: bool, days: int, out: str | None, folder: str) -> None:
    """Give a member a new key and certificate; the old one stays good until its end."""
    if (name is None) != every or (every and out):
        raise click.UsageError("give a NAME, or --all (without --out)")
    authority = _open(folder)
    names = authority.ending() if name is None else [name]
    faults: list[BadConfig] = []
    for each in names:
        try:
            click.echo(f"{authority.renew(each, days, out)}: carry it to {each}, in the place of the old one")
        except BadConfig as e:  # the others' certificates end, too
            faults.append(e)
    if not names:
        click.echo("none ends within 30 days")
    try:
        authority.refresh()
    except BadConfig as e:
        faults.append(e)
    if faults:
        raise together(faults)


@command.command("revoke")
@click.argument("name")
@ca_option
def revoke(name: str, folder: str) -> None:
    """Turn a member out; tell the fleet with 'zmav mesh ca roster --publish'."""
    authority = _open(folder)
    gone = authority.revoke(name)
    for entry in gone:
        click.echo(f"revoked {name} ({entry.role.value}, until {day(entry.not_after)}): {entry.fingerprint}")
    click.echo("tell the running fleet: zmav mesh ca roster --publish")
    authority.refresh()


@command.command("list")
@json_option
@ca_option
def list_members(as_json: bool, folder: str) -> None:
    """Every certificate that was issued."""
    ledger, now = read_ledger(Path(folder)), time.time()
    if as_json:
        for entry in ledger.entries:
            click.echo(dump(msgspec.to_builtins(entry), pretty=False))
        return
    rows = []
    for entry in ledger.entries:
        state = "revoked" if entry.revoked is not None else ("ended" if now > entry.not_after else "")
        rows.append((entry.name, entry.role.value, day(entry.not_after), state, entry.fingerprint))
    show_table(("name", "role", "valid until", "", "fingerprint"), rows)


@command.command("roster")
@click.option("--publish", is_flag=True, help="Tell the running fleet, through the router of -e.")
@click.option("--fetch", is_flag=True, help="Bring the fleet's newer one into the folder of --credentials.")
@json_option
@ca_option
@zenoh_options
def roster(publish: bool, fetch: bool, as_json: bool, folder: str, settings: SessionSettings) -> None:
    """Show the roster, or bring it to the running fleet: every router keeps it, passes it on and acts by it.

    Where there is no authority's folder, it is that of the member's folder of --credentials.
    """
    own = Credentials.load(settings.credentials) if settings.credentials else None
    if fetch:
        if own is None:
            raise BadConfig("--fetch needs a member's folder: --credentials DIR", field="credentials", value=None)
        run(_fetch(settings, own))
        return
    here = Path(folder)
    if own is not None and not (here / LEDGER).exists():
        fleet, found, here = own.fleet, own.roster, own.folder
    else:
        ledger = read_ledger(here)
        fleet, found = ledger.fleet, ledger.roster(time.time())
    if publish:
        try:
            signed = (here / ROSTER).read_bytes()
        except OSError as e:
            text = f"cannot read {here / ROSTER}: {e.strerror}; 'zmav mesh ca renew' and 'revoke' write it again"
            raise BadConfig(text, field="ca", value=str(here / ROSTER), expected="a roster") from e
        run(_publish(settings, fleet, signed, found.number))
        return
    text = f"{found.fleet}, number {found.number}: {len(found.members)} members, {len(found.revoked)} revoked"
    tell(as_json, msgspec.to_builtins(found), text)


async def _publish(settings: SessionSettings, fleet: str, signed: bytes, number: int) -> None:
    """Ends with 1 where no router took it."""
    async with zmav.open(fleet=fleet, settings=settings) as z:
        answers = await rosters(z, fleet, payload=signed, timeout=PATIENCE_S)
    for answer in answers:
        if isinstance(answer, ZmavError):
            click.echo(f"refused: {answer}", err=True)
        else:
            click.echo(f"{answer.name} has number {answer.number}")
    if not any(isinstance(answer, HeldRoster) and answer.number >= number for answer in answers):
        text = f"no router of the fleet took number {number}: is -e a router that has credentials? Else say it again"
        raise BadConfig(text, field="connect")


async def _fetch(settings: SessionSettings, own: Credentials) -> None:
    """Ends with 1 where no router has one."""
    async with zmav.open(fleet=own.fleet, settings=settings) as z:
        answers = await rosters(z, own.fleet, newer=own.roster.number, timeout=PATIENCE_S)
    held = [answer for answer in answers if isinstance(answer, HeldRoster)]
    if not held:
        raise BadConfig("no router of the fleet has a roster: is -e a router that has credentials?", field="connect")
    newest = own.roster
    for signed in (answer.newer for answer in held if answer.newer is not None):
        with contextlib.suppress(BadInput):  # anybody can say that it has one: the authority's is looked for
            found = signed.open(own.authority, own.fleet)
            if found.number > newest.number:
                newest = found
                files.write(own.folder / ROSTER, msgspec.json.encode(signed))
    if newest is own.roster:
        click.echo(f"number {own.roster.number} is the fleet's, too")
    else:
        click.echo(f"number {newest.number}, in the place of {own.roster.number}")


def _open(folder: str) -> Authority:
    return Authority.open(folder, _passphrase)


def _passphrase() -> bytes:
    found = os.environ.get(PASSPHRASE)
    return (click.prompt("passphrase", hide_input=True, err=True) if found is None else found).encode()


def _new_passphrase() -> bytes:
    """Raises :class:`BadConfig` for an empty one."""
    found = os.environ.get(PASSPHRASE)
    if found is None:
        found = str(click.prompt("passphrase", hide_input=True, confirmation_prompt=True, err=True))
    if not found:
        raise BadConfig("an empty passphrase protects nothing", field="passphrase", value="", expected="a passphrase")
    return found.encode()
