"""The vehicle's gate: whether an order or a frame comes from who may give it."""

from __future__ import annotations

import collections
import contextlib
import hashlib
import hmac
import os
import struct
import threading
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from zmav import keys
from zmav.bus import Bus
from zmav.errors import Forbidden
from zmav.trust import proof
from zmav.trust.certificate import Role
from zmav.trust.credentials import Credentials
from zmav.trust.proof import WINDOW
from zmav.trust.rights import check_source, may
from zmav.trust.seal import Tags
from zmav.trust.verify import BUSY, Verifier

EPOCH = "epoch"
"""the reason for a proof that does not answer this gate; ``gate`` in the detail is what to answer"""
MOST_USED_AT_ALL = 65_536
PANIC = ("hold", "land", "rtl")
"""orders that pass between clocks that disagree: who gives one signs a challenge, which shows that it is new"""
CHALLENGED = 15.0
"""s for which a challenge is good at least; at most twice that"""
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


class _Used:
    """Proofs that were taken."""

    def __init__(self) -> None:
        self.until: collections.OrderedDict[tuple[bytes, bytes], float] = collections.OrderedDict()
        """(fingerprint, nonce) -> monotonic seconds until which its time is one that is taken"""
        self.by: collections.Counter[bytes] = collections.Counter()
        """how many of each fingerprint"""


class ProofRefused(NamedTuple):
    """What somebody put or asked was not proven to come from who may. Told from the thread that asked."""

    error: Forbidden


