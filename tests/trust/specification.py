"""docs/proofs.md once more, from its words alone: what zmav is held against. Writes docs/proof-vectors.json:

python -m tests.trust.specification
"""

from __future__ import annotations

import base64
import datetime
import hashlib
import json
import struct
from pathlib import Path
from typing import Any

from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF
from cryptography.x509.oid import NameOID

FILE = Path(__file__).resolve().parent.parent.parent / "docs" / "proof-vectors.json"
TOLD, ANSWERED = b"zmav proof of origin 1", b"zmav proof of an answer 1"


def fingerprint(der: bytes) -> bytes:
    return hashlib.sha256(der).digest()[:8]


def signed(context: bytes, head: bytes, key: str, payload: bytes) -> bytes:
    return context + struct.pack(">H", len(key.encode())) + key.encode() + head + payload


def attachment(
    secret: Ed25519PrivateKey,
    der: bytes,
    key: str,
    payload: bytes,
    *,
    micros: int,
    nonce: bytes,
    answers: bytes = bytes(8),
    context: bytes = TOLD,
    introduce: bool = False,
    to: bytes = b"",
) -> bytes:
    """``to``: the certificate, in DER, of whom it is meant for."""
    flags = introduce * 1 | bool(to) * 2
    head = struct.pack(">BBQ", 1, flags, micros) + nonce + fingerprint(der) + answers
    message = signed(context, head, key, payload)
    signature = secret.sign(message)
    return head + signature + (tag(secret, der, to, message + signature) if to else b"") + (der if introduce else b"")


def tag(secret: Ed25519PrivateKey, ours: bytes, theirs: bytes, message: bytes) -> bytes:
    """By who speaks, with the certificates of both."""
    found = x509.load_der_x509_certificate(theirs).public_key()
    assert isinstance(found, Ed25519PublicKey)
    y = int.from_bytes(found.public_bytes_raw(), "little") & (1 << 255) - 1
    p = 2**255 - 19
    point = X25519PublicKey.from_public_bytes(((1 + y) * pow(1 - y, -1, p) % p).to_bytes(32, "little"))
    scalar = X25519PrivateKey.from_private_bytes(hashlib.sha512(secret.private_bytes_raw()).digest()[:32])
    both = b"".join(sorted((fingerprint(ours), fingerprint(theirs))))
    key = derive(scalar.exchange(point), b"zmav tags 1" + both)
    return hashlib.blake2s(fingerprint(ours) + message, digest_size=16, key=key).digest()


def derive(shared: bytes, info: bytes) -> bytes:
    return HKDF(SHA256(), 32, salt=None, info=info).derive(shared)


def lease_secret(ours: X25519PrivateKey, theirs: str, place: str, lease: str) -> bytes:
    shared = ours.exchange(X25519PublicKey.from_public_bytes(bytes.fromhex(theirs)))
    return derive(shared, b"\0".join((b"zmav setpoints 1", place.encode(), lease.encode())))


def seal(secret: bytes, key: str, payload: bytes) -> bytes:
    name = key.encode()
    return b"\x02" + hashlib.blake2s(struct.pack(">H", len(name)) + name + payload, digest_size=16, key=secret).digest()


def main(file: Path = FILE) -> None:
    """The same bytes each time: every key, date and nonce is fixed."""
    keys = {name: Ed25519PrivateKey.from_private_bytes(bytes([n]) * 32) for n, name in enumerate(NAMES, 1)}
    authority = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "authority of demo")])
    ders = {name: _certificate(keys, authority, name, number) for number, name in enumerate(NAMES, 1)}
    members = [
        {"name": name, "role": NAMES[name], "fingerprint": fingerprint(ders[name]).hex(), "not_after": END.timestamp()}
        for name in ("quad1", "alice")
    ]
    roster = json.dumps({"fleet": "demo", "number": 3, "t": 1.8e9, "members": members, "revoked": ["0011223344556677"]})
    document = {
        "about": "docs/proofs.md; all of it hexadecimal but keys, payloads and JSON",
        "members": {
            name: {"role": NAMES[name], "seed": keys[name].private_bytes_raw().hex(), "certificate": ders[name].hex()}
            for name in NAMES
        },
        "roster": {"roster": roster, "signature": base64.b64encode(keys["authority"].sign(roster.encode())).decode()},
        "proofs": [*(_proof(keys, ders, each) for each in PROOFS), _refusal(keys, ders)],
        "seals": [_seal()],
    }
    file.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


