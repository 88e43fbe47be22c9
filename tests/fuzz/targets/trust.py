"""What strangers may show as their credentials: certificates, proofs of origin, seals, rosters."""

from __future__ import annotations

import base64
import contextlib
import functools
import random
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding

from tests.fuzz.engine import Target, pure
from tests.trust.conftest import Authority
from zmav import wire
from zmav.errors import Forbidden
from zmav.trust.certificate import Certificate
from zmav.trust.credentials import Credentials
from zmav.trust.proof import TOLD, Signer
from zmav.trust.proof import read as read_proof
from zmav.trust.roster import Member, Roster, SignedRoster, read_signed
from zmav.trust.verify import Verifier

KEY, PAYLOAD = "zmav/demo/quad1/do/hold", b'{"id": "7"}'


class Fleet(NamedTuple):
    authority: x509.Certificate
    authority_key: Ed25519PrivateKey
    member: Credentials
    strangers: list[bytes]
    """certificates in DER form that the authority would not issue"""


@functools.cache
def fleet() -> Fleet:
    with tempfile.TemporaryDirectory() as folder:
        authority = Authority(Path(folder))
        member = authority.member("quad1", "operator")
        strange = [
            authority.issue(f"x{n}", role, fleet=other)
            for n, (role, other) in enumerate((("admin", "demo"), ("viewer", "no name"), ("vehicle", "other")))
        ]
        ders = [x509.load_pem_x509_certificate((each / "cert.pem").read_bytes()) for each in strange]
        return Fleet(authority.certificate, authority.key, member, [d.public_bytes(Encoding.DER) for d in ders])


def certificate(data: bytes) -> None:
    Certificate.read(data).check(fleet().authority, time.time())


def certificates() -> list[bytes]:
    return [fleet().member.certificate.der, *fleet().strangers]


def proof(data: bytes) -> None:
    """Anything but the signer's own attachment is refused."""
    verifier = Verifier.of(fleet().member)
    try:
        apart = read_proof(data)
        assert apart.head + apart.signature + apart.tag + apart.certificate == data
    except Forbidden as e:
        assert e.detail["reason"] == "malformed"
    with contextlib.suppress(Forbidden):
        verifier.learn(data[98:])
    found, of = verifier.verify(KEY, PAYLOAD, data)
    assert of.name == "quad1"
    assert found.is_of(fleet().member.certificate, KEY, PAYLOAD, TOLD)


def proofs() -> list[bytes]:
    signer = Signer(fleet().member)
    tagged = signer.sign(KEY, PAYLOAD, introduce=True, to=fleet().member.certificate)
    return [signer.sign(KEY, PAYLOAD, introduce=True), signer.sign(KEY, PAYLOAD), tagged]


def roster(data: bytes) -> None:
    """As the authority would have signed it, had it written that."""
    text = data.decode("utf-8", "replace")
    signature = base64.b64encode(fleet().authority_key.sign(text.encode())).decode()
    found = SignedRoster(roster=text, signature=signature).open(fleet().authority, "demo")
    Verifier.of(fleet().member).roster = found
    found.names("vehicle")


def signed_roster(data: bytes) -> None:
    """As it comes from anybody."""
    found = read_signed(data)
    Verifier.of(fleet().member).roster = found.open(fleet().authority, "demo")


def rosters() -> list[bytes]:
    return [_of("quad1"), _of("")]


def _of(name: str) -> bytes:
    members = [Member(name=name, role="vehicle", fingerprint="00112233445566ff", not_after=1.8e9)]
    return wire.encode(Roster(fleet="demo", number=9, t=1.7e9, members=members, revoked=["00ff", "zz"]))


def signed_rosters() -> list[bytes]:
    texts = [each.decode() for each in rosters()]
    key = fleet().authority_key
    return [
        wire.encode(SignedRoster(roster=text, signature=base64.b64encode(key.sign(text.encode())).decode()))
        for text in texts
    ]


def der(rng: random.Random, data: bytes) -> bytes:
    """One byte of a length or a type, of which DER is made."""
    places = [at for at, byte in enumerate(data) if byte in (0x02, 0x0C, 0x17, 0x18, 0x30, 0x31, 0x03, 0x06)]
    if not places:
        return data
    at = rng.choice(places) + rng.randrange(2)
    return data[:at] + bytes([rng.randrange(256)]) + data[at + 1 :]


TARGETS = (
    Target("certificate", pure(certificate), certificates, 1500, der),
    Target("proof", pure(proof), proofs, 700, der),
    Target("roster", pure(roster), rosters, 700),
    Target("signed_roster", pure(signed_roster), signed_rosters, 700),
)
