"""The authority: what it signs, what it refuses, and that its files are whole."""

from __future__ import annotations

import re
import shutil
import threading
import time
from pathlib import Path

import pytest
from click.testing import CliRunner
from cryptography.hazmat.primitives import serialization

from mesh.cli.ca import command
from mesh.credentials import certify
from mesh.credentials.ca import Authority
from mesh.credentials.certify import DAY
from zmav.errors import BadConfig, BadInput
from zmav.trust.certificate import Role
from zmav.trust.credentials import Credentials
from zmav.trust.roster import read_signed


def no_passphrase() -> bytes:
    raise AssertionError("a key that is not encrypted needs no passphrase")


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    return Authority.create(tmp_path / "ca", "alpha")


@pytest.mark.parametrize("role", list(Role))
def test_a_members_folder_is_one_that_loads(authority: Authority, role: Role) -> None:
    held = Credentials.load(authority.issue("quad1", role, days=20))
    assert (held.name, held.role, held.fleet) == ("quad1", role, "alpha")
    assert held.certificate.not_before < time.time() - 0.9 * DAY  # for clocks that are late
    assert 19.9 * DAY < held.certificate.not_after - time.time() < 20.1 * DAY
    (member,) = held.roster.members
    assert (member.name, member.role, member.fingerprint) == ("quad1", role.value, held.certificate.fingerprint.hex())
    assert (held.folder / "key.pem").stat().st_mode & 0o777 == 0o600
    assert held.folder.stat().st_mode & 0o777 == 0o700


def test_a_certificate_is_no_authority(authority: Authority, tmp_path: Path) -> None:
    """A member cannot sign another member: neither is its certificate an authority's, nor its key the authority's."""
    folder = authority.issue("quad1", Role.VEHICLE)
    held = Credentials.load(folder)
    public = held.key.public_key()
    forged = certify.member(authority.certificate, held.key, public, "alpha", "boss", Role.OPERATOR, 1)
    (folder / "cert.pem").write_bytes(forged.public_bytes(serialization.Encoding.PEM))
    with pytest.raises(BadConfig, match="not of this fleet's authority"):
        Credentials.load(folder)


def test_a_name_has_one_certificate_in_force(authority: Authority) -> None:
    first = Credentials.load(authority.issue("quad1", Role.VEHICLE))
    with pytest.raises(BadConfig, match="renew it, or revoke it first"):
        authority.issue("quad1", Role.OPERATOR)
    second = Credentials.load(authority.renew("quad1"))
    assert second.role is Role.VEHICLE
    assert second.certificate.fingerprint != first.certificate.fingerprint
    assert second.key.public_key() != first.key.public_key()
    assert not second.roster.is_revoked(first.certificate.fingerprint), "the old one is good until its end"
    assert second.roster.number == first.roster.number + 1


def test_who_is_revoked_is_out_and_not_let_in_again_by_name(authority: Authority, tmp_path: Path) -> None:
    old = Credentials.load(authority.issue("view", Role.VIEWER))
    renewed = Credentials.load(authority.renew("view"))
    assert {entry.fingerprint for entry in authority.revoke("view")} == {
        held.certificate.fingerprint.hex() for held in (old, renewed)
    }
    roster = authority.roster().open(authority.certificate, "alpha")
    assert roster.is_revoked(old.certificate.fingerprint)
    assert roster.is_revoked(renewed.certificate.fingerprint)
    assert roster.names("viewer") == []
    with pytest.raises(BadConfig, match="no certificate in force"):
        authority.revoke("view")
    with pytest.raises(BadConfig, match="no certificate to renew"):
        authority.renew("view")
    with pytest.raises(BadConfig, match="Take another name"):
        authority.issue("view", Role.VIEWER, out=tmp_path / "again")
    again = Credentials.load(authority.issue("view", Role.PLANNER, out=tmp_path / "again", again=True))
    assert again.roster.names("planner") == ["view"]
    assert again.roster.is_revoked(old.certificate.fingerprint)


def test_those_that_end_soon_are_known_and_those_that_ended_can_be_renewed(authority: Authority) -> None:
    for name, days in (("soon", 29), ("later", 31), ("ended", -0.5)):
        authority.issue(name, Role.VEHICLE, days)
    assert authority.ending() == ["soon"]
    authority.renew("soon")
    assert authority.ending() == []
    with pytest.raises(BadConfig, match="expired"):
        Credentials.load(authority.folder / "members" / "ended")
    assert Credentials.load(authority.renew("ended")).name == "ended"


