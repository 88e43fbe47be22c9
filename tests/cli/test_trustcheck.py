"""What ``zmav doctor`` says of credentials, of every kind that is well and that is not."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from mesh.credentials.ca import Authority
from mesh.credentials.certify import DAY
from zmav.doctor.credentials import Trust, check_folder, judge_trust
from zmav.doctor.findings import Finding
from zmav.errors import TimedOut, ZmavError
from zmav.trust.certificate import Certificate, Role
from zmav.trust.credentials import Credentials
from zmav.trust.roster import HeldRoster


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    return Authority.create(tmp_path / "ca", "alpha")


def only(findings: list[Finding]) -> Finding:
    (finding,) = findings
    return finding


def test_without_credentials_there_is_nothing_to_say() -> None:
    assert check_folder(None) == ([], None)
    assert list(judge_trust(None, time.time())) == []


def test_our_own_folder(authority: Authority) -> None:
    folder = authority.issue("ops", Role.OPERATOR, days=100)
    said, own = check_folder(str(folder))
    assert own is not None
    assert only(said).ok
    assert only(said).found.startswith("ops, operator of alpha: until 20")
    soon = only(check_folder(str(folder), time.time() + 71 * DAY)[0])
    assert (soon.ok, "soon" in soon.found, "renew" in soon.advice) == (False, True, True)
    late, none = check_folder(str(folder), time.time() + 101 * DAY)
    assert (only(late).ok, "expired" in only(late).found, none) == (False, True, None)
    folder.chmod(0o770)
    assert [(f.ok, f.subject) for f in check_folder(str(folder))[0]] == [
        (True, "credentials"),
        (False, "credentials folder"),
    ]
    folder.chmod(0o700)
    authority.revoke("ops")
    authority.refresh()
    revoked = only(check_folder(str(folder))[0])
    assert (revoked.ok, "revoked" in revoked.found) == (False, True)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda folder: (folder / "key.pem").chmod(0o604), "chmod 600"),
        (lambda folder: (folder / "cert.pem").unlink(), "cannot read"),
        (lambda folder: (folder / "roster.json").write_text("{}"), "not a roster"),
        (lambda folder: (folder / "ca.pem").write_text("hello"), "is not a certificate"),
    ],
)
def test_a_folder_that_is_spoiled(authority: Authority, spoil: Callable[[Path], object], words: str) -> None:
    folder = authority.issue("ops", Role.OPERATOR)
    spoil(folder)
    said, own = check_folder(str(folder))
    assert own is None
    assert not only(said).ok
    assert words in only(said).found


def trust(
    authority: Authority, numbers: dict[str, int], certificates: dict[str, Certificate | ZmavError] | None = None
) -> list[Finding]:
    """What is said by ``ops`` where routers have those rosters and vehicles show those certificates."""
    own = Credentials.load(authority.folder / "members" / "ops")
    held: list[HeldRoster | ZmavError] = [
        HeldRoster(name=name, number=number, t=time.time()) for name, number in numbers.items()
    ]
    return list(judge_trust(Trust(own, [*held, TimedOut("late")], certificates or {}), time.time()))


def test_rosters_against_the_fleets(authority: Authority) -> None:
    authority.issue("ops", Role.OPERATOR)
    assert [f.ok for f in trust(authority, {"quad1": 1, "quad2": 1})] == [True]
    behind = only(trust(authority, {"quad1": 2, "quad2": 2}))
    assert (behind.ok, "the fleet's is 2" in behind.found, "--fetch" in behind.advice) == (False, True, True)
    ours, theirs = trust(authority, {"quad1": 1, "quad2": 0})
    assert (ours.ok, theirs.ok, "quad2 (0)" in theirs.found, "--publish" in theirs.advice) == (True, False, True, True)
    assert "no router tells" in only(trust(authority, {})).found


def test_vehicles_certificates(authority: Authority, tmp_path: Path) -> None:
    authority.issue("ops", Role.OPERATOR)

    def shown(name: str, days: float = 300) -> Certificate:
        return Credentials.load(authority.issue(name, Role.VEHICLE, days)).certificate

    good, soon, out = shown("good"), shown("soon", 10), shown("out")
    over = shown("over", 40)
    authority.revoke("out")
    authority.refresh()
    stranger = Authority.create(tmp_path / "other", "alpha").issue("stranger", Role.VEHICLE)
    said = trust(
        authority,
        {"quad1": authority.ledger.number},
        {
            "good": good,
            "soon": soon,
            "out": out,
            "over": over,
            "thief": good,
            "stranger": Credentials.load(stranger).certificate,
            "silent": ZmavError("silent shows no certificate"),
        },
    )
    found = {f.subject.removeprefix("alpha/").removesuffix(" certificate"): f for f in said[1:]}
    assert {name for name, f in found.items() if f.ok} == {"good", "over"}
    words = {"soon": "soon", "out": "revoked", "thief": "it is good's", "stranger": "authority", "silent": "shows no"}
    for name, text in words.items():
        assert text in found[name].found
