"""What ``zmav doctor`` says of credentials: our own folder, the fleet's rosters, the vehicles' certificates."""

from __future__ import annotations

import asyncio
import datetime
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

import msgspec
import zenoh

from zmav import keys, wire
from zmav.client import OVER, Client
from zmav.doctor import topics
from zmav.doctor.findings import Finding
from zmav.errors import BadInput, ZmavError
from zmav.services.queries.everybody import ask_everybody
from zmav.trust.certificate import SOON, Certificate
from zmav.trust.credentials import Credentials
from zmav.trust.roster import HeldRoster

RENEW = "renew it where the authority is: zmav mesh ca renew"


class Trust(msgspec.Struct, frozen=True):
    """What was seen of the fleet's credentials; None where we have none to judge them by."""

    own: Credentials
    rosters: list[HeldRoster | ZmavError]
    certificates: dict[str, Certificate | ZmavError]
    """by vehicle"""


async def look_at_trust(z: Client, own: Credentials | None, vehicles: Iterable[str]) -> Trust | None:
    """Ask the routers for their rosters and the vehicles for their certificates."""
    if own is None:
        return None
    names = list(vehicles)
    held = await rosters(z, own.fleet)
    shown = await asyncio.gather(*(_certificate(z, own, name) for name in names))
    return Trust(own, held, dict(zip(names, shown, strict=True)))


async def rosters(
    z: Client, fleet: str, payload: bytes = b"", *, newer: int | None = None, timeout: float = 2.0
) -> list[HeldRoster | ZmavError]:
    """Every router's answer: which roster it has, after it was offered the signed one in ``payload``.

    It comes itself where it is newer than the number ``newer``.
    """
    key = keys.FLEET.key(fleet, topic=keys.ROSTER) + (f"?newer={newer}" if newer is not None else "")

    deadline, found = time.monotonic() + timeout, list[HeldRoster | ZmavError]()
    while not found and (left := deadline - time.monotonic()) > 0:
        for reply in await asyncio.to_thread(_all_replies, z, key, payload, left):
            if reply.ok is not None:
                found.append(_decoded(reply.ok.payload.to_bytes()))
            elif reply.err is not None and (said := reply.err.payload.to_bytes()) != OVER:
                found.append(wire.error_from(said))
        if not found:  # a session that has just opened may not know yet who answers
            await asyncio.sleep(0.2)
    return found


def _all_replies(z: Client, key: str, payload: bytes, timeout: float) -> list[zenoh.Reply]:
    return list(ask_everybody(z.session, keys.Qos.MUST_ARRIVE, key, None, timeout=timeout, payload=payload))


def _decoded(data: bytes) -> HeldRoster | ZmavError:
    try:
        held = wire.decode(data, HeldRoster, "roster")
        keys.check_name(held.name)
        return held
    except BadInput as e:
        return e


async def _certificate(z: Client, own: Credentials, name: str) -> Certificate | ZmavError:
    """The vehicle's, of all that are shown in its place; else what is wrong with the first."""
    found: list[Certificate | ZmavError] = []
    for reply in await asyncio.to_thread(_all_replies, z, keys.CERTIFICATE.key(own.fleet, name), b"", 2.0):
        if reply.ok is None:
            continue
        try:
            found.append(shown := Certificate.read(reply.ok.payload.to_bytes()))
            shown.check_issuer(own.authority)
        except BadInput as e:
            found.append(e)
        else:
            if shown.name == name:
                return shown
    return found[0] if found else ZmavError(f"{name} shows no certificate")


def check_folder(folder: str | None, now: float | None = None) -> tuple[list[Finding], Credentials | None]:
    """Our own credentials, before any session is opened with them."""
    if folder is None:
        return [], None
    now = time.time() if now is None else now
    try:
        own = Credentials.load(folder, now)
    except ZmavError as e:
        return [topics.CREDENTIALS.wrong(e.message, "the fleet's authority issues them: zmav mesh ca")], None
    return list(_judge_own(own, now)), own


def _judge_own(own: Credentials, now: float) -> Iterator[Finding]:
    who = f"{own.name}, {own.role.value} of {own.fleet}"
    if own.roster.is_revoked(own.certificate.fingerprint):
        yield topics.CREDENTIALS.wrong(f"{who}: revoked", "ask the authority for others, under another name")
    else:
        yield _ends(topics.CREDENTIALS, who, own.certificate.not_after, now)
    mode = Path(own.folder).stat().st_mode
    if mode & 0o022:
        advice = f"anyone who writes there decides whom to trust: chmod go-w {own.folder}"
        yield topics.FOLDER.wrong(f"{own.folder} can be written by others", advice)


def _ends(topic: topics.Topic, said: str, not_after: float, now: float, who: str = "") -> Finding:
    on = datetime.datetime.fromtimestamp(not_after, datetime.timezone.utc).date().isoformat()
    left = not_after - now
    if left <= 0:
        return topic.wrong(f"{said}: expired on {on}", RENEW, who)
    found = f"{said}: until {on}"
    return topic.well(found, who) if left > SOON else topic.wrong(f"{found}, soon", RENEW, who)


def judge_trust(trust: Trust | None, now: float) -> Iterator[Finding]:
    """Rosters and vehicles' certificates."""
    if trust is None:
        return
    yield from _judge_rosters(trust, now)
    for name, certificate in trust.certificates.items():
        who = f"{trust.own.fleet}/{name}"
        if isinstance(certificate, ZmavError):
            advice = "start its 'zmav up' with --credentials: what it says and is told is not proven"
            yield topics.CERTIFICATE.wrong(certificate.message, advice, who)
        else:
            yield _judge_vehicle(who, name, certificate, trust.own, now)


def _judge_vehicle(who: str, name: str, certificate: Certificate, own: Credentials, now: float) -> Finding:
    try:
        certificate.check(own.authority, max(certificate.not_before, min(now, certificate.not_after)))
    except BadInput as e:
        return topics.CERTIFICATE.wrong(e.message, "it is a stranger, whatever it says", who)
    if own.roster.is_revoked(certificate.fingerprint):
        return topics.CERTIFICATE.wrong("revoked", "do not believe what it says", who)
    if certificate.name != name:
        return topics.CERTIFICATE.wrong(f"it is {certificate.name}'s", "one of them speaks as the other", who)
    return _ends(topics.CERTIFICATE, certificate.role.value, certificate.not_after, now, who)


def _judge_rosters(trust: Trust, now: float) -> Iterator[Finding]:
    ours, held = trust.own.roster, [each for each in trust.rosters if isinstance(each, HeldRoster)]
    age = f"{(now - ours.t) / 86_400:.0f} days old"
    if not held:
        advice = "its routers run without --credentials, or are not reached"
        yield topics.ROSTER.wrong(f"number {ours.number}, {age}; no router tells which one it has", advice)
        return
    newest = max(each.number for each in held)
    if newest > ours.number:
        advice = f"bring it here: zmav mesh ca roster --fetch --credentials {trust.own.folder}"
        yield topics.ROSTER.wrong(f"number {ours.number}, {age}; the fleet's is {newest}", advice)
    else:
        yield topics.ROSTER.well(f"number {ours.number}, {age}")
    late = [f"{each.name} ({each.number})" for each in held if each.number < max(newest, ours.number)]
    if late:
        advice = "bring it to them: zmav mesh ca roster --publish; where it does not arrive, look at their links"
        yield topics.ROSTERS.wrong(f"older than {max(newest, ours.number)}: {', '.join(late)}", advice)
