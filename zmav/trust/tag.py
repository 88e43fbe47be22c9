"""The tag of a proof: shows whom it is meant for, for the price of a hash, that its signature is worth looking at.

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
import threading

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from zmav.trust.certificate import Certificate
from zmav.trust.credentials import Credentials

TAG = 16
"""bytes"""
MOST = 512
"""members whose key is kept"""
CONTEXT = b"zmav tags 1"
P = 2**255 - 19
"""the field of Curve25519"""


class Tags:
    """One member's. Thread-safe."""

    def __init__(self, credentials: Credentials) -> None:
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
            known = HKDF(SHA256(), 32, salt=None, info=CONTEXT + both).derive(shared)
            with self._lock:
                self._keys[other.fingerprint] = known
                while len(self._keys) > MOST:
                    self._keys.popitem(last=False)
        return known


def _montgomery(key: Ed25519PublicKey) -> X25519PublicKey:
    """The same point on Curve25519: u = (1 + y) / (1 - y)."""
    y = int.from_bytes(key.public_bytes_raw(), "little") & (1 << 255) - 1
    u = (1 + y) * pow(1 - y, -1, P) % P
    return X25519PublicKey.from_public_bytes(u.to_bytes(32, "little"))
