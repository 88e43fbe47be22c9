"""Proof of origin: who put a payload on a key, signed, in the attachment of the Zenoh message that carries it.

Zenoh's access rules judge the neighbour on a link, and vehicles relay for each other: so the vehicle itself looks who
an order comes from. The attachment, numbers big-endian:

    offset  bytes
         0      1  version: 1
         1      1  flags: bit 0, the signer's certificate follows; bit 1, a tag for who it is meant for follows
         2      8  UTC in microseconds at which it was signed
        10      8  nonce, random: makes each proof good for one use
        18      8  fingerprint of the signer's certificate: the first bytes of SHA-256 over its DER form
        26      8  what it answers: of an order the vehicle's ``gate``, which is new with each start of its agent and
                   when its clock is set back, so that nothing recorded before can be told it again, or the challenge
                   that the vehicle gave where the clocks disagree; of an answer the asker's challenge: the nonce of
                   the order's proof, or the 8 bytes that came with a question; else 0
        34     64  Ed25519 signature
        98     16  the tag (:mod:`zmav.trust.seal`), where the flag says so
         -      -  the certificate in DER form, where the flag says so

What is signed: the context, the length of the key (2 bytes), the key, the 34 bytes above, the payload. Answers have a
context of their own, so that none is ever taken for an order or a state, and none of those for an answer.
"""

from __future__ import annotations

import os
import struct
import threading
import time
from typing import NamedTuple

from zmav.errors import Forbidden
from zmav.trust.certificate import FINGERPRINT, Certificate
from zmav.trust.credentials import Credentials
from zmav.trust.seal import TAG, Tags

VERSION = 1
INTRODUCED, TAGGED = 1, 2
TOLD, ANSWERED = b"zmav proof of origin 1", b"zmav proof of an answer 1"
"""contexts: of what somebody says, and of what somebody answers"""
NONCE, ANSWERS, SIGNATURE = 8, 8, 64
NOTHING = bytes(ANSWERS)
MOST = 2048
"""bytes of an attachment: a certificate has some 400"""
WINDOW = 30.0
"""s by which a proof's time may differ from the clock of who checks it"""
_HEAD = struct.Struct(f">BBQ{NONCE}s{FINGERPRINT}s{ANSWERS}s")
UNINTRODUCED = _HEAD.size + SIGNATURE
"""bytes of an attachment before the tag and the certificate"""


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
    tag: bytes = b""
    """empty where there is none"""

    def is_of(self, certificate: Certificate, key: str, payload: bytes, context: bytes) -> bool:
        """The holder of ``certificate`` signed ``payload`` for ``key``."""
        from cryptography.exceptions import InvalidSignature

        try:
            certificate.key.verify(self.signature, _signed(context, self.head, key, payload))
        except InvalidSignature:
            return False
        return True

    def is_for(self, tags: Tags, by: Certificate, key: str, payload: bytes, context: bytes) -> bool:
        """The holder of ``by`` made it, for who has ``tags``: its signature is worth looking at."""
        return bool(self.tag) and tags.fits(by, _signed(context, self.head, key, payload) + self.signature, self.tag)


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
    tagged = TAG if flags & TAGGED else 0
    if flags & ~(INTRODUCED | TAGGED) or rest < tagged or bool(flags & INTRODUCED) != (rest > tagged):
        raise malformed(f"a proof of origin with flags {flags:#x} and {rest} bytes behind it")
    signature, behind = attachment[_HEAD.size : UNINTRODUCED], attachment[UNINTRODUCED:]
    head = attachment[: _HEAD.size]
    return Proof(micros / 1e6, nonce, fingerprint, answers, signature, behind[tagged:], head, behind[:tagged])


def challenge(attachment: bytes | None) -> bytes | None:
    """What an answer to a question with this attachment is to name; None: the asker looks for no signature."""
    if attachment is None:
        return None
    if len(attachment) == NONCE:
        return attachment
    return _HEAD.unpack_from(attachment)[3] if len(attachment) >= _HEAD.size else None


def speaker(attachment: bytes | None) -> bytes:
    """The fingerprint that a proof bears; empty where there is none."""
    return _HEAD.unpack_from(attachment)[4] if attachment is not None and len(attachment) >= _HEAD.size else b""


def malformed(text: str) -> Forbidden:
    return Forbidden(text, reason="malformed")


class Signer:
    """Signs in a member's name. Thread-safe.

    Its times never go back with a clock that is set back a little: what is newer is told from what is older by them.
    """

    def __init__(self, credentials: Credentials) -> None:
        self.certificate, self._key = credentials.certificate, credentials.key
        self._tags = Tags(credentials)
        self._last = 0
        self._lock = threading.Lock()

    def answer(
        self, key: str, payload: bytes, asked: bytes, *, introduce: bool = True, to: Certificate | None = None
    ) -> bytes:
        """The attachment of an answer to who sent the challenge ``asked``."""
        return self.sign(key, payload, introduce=introduce, answers=asked, context=ANSWERED, to=to)

    def sign(
        self,
        key: str,
        payload: bytes,
        *,
        introduce: bool = False,
        answers: bytes = NOTHING,
        now: float | None = None,
        context: bytes = TOLD,
        to: Certificate | None = None,
    ) -> bytes:
        """The attachment that goes with ``payload`` on ``key``.

        ``introduce``: with our certificate, for who may not know it. ``now``: UTC seconds, of the clock by default.
        ``to``: whom it is meant for, that who forges our name cannot have it left unread.
        """
        certificate = self.certificate
        micros = self._next() if now is None else round(now * 1e6)
        nonce = os.urandom(NONCE)
        flags = (INTRODUCED if introduce else 0) | (TAGGED if to is not None else 0)
        head = _HEAD.pack(VERSION, flags, micros, nonce, certificate.fingerprint, answers)
        signature = self._key.sign(signed := _signed(context, head, key, payload))
        tag = self._tags.make(to, signed + signature) if to is not None else b""
        return head + signature + tag + (certificate.der if introduce else b"")

    def _next(self) -> int:
        """UTC in µs, each later than the last, unless the clock went back so far that nobody could believe that."""
        with self._lock:
            micros = round(time.time() * 1e6)
            if micros <= self._last < micros + 2e6 * WINDOW:
                micros = self._last + 1
            self._last = micros
            return micros


def _signed(context: bytes, head: bytes, key: str, payload: bytes) -> bytes:
    name = key.encode()
    return b"".join((context, struct.pack(">H", len(name)), name, head, payload))
