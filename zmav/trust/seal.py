"""The seal of a setpoint: a short code under a key that vehicle and holder agreed on when the lease was taken.

A signature costs some 150 µs to check, a seal two: what comes at 50 Hz is sealed. Both sides send an X25519 key with
``do/lease``, the holder's inside its signed order, so that who relays it cannot put in his own; the secret is drawn
from both by HKDF-SHA256 (RFC 5869), bound to the vehicle and to the lease. The attachment of a setpoint is a byte 2 and
16 bytes of keyed BLAKE2s (RFC 7693) over the length of the key, the key and the payload. A setpoint that is
heard twice is older than its sequence number, and one of an earlier lease has another key.

The tag of a proof: shows whom it is meant for, for the price of a hash, that its signature is worth looking at.

A signature costs some 150 µs to check, so wrong ones are looked at so many a second and no more; and a forger who sends
more than that in a member's name would have the member's own left unread. The tag is made with a key that only the two
have: X25519 between the keys of their certificates (an Ed25519 key is one of Curve25519 by RFC 7748, section 4.1; that
the two uses do not weaken each other: Thormarker, "On using the same key pair for Ed25519 and an X25519 based KEM",
2021), by HKDF-SHA256. Nothing is agreed on beforehand. It is 16 bytes of keyed BLAKE2s over what is signed and the
signature. It proves nothing to anybody else, and opens nothing: the signature alone says who it is.
"""

from __future__ import annotations

import collections
import hashlib
import hmac
import os
import struct
import threading
from typing import TYPE_CHECKING

from zmav.errors import BadInput
from zmav.trust.certificate import Certificate
from zmav.trust.credentials import Credentials

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PublicKey

KIND = b"\x02"
CODE = 16
SECRET = 32
SETPOINTS = b"zmav setpoints 1"
TAG = 16
"""bytes"""
MOST_KEYS = 512
"""members whose key is kept"""
TAGS = b"zmav tags 1"
P = 2**255 - 19
"""the field of Curve25519"""


def _derive(shared: bytes, info: bytes) -> bytes:
    from cryptography.hazmat.primitives.hashes import SHA256
    from cryptography.hazmat.primitives.kdf.hkdf import HKDF

    return HKDF(SHA256(), SECRET, salt=None, info=info).derive(shared)


class Exchange:
    """One side's key for one lease."""

    def __init__(self) -> None:
        from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

        self._private = X25519PrivateKey.generate()

    @property
    def public(self) -> str:
        """What the other side is sent: 64 hexadecimal digits."""
        return self._private.public_key().public_bytes_raw().hex()

    def secret(self, other: str, place: str, lease: str) -> bytes:
        """The key that both sides come to. ``other``: the other side's public key; ``place``: ``FLEET/VEHICLE``.

        Raises :class:`BadInput` for what cannot be a public key.
        """
        from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PublicKey

        try:
            shared = self._private.exchange(X25519PublicKey.from_public_bytes(bytes.fromhex(other)))
        except ValueError as e:
            text = "a lease's key is an X25519 public key in 64 hexadecimal digits"
            raise BadInput(text, field="key", value=other[:80], expected="64 hexadecimal digits") from e
        return _derive(shared, b"\0".join((SETPOINTS, place.encode(), lease.encode())))


def seal(secret: bytes, key: str, payload: bytes) -> bytes:
    """The attachment that goes with ``payload`` on ``key``."""
    name = key.encode()
    code = hashlib.blake2s(struct.pack(">H", len(name)) + name + payload, digest_size=CODE, key=secret)
    return KIND + code.digest()


def is_sealed(secret: bytes, key: str, payload: bytes, attachment: bytes | None) -> bool:
    """``attachment`` was made with ``secret`` for just this payload on this key."""
    return attachment is not None and hmac.compare_digest(attachment, seal(secret, key, payload))


class Tags:
    """One member's. Thread-safe."""

    def __init__(self, credentials: Credentials) -> None:
        from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

        seed = hashlib.sha512(credentials.key.private_bytes_raw()).digest()[:32]  # RFC 8032, 5.1.5
        self._private, self._ours = X25519PrivateKey.from_private_bytes(seed), credentials.certificate.fingerprint
        self._keys: collections.OrderedDict[bytes, bytes] = collections.OrderedDict()
        """by the other's fingerprint"""
        self._lock = threading.Lock()

    def make(self, to: Certificate, data: bytes) -> bytes:
        """The tag of what we say to the holder of ``to``. ``data``: what is signed, and the signature."""
        return self._tag(to, self._ours, data)

    def fits(self, by: Certificate, data: bytes, tag: bytes) -> bool:
        """The holder of ``by`` made it, for us, of this."""
        return len(tag) == TAG and hmac.compare_digest(self._tag(by, by.fingerprint, data), tag)

    def _tag(self, other: Certificate, speaker: bytes, data: bytes) -> bytes:
        return hashlib.blake2s(speaker + data, digest_size=TAG, key=self._key(other)).digest()

    def _key(self, other: Certificate) -> bytes:
        with self._lock:
            known = self._keys.get(other.fingerprint)
        if known is None:
            try:
                shared = self._private.exchange(_montgomery(other.key))
            except ValueError:  # no key that anybody could have: then nobody makes a tag with it
                shared = os.urandom(32)
            both = b"".join(sorted((self._ours, other.fingerprint)))
            known = _derive(shared, TAGS + both)
            with self._lock:
                self._keys[other.fingerprint] = known
                while len(self._keys) > MOST_KEYS:
                    self._keys.popitem(last=False)
        return known


def _montgomery(key: Ed25519PublicKey) -> X25519PublicKey:
    """The same point on Curve25519: u = (1 + y) / (1 - y)."""
    from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PublicKey

    y = int.from_bytes(key.public_bytes_raw(), "little") & (1 << 255) - 1
    u = (1 + y) * pow(1 - y, -1, P) % P
    return X25519PublicKey.from_public_bytes(u.to_bytes(32, "little"))
