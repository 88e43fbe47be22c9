"""The seal of a setpoint: a short code under a key that vehicle and holder agreed on when the lease was taken.

A signature costs some 150 µs to check, a seal two: what comes at 50 Hz is sealed. Both sides send an X25519 key with
``do/lease``, the holder's inside its signed order, so that who relays it cannot put in his own; the secret is drawn
from both by HKDF-SHA256 (RFC 5869), bound to the vehicle and to the lease. The attachment of a setpoint is a byte 2 and
16 bytes of keyed BLAKE2s (RFC 7693) over the length of the key, the key and the payload. A setpoint that is
heard twice is older than its sequence number, and one of an earlier lease has another key.
"""

from __future__ import annotations

import hashlib
import hmac
import struct

from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from zmav.errors import BadInput

KIND = b"\x02"
CODE = 16
SECRET = 32
CONTEXT = b"zmav setpoints 1"


class Exchange:
    """One side's key for one lease."""

    def __init__(self) -> None:
        self._private = X25519PrivateKey.generate()

    @property
    def public(self) -> str:
        """What the other side is sent: 64 hexadecimal digits."""
        return self._private.public_key().public_bytes_raw().hex()

    def secret(self, other: str, place: str, lease: str) -> bytes:
        """The key that both sides come to. ``other``: the other side's public key; ``place``: ``FLEET/VEHICLE``.

        Raises :class:`BadInput` for what cannot be a public key.
        """
        try:
            shared = self._private.exchange(X25519PublicKey.from_public_bytes(bytes.fromhex(other)))
        except ValueError as e:
            text = "a lease's key is an X25519 public key in 64 hexadecimal digits"
            raise BadInput(text, field="key", value=other[:80], expected="64 hexadecimal digits") from e
        info = b"\0".join((CONTEXT, place.encode(), lease.encode()))
        return HKDF(SHA256(), SECRET, salt=None, info=info).derive(shared)


def seal(secret: bytes, key: str, payload: bytes) -> bytes:
    """The attachment that goes with ``payload`` on ``key``."""
    name = key.encode()
    code = hashlib.blake2s(struct.pack(">H", len(name)) + name + payload, digest_size=CODE, key=secret)
    return KIND + code.digest()


def is_sealed(secret: bytes, key: str, payload: bytes, attachment: bytes | None) -> bool:
    """``attachment`` was made with ``secret`` for just this payload on this key."""
    return attachment is not None and hmac.compare_digest(attachment, seal(secret, key, payload))