@pytest.mark.parametrize("name", ["Quad1", "quad 1", "", "../quad1", "q" * 65])
def test_names_that_cannot_be(authority: Authority, name: str) -> None:
    with pytest.raises(BadInput) as e:
        authority.issue(name, Role.VEHICLE)
    assert e.value.detail["field"] == "name"
    assert authority.ledger.entries == []


def test_nothing_outlives_the_authority(authority: Authority) -> None:
    with pytest.raises(BadConfig, match="beyond the end of the authority"):
        authority.issue("quad1", Role.VEHICLE, days=4000)


def test_nothing_is_overwritten(authority: Authority, tmp_path: Path) -> None:
    with pytest.raises(BadConfig, match="is there already"):
        Authority.create(authority.folder, "beta")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("ten years")
    with pytest.raises(BadConfig, match="--out"):
        authority.issue("quad1", Role.VEHICLE, out=tmp_path / "mine")
    assert authority.ledger.entries == []
    other, quad1 = authority.issue("quad2", Role.VEHICLE), authority.issue("quad1", Role.VEHICLE)
    for folder in (tmp_path / "mine", other):
        with pytest.raises(BadConfig, match="is not replaced"):
            authority.renew("quad1", out=folder)
    assert (tmp_path / "mine" / "thesis.tex").exists()
    assert Credentials.load(other).name == "quad2"
    assert len(authority.ledger.entries) == 2
    (quad1 / "cert.pem").write_text("damaged")
    assert Credentials.load(authority.renew("quad1")).name == "quad1"


def test_a_name_given_again_has_its_newest_role_only(authority: Authority) -> None:
    """Its former certificate has ended, but stays on the roster for clocks that are late."""
    authority.issue("ann", Role.OPERATOR, days=-0.5, out=authority.folder / "former")
    held = Credentials.load(authority.issue("ann", Role.VIEWER))
    assert [member.role for member in held.roster.members] == ["operator", "viewer"]
    assert (held.roster.names("operator"), held.roster.names("viewer")) == ([], ["ann"])


def test_the_key_can_be_encrypted(tmp_path: Path) -> None:
    made = Authority.create(tmp_path / "ca", "alpha", b"correct horse")
    assert Authority.open(made.folder, lambda: b"correct horse").issue("quad1", Role.VEHICLE).is_dir()
    with pytest.raises(BadConfig, match="the passphrase is wrong"):
        Authority.open(made.folder, lambda: b"battery staple")


def test_what_is_wrong_with_its_folder_is_said(authority: Authority, tmp_path: Path) -> None:
    other = Authority.create(tmp_path / "other", "alpha")
    key = authority.folder / "ca-key.pem"
    with pytest.raises(BadConfig, match="is not an authority's folder"):
        Authority.open(tmp_path, no_passphrase)
    key.chmod(0o640)
    with pytest.raises(BadConfig, match="chmod 600"):
        Authority.open(authority.folder, no_passphrase)
    shutil.copy(other.folder / "ca-key.pem", key)
    key.chmod(0o600)
    with pytest.raises(BadConfig, match="is not the key of"):
        Authority.open(authority.folder, no_passphrase)
    (authority.folder / "ledger.json").write_text("{")
    with pytest.raises(BadConfig, match="is damaged"):
        Authority.open(authority.folder, no_passphrase)


@pytest.mark.parametrize(
    ("before", "after"), [('"vehicle"', '"captain"'), ('"not_after": ', '"not_after": 9e99'), ('"t": ', '"t": -1e')]
)
def test_a_ledger_without_sense_is_damaged_for_every_verb(authority: Authority, before: str, after: str) -> None:
    authority.issue("quad1", Role.VEHICLE)
    ledger = authority.folder / "ledger.json"
    assert before in ledger.read_text()
    ledger.write_text(ledger.read_text().replace(before, after))
    for verb in (["list"], ["revoke", "quad1"], ["renew", "quad1"], ["roster"]):
        with pytest.raises(BadConfig, match=r"is damaged.*copy of this folder"):
            CliRunner().invoke(command, [*verb, "--ca", str(authority.folder)], catch_exceptions=False)


def test_a_roster_that_is_gone_is_not_published(authority: Authority) -> None:
    (authority.folder / "roster.json").unlink()
    arguments = ["roster", "--publish", "--ca", str(authority.folder)]
    with pytest.raises(BadConfig, match=r"cannot read .*roster\.json: No such file.*renew"):
        CliRunner().invoke(command, arguments, catch_exceptions=False)


