"""The vehicle's gate: whether an order, a frame or an upload comes from who may give it."""

from __future__ import annotations

import collections
import os
import threading
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, field

from zmav import keys
from zmav.errors import Forbidden
from zmav.trust import proof
from zmav.trust.certificate import Role
from zmav.trust.credentials import Credentials
from zmav.trust.proof import WINDOW
from zmav.trust.rights import may
from zmav.trust.verify import BUSY, Verifier

EPOCH = "epoch"
"""the reason for a proof that does not answer this gate; ``gate`` in the detail is what to answer"""
MOST_USED = 8192
"""proofs of one certificate that are remembered: some 126 a second"""
MOST_USED_AT_ALL = 65_536
SETBACK = 5.0
"""s by which our clock may go back before all that was signed until then is worth nothing"""


@dataclass(frozen=True)
class Origin:
    """Who it is that asks, proven; the same member after its certificate was renewed, too."""

    name: str
    role: Role
    fingerprint: bytes = field(default=b"", compare=False)
    t: float = field(default=0.0, compare=False)
    """UTC seconds at which it was asked, by its own clock"""


Prove = Callable[[str, bytes, "bytes | None"], "Origin | None"]
"""``prove(key, payload, attachment)``: who it is from, None where nobody looks; raises :class:`Forbidden`"""


def anybody(key: str, payload: bytes, attachment: bytes | None) -> Origin | None:
    """Without credentials nothing is proven."""
    return None


class Gate(Verifier):
    """One vehicle's. Thread-safe.

    ``given`` are the verbs that the fleet file gives to planners. ``on_refused(error)`` is told of every refusal, in
    the thread that asked; ``counts`` counts them by reason.
    """

    def __init__(
        self, credentials: Credentials, utc: Callable[[], float] = time.time,
        monotonic: Callable[[], float] = time.monotonic, given: Collection[str] = (),
    ) -> None:  # fmt: skip
        self._given = given
        super().__init__(credentials.authority, credentials.fleet, credentials.roster, utc, monotonic)
        self.name = credentials.name
        self.epoch = os.urandom(proof.ANSWERS)
        """what every proof must answer: one that was given to an earlier start of the vehicle's agent does not, nor one
        from before our clock was set back, whose time may be a good one for a second time"""
        self._ahead = utc() - monotonic()
        self.counts: collections.Counter[str] = collections.Counter()
        self.on_refused: Callable[[Forbidden], None] = lambda error: None
        self._used: collections.OrderedDict[tuple[bytes, bytes], float] = collections.OrderedDict()
        """(fingerprint, nonce) -> monotonic seconds until which its time is one that is taken"""
        self._by: collections.Counter[bytes] = collections.Counter()
        self._using = threading.Lock()

    def check(self, key: str, payload: bytes, attachment: bytes | None) -> Origin:
        """Who put ``payload`` on ``key``, where that one may; raises :class:`Forbidden` with a ``reason``:

        unsigned, malformed, clock, replayed, unknown, stranger, fleet, revoked, expired, role, epoch, signature, busy
        (not looked at for want of time).
        """
        try:
            return self._check_all(key, payload, attachment)
        except Forbidden as e:
            self.counts[str(e.detail["reason"])] += 1
            self.on_refused(e)
            raise

    def _check_all(self, key: str, payload: bytes, attachment: bytes | None) -> Origin:
        channel, parts = keys.match(key)
        self._watch_clock()
        found = self.read(attachment)
        once = (found.fingerprint, found.nonce)
        if found.answers != self.epoch:
            text = (
                f"its proof of origin is not for this start of {self.name}'s agent: sign it for the gate in its state"
            )
            raise Forbidden(text, reason=EPOCH, gate=self.epoch.hex())
        if once in self._used:
            raise Forbidden("it was heard before", reason="replayed")
        certificate = self.certificate_of(found)
        may(certificate.role, certificate.name, channel, parts, self._given)
        self.check_signature(found, certificate, key, payload)
        if channel is not keys.UPLOAD:  # a chunk that comes again stands where it stood, and there are many
            self._use(once, certificate.name)
        return Origin(certificate.name, certificate.role, certificate.fingerprint, found.t)

    def _watch_clock(self) -> None:
        ahead = self._utc() - self._monotonic()
        with self._using:
            if ahead < self._ahead - SETBACK:
                self.epoch = os.urandom(proof.ANSWERS)
            elif ahead <= self._ahead:
                return
            self._ahead = ahead

    def _use(self, once: tuple[bytes, bytes], name: str) -> None:
        """Remember a proof for as long as its time is one that is taken."""
        now = self._monotonic()
        with self._using:
            while self._used and next(iter(self._used.values())) < now:
                (old, _), _ = self._used.popitem(last=False)
                self._by[old] -= 1
                if not self._by[old]:
                    del self._by[old]
            if once in self._used:
                raise Forbidden("it was heard before", reason="replayed")
            if self._by[once[0]] >= MOST_USED or len(self._used) >= MOST_USED_AT_ALL:
                raise Forbidden(f"too many orders of {name} at present", reason=BUSY, origin=name)
            self._used[once] = now + 2 * WINDOW + SETBACK
            self._by[once[0]] += 1