class Gate(Verifier):
    """One vehicle's. Thread-safe.

    ``given`` are the verbs that the fleet file gives to planners. ``bus`` is told of every
    :class:`ProofRefused`; ``counts`` counts them by reason.
    """

    most_used = 8192
    """proofs of one certificate that are remembered: some 126 a second"""

    def __init__(
        self,
        credentials: Credentials,
        utc: Callable[[], float] = time.time,
        monotonic: Callable[[], float] = time.monotonic,
        given: Collection[str] = (),
        bus: Bus | None = None,
    ) -> None:
        self.bus = bus or Bus()
        self._given = given
        tags = Tags(credentials)
        super().__init__(credentials.authority, credentials.fleet, credentials.roster, utc, monotonic, tags=tags)
        self.name = credentials.name
        self._shut_out = frozenset(credentials.roster.revoked)
        """whom the rules of our door know to be turned out: they were made from the same roster"""
        self.epoch = os.urandom(proof.ANSWERS)
        """what every proof must answer: one that was given to an earlier start of the vehicle's agent does not, nor one
        from before our clock was set back, whose time may be a good one for a second time"""
        self._secret = os.urandom(32)
        """makes the challenges, so that none need be kept, and anyone who asks for many takes nobody's away"""
        self._ahead = utc() - monotonic()
        self.counts: collections.Counter[str] = collections.Counter()
        self._used, self._panics = _Used(), _Used()
        """of panic orders apart: a station's frames, many a second, leave them room"""
        self._using = threading.Lock()
        self._told: dict[tuple[str, str], float] = {}
        """by key and member: when the last that it told everybody was signed (UTC seconds)"""

    def check(self, key: str, payload: bytes, attachment: bytes | None) -> Origin:
        """Who put ``payload`` on ``key``, where that one may; raises :class:`Forbidden` with a ``reason``:

        unsigned, malformed, clock (with a ``challenge`` where the answer to one is taken instead), replayed, unknown,
        stranger, fleet, revoked, expired, role, epoch, signature, busy (not looked at for want of time).
        """
        with self._refusing():
            return self._check_all(key, payload, attachment)

    def admit(self, key: str, payload: bytes, attachment: bytes | None) -> Origin | None:
        """Who asks a question, where anybody may; raises :class:`Forbidden` for whom the fleet has turned out.

        Questions need no proof while our door keeps out those whom the fleet has turned out. From a revocation that
        came since it was opened they do, until it is opened again, in flight it is not. The proof is good for 30 s
        and answers no challenge: it moves nothing.
        """
        if self._shut_out.issuperset(self.roster.revoked):
            return None
        with self._refusing():
            found, by = self.verify(key, payload, attachment)
        return Origin(by.name, by.role, by.fingerprint, found.t)

    def check_told(self, key: str, payload: bytes, attachment: bytes | None) -> Origin:
        """Who told that to the whole fleet, where that one may; raises :class:`Forbidden` as :meth:`check` does.

        It answers no gate, for it is meant for all of them: its time is of now by our clock, and later than that of
        the last that was taken of that member there. Who is not known yet introduces itself within a second.
        """
        with self._refusing("unknown", BUSY):
            channel, parts = keys.match(key)
            found, by = self.verify(key, payload, attachment)
            may(by.role, by.name, channel, parts, self._given)
            check_source(by.role, by.name, channel, payload)
            with self._using:
                # Both were of now when they came: one that is farther ahead shows that the clocks were set.
                if found.t <= self._told.get((key, by.name), 0.0) <= found.t + 2 * WINDOW:
                    raise Forbidden("it was signed before the last one that came", reason="replayed")
                self._told[key, by.name] = found.t
        return Origin(by.name, by.role, by.fingerprint, found.t)

    @contextlib.contextmanager
    def _refusing(self, *unsaid: str) -> Iterator[None]:
        """Count what is refused within, and say it, but for what is refused for these reasons."""
        try:
            yield
        except Forbidden as e:
            self.counts[str(e.detail["reason"])] += 1
            if e.detail["reason"] not in unsaid:
                self.bus.tell(ProofRefused(e))
            raise

    def _check_all(self, key: str, payload: bytes, attachment: bytes | None) -> Origin:
        channel, parts = keys.match(key)
        self._watch_clock()
        found = self.read(attachment, fresh=False)
        once = (found.fingerprint, found.nonce)
        panics = channel is keys.DO and parts["verb"] in PANIC
        challenged = panics and any(
            hmac.compare_digest(found.answers, self._challenge(key, found, ago)) for ago in (0, 1)
        )
        if not challenged:
            self._check_now(key, payload, channel, found, panics)
        if not challenged and found.answers != self.epoch:
            text = (
                f"its proof of origin is not for this start of {self.name}'s agent: sign it for the gate in its state"
            )
            # A planner whose clock is ahead may change the epoch again and again: what makes safe passes all the same.
            other = {"challenge": self._challenge(key, found).hex()} if panics else {}
            raise Forbidden(text, reason=EPOCH, gate=self.epoch.hex(), **other)
        used = self._panics if panics else self._used
        if once in used.until:
            raise Forbidden("it was heard before", reason="replayed")
        certificate = self.certificate_of(found, dated=not challenged)
        may(certificate.role, certificate.name, channel, parts, self._given)
        self.check_signature(found, certificate, key, payload)
        self._use(used, once, certificate.name)
        return Origin(certificate.name, certificate.role, certificate.fingerprint, found.t)

    def _check_now(self, key: str, payload: bytes, channel: keys.Channel, found: proof.Proof, panics: bool) -> None:
        try:
            self.check_time(found, challenge=self._challenge(key, found).hex() if panics else "")
        except Forbidden:
            if channel is keys.DO and self.ahead(found) > 0.0 and found.answers == self.epoch:
                with contextlib.suppress(Forbidden):
                    certificate = self.certificate_of(found)
                    self.check_signature(found, certificate, key, payload)
                    may(certificate.role, certificate.name, channel, keys.match(key)[1], self._given)
                    if certificate.role is not Role.VIEWER:  # who moves nothing voids nobody's proofs
                        self.epoch = os.urandom(proof.ANSWERS)  # or it would be good when its time comes
            raise

    def _challenge(self, key: str, found: proof.Proof, ago: int = 0) -> bytes:
        """What a panic order of that member must answer now, or so many turns ago."""
        turn = struct.pack(">q", int(self._monotonic() / CHALLENGED) - ago)
        return hmac.digest(self._secret, turn + found.fingerprint + key.encode(), hashlib.sha256)[: proof.ANSWERS]

    def _watch_clock(self) -> None:
        ahead = self.utc() - self._monotonic()
        with self._using:
            if ahead < self._ahead - SETBACK:
                self.epoch = os.urandom(proof.ANSWERS)
            elif ahead <= self._ahead:
                return
            self._ahead = ahead

    def _use(self, used: _Used, once: tuple[bytes, bytes], name: str) -> None:
        """Remember a proof for as long as its time is one that is taken."""
        now = self._monotonic()
        with self._using:
            while used.until and next(iter(used.until.values())) < now:
                (old, _), _ = used.until.popitem(last=False)
                used.by[old] -= 1
                if not used.by[old]:
                    del used.by[old]
            if once in used.until:
                raise Forbidden("it was heard before", reason="replayed")
            if used.by[once[0]] >= self.most_used or len(used.until) >= MOST_USED_AT_ALL:
                raise Forbidden(f"too many orders of {name} at present", reason=BUSY, origin=name)
            used.until[once] = now + 2 * WINDOW + SETBACK
            used.by[once[0]] += 1
