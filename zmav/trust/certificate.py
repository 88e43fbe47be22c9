"""A member's certificate: X.509 with an Ed25519 key, signed by the fleet's own authority.

The subject says who it is: common name the member, organisation the fleet, organisational unit the role. Zenoh's access
rules see the common name; a vehicle sees all three. One key serves mutual TLS and proofs of origin.
"""

from __future__ import annotations

import asyncio
import datetime
import enum
import hashlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from zmav import keys
from zmav.errors import BadConfig

if TYPE_CHECKING:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

FINGERPRINT = 8
"""bytes of SHA-256 over the DER form that name a certificate on the wire"""
HOUR, DAY = 3600.0, 86_400.0
SOON = 30 * DAY
"""s before its end that a certificate is to be renewed"""


def fingerprint(der: bytes) -> bytes:
    """What names a certificate on the wire."""
    return hashlib.sha256(der).digest()[:FINGERPRINT]


class Role(enum.Enum):
    """What a member is. Its rights follow from the registry: :mod:`zmav.trust.rights`."""

    VEHICLE = keys.VEHICLE
    """speaks for itself, relays for others, and its own programs may fly it"""
    OPERATOR = keys.OPERATOR
    """may do everything"""
    PLANNER = keys.PLANNER
    """may fly vehicles, and not configure them"""
    VIEWER = "viewer"
    """may look"""


@dataclass(frozen=True)
class Certificate:
    """What a certificate says, once read; :meth:`check` says whether it is to be believed."""

    name: str
    role: Role
    fleet: str
    fingerprint: bytes
    serial: int
    not_before: float
    """UTC seconds"""
    not_after: float
    key: Ed25519PublicKey
    der: bytes
    document: x509.Certificate

    @classmethod
    def read(cls, der: bytes) -> Certificate:
        """From its DER form; raises :class:`BadInput` for what is no certificate of a fleet's member."""
        from cryptography import x509
        from cryptography.exceptions import UnsupportedAlgorithm
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
        from cryptography.x509.oid import NameOID

        parts = (NameOID.COMMON_NAME, NameOID.ORGANIZATION_NAME, NameOID.ORGANIZATIONAL_UNIT_NAME)
        try:
            found = x509.load_der_x509_certificate(der)
            key = found.public_key()
            said = {oid: _only(found.subject, oid) for oid in parts}
            role = Role(said[NameOID.ORGANIZATIONAL_UNIT_NAME])
            dates = _utc(found.not_valid_before_utc), _utc(found.not_valid_after_utc)
        except (ValueError, TypeError, UnsupportedAlgorithm, x509.InvalidVersion) as e:
            raise BadConfig(f"not a certificate of a fleet's member: {e}", field="certificate") from e
        if not isinstance(key, Ed25519PublicKey):
            raise BadConfig("a member's certificate has an Ed25519 key", field="certificate", expected="Ed25519")
        return cls(
            name=keys.check_name(said[NameOID.COMMON_NAME]),
            role=role,
            fleet=keys.check_name(said[NameOID.ORGANIZATION_NAME], "fleet"),
            fingerprint=fingerprint(der),
            serial=found.serial_number,
            not_before=dates[0],
            not_after=dates[1],
            key=key,
            der=der,
            document=found,
        )

    def check(self, authority: x509.Certificate, now: float) -> Certificate:
        """Itself, where ``authority`` signed it and it is valid at ``now`` (UTC seconds); raises :class:`BadConfig`."""
        self.check_issuer(authority)
        self.check_dates(now)
        return self

    def check_issuer(self, authority: x509.Certificate) -> None:
        """Raise :class:`BadConfig` unless ``authority`` signed it."""
        from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm

        try:
            self.document.verify_directly_issued_by(authority)
        except (ValueError, TypeError, InvalidSignature, UnsupportedAlgorithm) as e:
            raise BadConfig(f"the certificate of {self.name} is not of this fleet's authority", field="ca") from e

    def check_dates(self, now: float, grace: float = 0.0) -> None:
        """Raise :class:`BadConfig` unless it is valid at ``now``, in UTC seconds, or ended at most ``grace`` s ago."""
        if not self.not_before <= now <= self.not_after + grace:
            late = now > self.not_after
            word, when = ("expired", self.not_after) if late else ("is not valid before", self.not_before)
            at = utc(when)
            text = f"the certificate of {self.name} {word} {at}; renew it with 'zmav mesh ca renew', or set the clock"
            raise BadConfig(text, field="certificate", value=at, expected="a valid one")


def _only(subject: x509.Name, oid: x509.ObjectIdentifier) -> str:
    found = subject.get_attributes_for_oid(oid)
    if len(found) != 1:
        raise ValueError(f"its subject has {len(found)} {oid._name}")
    return str(found[0].value)


def utc(t: float) -> str:
    """UTC seconds in words."""
    return datetime.datetime.fromtimestamp(t, datetime.timezone.utc).isoformat(timespec="seconds")


def _utc(when: datetime.datetime) -> float:
    return when.timestamp()


async def warn_of_end(certificate: Certificate, say: Callable[[str], None]) -> None:
    """Say ahead that it ends: every day of its last month, every hour of its last two days. Until it is cancelled."""
    while True:
        left = certificate.not_after - time.time()
        if left <= SOON:
            say(_words(certificate, left))
        await asyncio.sleep(DAY if left > 2 * DAY or left <= 0 else min(left + 1.0, HOUR))


def _words(certificate: Certificate, left: float) -> str:
    if left <= 0:
        text = "no new link opens, a link that is lost does not come back, and members believe us for a day at most"
        return f"the certificate of {certificate.name} ended {utc(certificate.not_after)}: {text}; renew it"
    span = f"{left / DAY:.0f} days" if left > 2 * DAY else f"{left / HOUR:.1f} hours"
    text = "renew it where the authority is (zmav mesh ca renew) and start again with it"
    return f"the certificate of {certificate.name} ends {utc(certificate.not_after)}, in {span}: {text}"