NAMES = {"authority": "", "quad1": "vehicle", "alice": "operator"}
BEGIN = datetime.datetime(2020, 1, 1, tzinfo=datetime.timezone.utc)
END = datetime.datetime(2119, 1, 1, tzinfo=datetime.timezone.utc)
ORDER = {"by": "alice", "key": "zmav/demo/quad1/do/takeoff", "payload": '{"alt_rel": 10, "id": "up-1", "wait": 1}'}
PROOFS: tuple[dict[str, Any], ...] = (
    {"what": "an order, with the certificate", **ORDER, "answers": "a1a2a3a4a5a6a7a8", "introduce": True},
    {"what": "the same with a tag for quad1", **ORDER, "answers": "a1a2a3a4a5a6a7a8", "introduce": True, "to": "quad1"},
    {"what": "a state, which answers nothing", "by": "quad1", "key": "zmav/demo/quad1/state", "payload": '{"t": 1.0}'},
    {
        "what": "an answer to the order's nonce",
        "by": "quad1",
        "key": "zmav/demo/quad1/do/takeoff",
        "payload": '{"verb":"takeoff","status":"done","took":8.1,"result":{}}',
        "answers": "0102030405060708",
        "answer": True,
    },
)


def _certificate(keys: dict[str, Ed25519PrivateKey], authority: x509.Name, name: str, number: int) -> bytes:
    parts = ((NameOID.COMMON_NAME, name), (NameOID.ORGANIZATION_NAME, "demo"))
    own = x509.Name([x509.NameAttribute(o, t) for o, t in (*parts, (NameOID.ORGANIZATIONAL_UNIT_NAME, NAMES[name]))])
    ca = name == "authority"
    builder = x509.CertificateBuilder(authority, authority if ca else own, keys[name].public_key(), number, BEGIN, END)
    builder = builder.add_extension(x509.BasicConstraints(ca=ca, path_length=0 if ca else None), critical=True)
    return builder.sign(keys["authority"], None).public_bytes(serialization.Encoding.DER)


def _proof(keys: dict[str, Ed25519PrivateKey], ders: dict[str, bytes], each: dict[str, Any]) -> dict[str, Any]:
    found = attachment(
        keys[each["by"]],
        ders[each["by"]],
        each["key"],
        each["payload"].encode(),
        micros=(micros := 1_800_000_000_123_456),
        nonce=(nonce := bytes(range(1, 9))),
        answers=bytes.fromhex(each.get("answers", "00" * 8)),
        context=ANSWERED if each.get("answer") else TOLD,
        introduce=each.get("introduce", False),
        to=ders[each["to"]] if "to" in each else b"",
    )
    return {**each, "micros": micros, "nonce": nonce.hex(), "attachment": found.hex()}


def _refusal(keys: dict[str, Ed25519PrivateKey], ders: dict[str, bytes]) -> dict[str, Any]:
    """An error reply, for which Zenoh has no attachment."""
    detail = {"alt_rel": 0.1, "certificate": base64.b64encode(ders["quad1"]).decode()}
    each = {
        "what": "a refusal of the order: its proof is in the encoding and in the detail",
        "by": "quad1",
        "key": ORDER["key"],
        "payload": json.dumps({"code": "bad_input", "message": "alt_rel: from 0.5 to 1000", "detail": detail}),
        "answers": "0102030405060708",
        "answer": True,
        "introduce": True,
    }
    made = _proof(keys, ders, each)
    before = bytes.fromhex(made["attachment"])[: -len(ders["quad1"])]
    return {**made, "encoding": f"application/json;{base64.b64encode(before).decode()}"}


def _seal() -> dict[str, Any]:
    holder, vehicle = (X25519PrivateKey.from_private_bytes(bytes([n]) * 32) for n in (7, 8))
    point = '{"lease": "c0ffee", "seq": 1, "deadline": 1800000000.5, "pos": [6, 2, -8]}'
    key, secret = "zmav/demo/quad1/setpoint/rust", lease_secret(holder, _public(vehicle), "demo/quad1", "c0ffee")
    return {
        "holder_private": holder.private_bytes_raw().hex(),
        "holder_public": _public(holder),
        "vehicle_private": vehicle.private_bytes_raw().hex(),
        "vehicle_public": _public(vehicle),
        "place": "demo/quad1",
        "lease": "c0ffee",
        "secret": secret.hex(),
        "key": key,
        "payload": point,
        "attachment": seal(secret, key, point.encode()).hex(),
    }


def _public(key: X25519PrivateKey) -> str:
    return key.public_key().public_bytes_raw().hex()


if __name__ == "__main__":
    main()
