"""Proof of origin: who put a payload on a key, signed, in the attachment of the Zenoh message that carries it.

Zenoh's access rules judge the neighbour on a link, and vehicles relay for each other: so the vehicle itself looks who
an order comes from. The attachment, numbers big-endian:

    offset  bytes
         0      1  version: 1
         1      1  flags: bit 0, the signer's certificate follows
         2      8  UTC in microseconds at which it was signed
        10      8  nonce, random: makes each proof good for one use
        18      8  fingerprint of the signer's certificate: the first bytes of SHA-256 over its DER form
        26      8  what it answers: of an order the vehicle's ``gate``, which is new with each start of its agent and
                   when its clock is set back, so that nothing recorded before can be told it again, or the challenge
                   that the vehicle gave where the clocks disagree; of an answer the asker's challenge: the nonce of
                   the order's proof, or the 8 bytes that came with a question; else 0
        34     64  Ed25519 signature
        98      -  the certificate in DER form, where the flag says so

What is signed: the context, the length of the key (2 bytes), the key, the 34 bytes above, the payload.
"""

from __future__ import annotations

import os
import struct
import threading
import time
from typing import NamedTuple

from cryptography.exceptions import InvalidSignature

from zmav.errors import Forbidden
from zmav.trust.certificate import FINGERPRINT, Certificate
from zmav.trust.credentials import Credentials

VERSION = 1
INTRODUCED = 1
CONTEXT = b"zmav proof of origin 1"
NONCE, ANSWERS, SIGNATURE = 8, 8, 64
NOTHING = bytes(ANSWERS)
MOST = 2048
"""bytes of an attachment: a certificate has some 400"""
WINDOW = 30.0
"""s by which a proof's time may differ from the clock of who checks it"""
_HEAD = struct.Struct(f">BBQ{NONCE}s{FINGERPRINT}s{ANSWERS}s")
UNINTRODUCED = _HEAD.size + SIGNATURE
"""bytes of an attachment before the certificate"""


class Proof(NamedTuple):
    """An attachment, taken apart; nothing in it is checked yet."""

    t: float
    """UTC seconds"""
    nonce: bytes
    fingerprint: bytes
    answers: bytes
    signature: bytes
    certificate: bytes
    """DER; empty where it was not sent"""
    head: bytes

    def is_of(self, certificate: Certificate, key: str, payload: bytes) -> bool:
        """The holder of ``certificate`` signed ``payload`` for ``key``."""
        try:
            certificate.key.verify(self.signature, _signed(self.head, key, payload))
        except InvalidSignature:
            return False
        return True


def read(attachment: bytes) -> Proof:
    """Take an attachment apart; raises :class:`Forbidden` for what is none of ours."""
    if len(attachment) > MOST:
        raise malformed(f"{len(attachment)} bytes are no proof of origin (at most {MOST})")
    rest = len(attachment) - _HEAD.size - SIGNATURE
    if rest < 0:
        raise malformed(f"{len(attachment)} bytes are no proof of origin (at least {_HEAD.size + SIGNATURE})")
    version, flags, micros, nonce, fingerprint, answers = _HEAD.unpack_from(attachment)
    if version != VERSION:
        raise malformed(f"a proof of origin of version {version}; version {VERSION} is known here")
    if flags & ~INTRODUCED or bool(flags) != bool(rest):
        raise malformed(f"a proof of origin with flags {flags:#x} and {rest} bytes behind it")
    signature = attachment[_HEAD.size : _HEAD.size + SIGNATURE]
    certificate, head = attachment[_HEAD.size + SIGNATURE :], attachment[: _HEAD.size]
    return Proof(micros / 1e6, nonce, fingerprint, answers, signature, certificate, head)


def challenge(attachment: bytes | None) -> bytes | None:
    """What an answer to a question with this attachment is to name; None: the asker looks for no signature."""
    if attachment is None:
        return None
    if len(attachment) == NONCE:
        return attachment
    return _HEAD.unpack_from(attachment)[3] if len(attachment) >= _HEAD.size else None


def malformed(text: str) -> Forbidden:
    return Forbidden(text, reason="malformed")


class Signer:
    """Signs in a member's name. Thread-safe.

    Its times never go back with a clock that is set back a little: what is newer is told from what is older by them.
    """

    def __init__(self, credentials: Credentials) -> None:
        self.certificate, self._key = credentials.certificate, credentials.key
        self._last = 0
        self._lock = threading.Lock()

    def sign(
        self, key: str, payload: bytes, *, introduce: bool = False, answers: bytes = NOTHING, now: float | None = None
    ) -> bytes:
        """The attachment that goes with ``payload`` on ``key``.

        ``introduce``: with our certificate, for who may not know it. ``now``: UTC seconds, of the clock by default.
        """
        certificate = self.certificate
        micros = self._next() if now is None else round(now * 1e6)
        nonce = os.urandom(NONCE)
        head = _HEAD.pack(VERSION, INTRODUCED if introduce else 0, micros, nonce, certificate.fingerprint, answers)
        signature = self._key.sign(_signed(head, key, payload))
        return head + signature + (certificate.der if introduce else b"")

    def _next(self) -> int:
        """UTC in µs, each later than the last, unless the clock went back so far that nobody could believe that."""
        with self._lock:
            micros = round(time.time() * 1e6)
            if micros <= self._last < micros + 2e6 * WINDOW:
                micros = self._last + 1
            self._last = micros
            return micros


def _signed(head: bytes, key: str, payload: bytes) -> bytes:
    name = key.encode()
    return b"".join((CONTEXT, struct.pack(">H", len(name)), name, head, payload))
