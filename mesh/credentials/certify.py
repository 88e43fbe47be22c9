"""The certificates an authority signs: its own, and its members'."""

from __future__ import annotations

import datetime
import time

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from zmav.errors import BadConfig
from zmav.trust.certificate import Role

DAY = 86_400.0
EARLIER = DAY
"""s before now that a certificate begins: field computers without a clock battery wake up late"""
YEARS = 10
"""of the authority's own certificate"""
LONGEST = 64
"""characters of a name in a certificate (X.520, ub-common-name)"""


def self_signed(key: Ed25519PrivateKey, fleet: str) -> x509.Certificate:
    """An authority's own certificate; raises :class:`BadConfig` for a name that is too long for one."""
    subject = _subject(CN="authority", O=_checked("fleet", fleet))
    builder = _builder(subject, subject, key.public_key(), time.time() + YEARS * 365 * DAY)
    builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    return builder.add_extension(_usage(authority=True), critical=True).sign(key, None)


def member(
    authority: x509.Certificate,
    key: Ed25519PrivateKey,
    public: Ed25519PublicKey,
    fleet: str,
    name: str,
    role: Role,
    days: float,
) -> x509.Certificate:
    """A leaf that may be either end of a TLS connection. Its name stands in the SAN, too: the modern place.

    Raises :class:`BadConfig` where it would outlive the authority's own, or the name is too long for a certificate.
    """
    last, until = authority.not_valid_after_utc.timestamp(), time.time() + days * DAY
    if until > last:
        text = f"{days} days are beyond the end of the authority's own certificate ({day(last)})"
        raise BadConfig(text, field="days", value=days, expected=f"an end by {day(last)}")
    builder = _builder(_subject(CN=_checked("name", name), O=fleet, OU=role.value), authority.subject, public, until)
    usage = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH])
    authority_id = x509.AuthorityKeyIdentifier.from_issuer_subject_key_identifier(
        authority.extensions.get_extension_for_class(x509.SubjectKeyIdentifier).value
    )
    return (
        builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(authority=False), critical=True)
        .add_extension(usage, critical=False)
        .add_extension(x509.SubjectAlternativeName([x509.DNSName(name)]), critical=False)
        .add_extension(authority_id, critical=False)
        .sign(key, None)
    )


def _builder(subject: x509.Name, issuer: x509.Name, public: Ed25519PublicKey, until: float) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(public)
        .serial_number(x509.random_serial_number())
        .not_valid_before(_utc(time.time() - EARLIER))
        .not_valid_after(_utc(until))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(public), critical=False)
    )


def _usage(*, authority: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not authority,
        key_cert_sign=authority,
        crl_sign=authority,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _subject(**parts: str) -> x509.Name:
    kinds = {"CN": NameOID.COMMON_NAME, "O": NameOID.ORGANIZATION_NAME, "OU": NameOID.ORGANIZATIONAL_UNIT_NAME}
    return x509.Name([x509.NameAttribute(kinds[part], value) for part, value in parts.items()])


def _utc(t: float) -> datetime.datetime:
    return datetime.datetime.fromtimestamp(t, datetime.timezone.utc)


def _checked(field: str, name: str) -> str:
    if len(name) > LONGEST:
        text = f"{field} {name!r} is too long for a certificate: it takes {LONGEST} characters"
        raise BadConfig(text, field=field, value=name, expected=f"{LONGEST} characters at most")
    return name


def day(t: float) -> str:
    """A UTC time as a date."""
    return _utc(t).date().isoformat()
