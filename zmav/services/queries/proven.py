"""Proofs of origin in Zenoh's queries, samples and answers."""

from __future__ import annotations

import base64
import binascii
import time

import zenoh

from zmav import keys, wire
from zmav.errors import Forbidden, ZmavError
from zmav.trust.certificate import Certificate
from zmav.trust.proof import UNINTRODUCED, Signer, challenge, speaker
from zmav.trust.seal import TAG
from zmav.trust.verify import BUSY, Allowance, Verifier

CERTIFICATE = "certificate"
REFUSALS = 300.0
"""refusals that are signed in a second: who floods us with orders must not keep the processor busy with signatures"""


def attached(message: zenoh.Query | zenoh.Sample) -> bytes | None:
    """The attachment; None where there is none."""
    found = message.attachment
    return None if found is None else found.to_bytes()


def proof_of_error(reply: zenoh.ReplyError, error: ZmavError) -> bytes | None:
    """The proof of an error reply. Zenoh gives errors no attachment: it stands in the schema of the encoding, and the
    certificate, for which a schema has no room (255 bytes), in the detail, from where it is taken.
    """
    schema, certificate = str(reply.encoding).partition(";")[2], error.detail.pop(CERTIFICATE, "")
    try:
        return base64.b64decode(schema, validate=True) + base64.b64decode(certificate) if schema else None
    except (TypeError, binascii.Error, ValueError):
        return None


class Answers:
    """Answers queries: signed over the asker's challenge where we have credentials and it sent one. Thread-safe.

    ``verifier``: knows who asks, for the tag by which forged answers in our name shut out none of ours.
    """

    def __init__(self, signer: Signer | None, verifier: Verifier | None) -> None:
        self._signer, self._verifier = signer, verifier
        self._refusals = Allowance(REFUSALS, time.monotonic)

    def give(self, query: zenoh.Query, key: str, payload: bytes, *, introduce: bool = True) -> None:
        """``introduce``: with our certificate, for who may not know it."""
        proof, asked = None, self._challenge(query)
        if self._signer is not None and asked is not None:
            proof = self._signer.answer(key, payload, asked, introduce=introduce, to=self._asker(query))
        query.reply(key, payload, encoding=keys.JSON, attachment=proof)

    def refuse(self, query: zenoh.Query, error: ZmavError) -> None:
        """Say why not. Who was not looked at for want of time gets no answer, and asks again."""
        if error.detail.get("reason") == BUSY and isinstance(error, Forbidden):
            return
        asked = self._challenge(query)
        if self._signer is None or asked is None or not self._refusals.take():
            query.reply_err(wire.error_body(error), encoding=keys.JSON)
            return
        certificate = base64.b64encode(self._signer.certificate.der).decode()
        body = wire.error_body(error, **{CERTIFICATE: certificate})
        to = self._asker(query)
        proof = self._signer.answer(str(query.key_expr), body, asked, to=to)[: UNINTRODUCED + (TAG if to else 0)]
        query.reply_err(body, encoding=keys.JSON.with_schema(base64.b64encode(proof).decode()))

    def _asker(self, query: zenoh.Query) -> Certificate | None:
        """As the question says: a tag for another is of no use to anybody."""
        return None if self._verifier is None else self._verifier.known(speaker(attached(query)))

    def _challenge(self, query: zenoh.Query) -> bytes | None:
        return challenge(attached(query))