def test_a_folder_that_cannot_be_replaced_keeps_no_other_member_from_being_renewed(authority: Authority) -> None:
    before = {name: Credentials.load(authority.issue(name, Role.VEHICLE, days=9)) for name in ("quad1", "quad2")}
    notes = before["quad1"].folder / "notes.txt"
    notes.write_text("hers")
    with pytest.raises(BadConfig, match=r"quad1 holds 'notes\.txt', too"):
        CliRunner().invoke(command, ["renew", "--all", "--ca", str(authority.folder)], catch_exceptions=False)
    after = {name: Credentials.load(held.folder) for name, held in before.items()}
    assert after["quad1"].certificate.fingerprint == before["quad1"].certificate.fingerprint
    assert after["quad2"].certificate.fingerprint != before["quad2"].certificate.fingerprint
    assert after["quad1"].roster.number == after["quad2"].roster.number


def test_a_folder_that_cannot_be_written_keeps_no_other_member_from_the_roster(authority: Authority) -> None:
    """Nor does it keep from the person what was done, and what else went wrong."""
    for name, days in (("quad0", 90), ("quad1", 9), ("quad2", 90)):
        authority.issue(name, Role.VEHICLE, days)
    members = authority.folder / "members"
    (members / "quad0" / "roster.json").unlink()
    (members / "quad0" / "roster.json").mkdir()
    (members / "quad1" / "notes.txt").write_text("hers")
    unwritten = r"cannot write .*quad0/roster\.json"

    def run(*arguments: str) -> tuple[str, str]:
        result = CliRunner().invoke(command, [*arguments, "--ca", str(authority.folder)])
        assert isinstance(result.exception, BadConfig)
        assert re.search(unwritten, str(result.exception))
        assert Credentials.load(members / "quad2").roster.number == authority.ledger.number
        return result.output, str(result.exception)

    _, why = run("renew", "--all")
    assert "quad1 holds 'notes.txt', too" in why
    told, _ = run("renew", "quad2")
    assert "carry it to quad2" in told
    told, _ = run("issue", "quad3", "--role", "vehicle")
    assert "carry it to quad3" in told
    told, _ = run("revoke", "quad3")
    assert "revoked quad3" in told and "roster --publish" in told


def test_two_at_once_lose_nothing(authority: Authority) -> None:
    names = [f"quad{number}" for number in range(12)]
    same = Authority.open(authority.folder, no_passphrase)
    threads = [
        threading.Thread(target=(authority, same)[number % 2].issue, args=(name, Role.VEHICLE))
        for number, name in enumerate(names)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    ledger = authority.ledger
    assert sorted(entry.name for entry in ledger.entries) == sorted(names)
    assert ledger.number == len(names)
    kept = read_signed((authority.folder / "roster.json").read_bytes()).open(authority.certificate, "alpha")
    assert kept.names("vehicle") == sorted(names)
    assert not list(authority.folder.rglob(".*")), "nothing is left half done"


def test_the_verbs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ZMAV_CA", str(tmp_path / "ca"))
    monkeypatch.delenv("ZMAV_CA_PASSPHRASE", raising=False)

    def run(*arguments: str, typed: str = "") -> str:
        result = CliRunner().invoke(command, arguments, input=typed, catch_exceptions=False)
        assert result.exit_code == 0, result.output
        return result.output

    run("init", "--fleet", "alpha", "--passphrase", typed="secret\nsecret\n")
    out = str(tmp_path / "quad1")
    assert out in run("issue", "quad1", "--role", "vehicle", "--days", "10", "--out", out, typed="secret\n")
    assert Credentials.load(out).fleet == "alpha"
    run("issue", "quad2", "--role", "vehicle", typed="secret\n")
    run("issue", "quad3", "--role", "vehicle", typed="secret\n")
    assert Credentials.load(tmp_path / "ca" / "members" / "quad2").roster.names("vehicle") == [
        "quad1",
        "quad2",
        "quad3",
    ]
    monkeypatch.setenv("ZMAV_CA_PASSPHRASE", "secret")
    assert "quad1" in run("renew", "--all")
    assert "none ends" in run("renew", "--all")
    run("revoke", "quad1")
    assert run("list").count("revoked") == 2
    assert Credentials.load(tmp_path / "ca" / "members" / "quad2").roster.names("vehicle") == ["quad2", "quad3"]
    assert '"fleet": "alpha"' in run("roster", "--json")
    assert "2 revoked" in run("roster")
    refused = CliRunner().invoke(command, ["renew"])
    assert refused.exit_code == 2
    with pytest.raises(BadConfig, match="has no certificate to renew"):
        run("renew", "quad1")
