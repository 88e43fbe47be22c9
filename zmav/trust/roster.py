"""The roster: who the fleet's authority has admitted and whom it has turned out, signed by the authority.

It is one JSON file beside each member's certificate. The newer one of the same fleet takes the place of the older,
no matter who brought it: only the authority can sign one.
"""

from __future__ import annotations

import base64
from typing import TYPE_CHECKING

import msgspec

from zmav import wire
from zmav.errors import BadConfig
from zmav.wire.base import Wire

if TYPE_CHECKING:
    from cryptography import x509

MOST = 4 * 2**20
"""bytes of a roster: some 20,000 members"""


class Member(Wire, kw_only=True):
    """One certificate the authority has signed."""

    name: str
    role: str
    fingerprint: str
    """hexadecimal"""
    not_after: float
    """UTC seconds"""


class Roster(Wire, kw_only=True):
    """What the authority says of its members."""

    fleet: str
    number: int
    """counts up with every change"""
    t: float
    members: list[Member] = []
    """oldest first; of a name that was given again, the former ones stand there, too, until their end was long ago"""
    revoked: list[str] = []
    """fingerprints, hexadecimal, of certificates that are believed no more"""

    def is_revoked(self, fingerprint: bytes) -> bool:
        return fingerprint.hex() in self.revoked

    def names(self, role: str) -> list[str]:
        """The members of a role that are not revoked, each once: a name has the role of its newest certificate."""
        revoked = set(self.revoked)
        roles = {m.name: m.role for m in self.members if m.fingerprint not in revoked}
        return sorted(name for name, its in roles.items() if its == role)


class SignedRoster(Wire, kw_only=True):
    """The file, and what travels."""

    roster: str
    """the roster's JSON, as it was signed"""
    signature: str
    """Ed25519, base64"""

    def open(self, authority: x509.Certificate, fleet: str) -> Roster:
        """The roster inside; raises :class:`BadConfig` where the authority did not sign it, or for another fleet."""
        from cryptography.exceptions import InvalidSignature
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

        key = authority.public_key()
        assert isinstance(key, Ed25519PublicKey)
        try:
            key.verify(base64.b64decode(self.signature, validate=True), self.roster.encode())
        except (InvalidSignature, ValueError) as e:
            raise BadConfig("the roster is not signed by this fleet's authority", field="roster") from e
        roster = wire.decode(self.roster.encode(), Roster, "roster")
        if roster.fleet != fleet:
            text = f"the roster is of the fleet {roster.fleet!r}"
            raise BadConfig(text, field="roster.fleet", value=roster.fleet, expected=fleet)
        return roster

    @property
    def number(self) -> int:
        """What it says its number is: cheap to see, and to be believed only once its signature was checked.

        Raises :class:`BadConfig`.
        """
        try:
            return msgspec.json.decode(self.roster, type=_Numbered).number
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as e:
            raise BadConfig(f"not a roster: {e}", field="roster") from e


class _Numbered(msgspec.Struct):
    number: int


class HeldRoster(Wire, kw_only=True):
    """What a router answers on the fleet's topic ``roster``: which one it has."""

    name: str
    """the router's host"""
    number: int
    t: float
    """UTC seconds: when the authority signed it"""
    newer: SignedRoster | None = None
    """itself, where it was asked for what is newer than a number (``?newer=12``), and is"""


def read_signed(data: bytes) -> SignedRoster:
    """Raises :class:`BadConfig` for what is no roster."""
    if len(data) > MOST:
        raise BadConfig(f"not a roster: {len(data)} bytes (at most {MOST})", field="roster")
    try:
        return msgspec.json.decode(data, type=SignedRoster)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as e:
        raise BadConfig(f"not a roster: {e}", field="roster") from e
