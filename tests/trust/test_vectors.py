"""docs/proof-vectors.json: the examples of docs/proofs.md in bytes, by its words alone and by zmav."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from tests.trust import specification
from zmav import wire
from zmav.errors import BadConfig, Forbidden
from zmav.services.queries.proven import proof_of_error
from zmav.trust import proof
from zmav.trust.credentials import Credentials
from zmav.trust.roster import read_signed
from zmav.trust.seal import Exchange, Tags, is_sealed, seal
from zmav.trust.verify import Verifier

if TYPE_CHECKING:
    import zenoh

VECTORS: dict[str, Any] = json.loads(specification.FILE.read_bytes())
PROOFS: list[dict[str, Any]] = VECTORS["proofs"]


@pytest.fixture
def authority() -> x509.Certificate:
    return x509.load_der_x509_certificate(bytes.fromhex(VECTORS["members"]["authority"]["certificate"]))


def credentials(name: str, folder: Path) -> Credentials:
    """A member of the vectors, as a folder that 'zmav mesh ca' makes."""
    folder.mkdir()
    pem = serialization.Encoding.PEM
    for file, member in (("ca.pem", "authority"), ("cert.pem", name)):
        der = bytes.fromhex(VECTORS["members"][member]["certificate"])
        (folder / file).write_bytes(x509.load_der_x509_certificate(der).public_bytes(pem))
    key = Ed25519PrivateKey.from_private_bytes(bytes.fromhex(VECTORS["members"][name]["seed"]))
    how = serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    (folder / "key.pem").write_bytes(key.private_bytes(pem, *how))
    (folder / "key.pem").chmod(0o600)
    (folder / "roster.json").write_text(json.dumps(VECTORS["roster"]))
    return Credentials.load(folder)


def other(attachment: bytes, at: int) -> bytes:
    return attachment[:at] + bytes([attachment[at] ^ 1]) + attachment[at + 1 :]


def test_the_words_give_the_vectors(tmp_path: Path) -> None:
    specification.main(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == specification.FILE.read_bytes()


@pytest.mark.parametrize("each", PROOFS, ids=[each["what"] for each in PROOFS])
def test_zmav_believes_each_proof_and_nothing_else(each: dict[str, Any], tmp_path: Path) -> None:
    listener = credentials("alice" if each["by"] == "quad1" else "quad1", tmp_path / "listener")
    at = each["micros"] / 1e6
    attachment, key, payload = bytes.fromhex(each["attachment"]), each["key"], each["payload"].encode()
    context = proof.ANSWERED if each.get("answer") else proof.TOLD
    answers = bytes.fromhex(each.get("answers", "00" * 8))

    def judge(attachment: bytes, key: str = key, payload: bytes = payload, context: bytes = context) -> str:
        verifier = Verifier(listener.authority, "demo", listener.roster, utc=lambda: at)
        verifier.learn(bytes.fromhex(VECTORS["members"][each["by"]]["certificate"]))
        return verifier.verify(key, payload, attachment, answers=answers, context=context)[1].name

    assert judge(attachment) == each["by"]
    found = proof.read(attachment)
    assert (found.t, found.nonce.hex(), bool(found.tag)) == (at, each["nonce"], "to" in each)
    for offset in range(98):
        with pytest.raises(Forbidden):
            judge(other(attachment, offset))
    for changed in ({"key": key + "x"}, {"payload": payload + b" "}, {"context": b"zmav proof of anything 1"}):
        with pytest.raises(Forbidden, match="signature"):
            judge(attachment, **changed)


def test_zmav_puts_a_refusals_proof_together() -> None:
    (each,) = [each for each in PROOFS if "encoding" in each]
    error = wire.error_from(each["payload"].encode())
    found = proof_of_error(cast("zenoh.ReplyError", SimpleNamespace(encoding=each["encoding"])), error)
    assert (found or b"").hex() == each["attachment"]
    assert error.detail == {"alt_rel": 0.1}


def test_zmav_sees_for_whom_a_tag_is(tmp_path: Path) -> None:
    (each,) = [each for each in PROOFS if "to" in each]
    vehicle, operator = (credentials(name, tmp_path / name) for name in ("quad1", "alice"))
    found = proof.read(bytes.fromhex(each["attachment"]))
    told = (each["key"], each["payload"].encode(), proof.TOLD)
    assert found.is_for(Tags(vehicle), operator.certificate, *told)
    assert not found.is_for(Tags(operator), operator.certificate, *told)


def test_zmav_opens_the_roster(authority: x509.Certificate) -> None:
    roster = read_signed(json.dumps(VECTORS["roster"]).encode()).open(authority, "demo")
    assert roster.number == 3
    assert [(m.name, m.role) for m in roster.members] == [("quad1", "vehicle"), ("alice", "operator")]
    assert roster.is_revoked(bytes.fromhex("0011223344556677"))
    turned = {**VECTORS["roster"], "roster": VECTORS["roster"]["roster"].replace('"number": 3', '"number": 4')}
    with pytest.raises(BadConfig, match="not signed by this fleet's authority"):
        read_signed(json.dumps(turned).encode()).open(authority, "demo")


@pytest.mark.parametrize("each", VECTORS["seals"])
def test_zmav_seals_and_opens_alike(each: dict[str, str]) -> None:
    secret, key, payload = bytes.fromhex(each["secret"]), each["key"], each["payload"].encode()
    assert seal(secret, key, payload).hex() == each["attachment"]
    assert is_sealed(secret, key, payload, bytes.fromhex(each["attachment"]))
    assert not is_sealed(secret, key + "x", payload, bytes.fromhex(each["attachment"]))
    place, lease = each["place"], each["lease"]
    for private, public in (("holder_private", "vehicle_public"), ("vehicle_private", "holder_public")):
        ours = X25519PrivateKey.from_private_bytes(bytes.fromhex(each[private]))
        assert specification.lease_secret(ours, each[public], place, lease) == secret
        fresh = Exchange()
        assert specification.lease_secret(ours, fresh.public, place, lease) == fresh.secret(
            ours.public_key().public_bytes_raw().hex(), place, lease
        )
