"""Checking proofs of origin: whose certificate, of which authority, in force, and signed by its holder.

Cheap checks go first, and what costs a signature's check is limited where anybody could cause it, so that a flood of
forgeries takes a bounded share of the processor.
"""

from __future__ import annotations

import collections
import contextlib
import threading
import time
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from zmav.errors import BadConfig, BadInput, Forbidden
from zmav.trust import proof
from zmav.trust.certificate import Certificate, Role, fingerprint
from zmav.trust.credentials import Credentials
from zmav.trust.proof import WINDOW
from zmav.trust.roster import Roster
from zmav.trust.seal import Tags

if TYPE_CHECKING:
    from cryptography import x509

STRANGERS = 20.0
"""certificates that are neither known nor on the roster, and are looked at in a second"""
FORGERIES = 300.0
"""wrong signatures that are looked at in a second, of each certificate; one costs some 150 µs. Of those that bear its
holder's tag, which nobody else can make, as many again
"""
VEHICLE = Role.VEHICLE.value
BUSY = "busy"
"""the reason for what was not looked at for want of time: the one who asked may ask again"""


class Allowance:
    """So many a second, and a second's worth at once: a token bucket. Not thread-safe."""

    def __init__(self, rate: float, clock: Callable[[], float]) -> None:
        self._rate, self._clock = rate, clock
        self._left, self._at = rate, clock()

    def _fill(self) -> None:
        now = self._clock()
        self._left, self._at = min(self._left + (now - self._at) * self._rate, self._rate), now

    @property
    def spent(self) -> bool:
        """None is left at present."""
        self._fill()
        return self._left < 1.0

    def take(self) -> bool:
        """Take one; False where none is left."""
        if self.spent:
            return False
        self._left -= 1.0
        return True


class Verifier:
    """Knows the fleet's authority and roster, and remembers the certificates it has seen. Thread-safe.

    ``utc`` and ``monotonic`` are clocks in seconds; a certificate that ended at most ``grace`` s ago is believed.
    ``tags``: of who judges.
    """

    most_known = 512
    """certificates remembered; the one unused for longest goes first"""

    def __init__(
        self,
        authority: x509.Certificate,
        fleet: str,
        roster: Roster,
        utc: Callable[[], float] = time.time,
        monotonic: Callable[[], float] = time.monotonic,
        grace: float = 0.0,
        tags: Tags | None = None,
    ) -> None:
        self._grace, self._tags = grace, tags
        self.authority, self.fleet, self._roster = authority, fleet, roster
        self._revoked, self._listed = _fingerprints(roster)
        self._roles, self._met = _roles(roster), set[str]()
        self.utc, self._monotonic = utc, monotonic
        self._lock = threading.Lock()
        self._known: collections.OrderedDict[bytes, Certificate] = collections.OrderedDict()
        self._strangers = Allowance(STRANGERS, monotonic)
        self._forgeries: dict[tuple[bytes, bool], Allowance] = {}

    @classmethod
    def of(cls, credentials: Credentials, grace: float = 0.0) -> Verifier:
        """As the member of these credentials judges others."""
        return cls(credentials.authority, credentials.fleet, credentials.roster, grace=grace, tags=Tags(credentials))

    @property
    def roster(self) -> Roster:
        """Whom the authority has turned out; it may be replaced by a newer one at any time."""
        return self._roster

    @roster.setter
    def roster(self, newer: Roster) -> None:
        if newer.fleet == self.fleet and newer.number > self._roster.number:
            self._roster = newer
            self._revoked, self._listed = _fingerprints(newer)
            with self._lock:
                known = [one for one in self._known.values() if one.fingerprint not in self._revoked]
                self._roles, self._met = _roles(newer), {one.name for one in known if one.role is Role.VEHICLE}

    def is_vehicle(self, fleet: str, name: str) -> bool:
        """Whether that is a vehicle of ours: on the roster, or by a certificate that was met and is not on ours yet.

        Nobody else has frames, a beacon or a place beside a target: they are not signed, so readers ask this of their
        keys. It costs two looks into dictionaries.
        """
        return fleet == self.fleet and self.role_of(name) == VEHICLE

    def role_of(self, name: str) -> str:
        """The role of a name of our fleet; empty where we know none of it."""
        return self._roles.get(name, VEHICLE if name in self._met else "")

    def learn(self, der: bytes) -> Certificate:
        """Remember a certificate that the authority signed; raises :class:`Forbidden` for any other.

        A certificate of another fleet, one that is not valid now, and one that was revoked are not believed either.
        """
        try:
            certificate = Certificate.read(der)
            certificate.check_issuer(self.authority)
        except BadInput as e:
            raise Forbidden(e.message, reason="stranger") from e
        self._check(certificate)
        with self._lock:
            self._known[certificate.fingerprint] = certificate
            if certificate.role is Role.VEHICLE:
                self._met.add(certificate.name)
            while len(self._known) > self.most_known:
                gone, _ = self._known.popitem(last=False)
                for tagged in (False, True):
                    self._forgeries.pop((gone, tagged), None)
        return certificate

    def known(self, fingerprint: bytes) -> Certificate | None:
        """A certificate that is remembered."""
        with self._lock:
            return self._known.get(fingerprint)

    def meet(self, der: bytes) -> Certificate:
        """As :meth:`learn`, for what anybody may have sent: of those not on the roster, so many a second."""
        with self._lock:
            if fingerprint(der) not in self._listed and not self._strangers.take():
                raise Forbidden("too many unknown certificates at present", reason=BUSY)
        return self.learn(der)

    def verify(
        self,
        key: str,
        payload: bytes,
        attachment: bytes | None,
        *,
        answers: bytes = proof.NOTHING,
        fresh: bool = True,
        context: bytes = proof.TOLD,
    ) -> tuple[proof.Proof, Certificate]:
        """Who signed ``payload`` for ``key``; raises :class:`Forbidden` with a ``reason`` in its detail.

        ``answers``: what it must answer. ``fresh``: it is not old by our clock. Whether it comes a second time is not
        looked at here.
        """
        found = self.read(attachment, fresh=fresh)
        if found.answers != answers:
            raise Forbidden("its proof of origin answers something else than what was asked", reason="replayed")
        certificate = self.certificate_of(found)
        self.check_signature(found, certificate, key, payload, context)
        return found, certificate

    def verify_answer(
        self, key: str, payload: bytes, attachment: bytes | None, asked: bytes
    ) -> tuple[proof.Proof, Certificate]:
        """As :meth:`verify`, of an answer to our challenge ``asked``, which says that it is new: no clock matters."""
        return self.verify(key, payload, attachment, answers=asked, fresh=False, context=proof.ANSWERED)

    # The same in parts, for who has something to look at in between.

    def read(self, attachment: bytes | None, *, fresh: bool = True) -> proof.Proof:
        """The proof in an attachment; raises :class:`Forbidden` where there is none, or where its time is wrong."""
        if attachment is None or len(attachment) == proof.NONCE:  # a challenge alone: who asks has credentials
            raise Forbidden("it carries no proof of origin: open the session with --credentials", reason="unsigned")
        found = proof.read(attachment)
        if fresh:
            self.check_time(found)
        return found

    def ahead(self, found: proof.Proof) -> float:
        """s by which the time that a proof bears is ahead of our clock."""
        return found.t - self.utc()

    def check_time(self, found: proof.Proof, ahead: float = 0.0, challenge: str = "") -> None:
        """Raise :class:`Forbidden` for a proof that is not of now by a clock that is ``ahead`` of ours by so many s.

        ``challenge``: whose answer is taken instead.
        """
        off = self.ahead(found) - ahead
        if abs(off) > WINDOW:
            way = "ahead" if off > 0 else "old"
            text = f"its proof of origin is {abs(off):.1f} s {way} (at most {WINDOW:.0f}): set the clock that is off"
            more = {"challenge": challenge} if challenge else {}
            raise Forbidden(text, reason="clock", offset=round(off, 1), **more)

    def certificate_of(self, found: proof.Proof, *, dated: bool = True) -> Certificate:
        """The certificate a proof is by; raises :class:`Forbidden` where it is not known, or not in force.

        ``dated`` False: our clock is not to be trusted with the dates of one that is known.
        """
        with self._lock:
            known = self._known.get(found.fingerprint)
            if known is not None:
                self._known.move_to_end(found.fingerprint)
        if known is not None:
            return self._check(known, dated=dated)
        if not found.certificate:
            raise Forbidden("its certificate is not known here, and did not come with it", reason="unknown")
        if fingerprint(found.certificate) != found.fingerprint:
            raise proof.malformed("its certificate is not the one that it names")
        return self.meet(found.certificate)

    def check_signature(
        self, found: proof.Proof, certificate: Certificate, key: str, payload: bytes, context: bytes = proof.TOLD
    ) -> None:
        """Raises :class:`Forbidden` unless the holder of ``certificate`` signed just this.

        Wrong ones are looked at so many a second. Those with the holder's own tag are counted apart, so that anyone who
        forges its name, however often, shuts nobody out who tags what he says.
        """
        tagged = self._tags is not None and found.is_for(self._tags, certificate, key, payload, context)
        who = (certificate.fingerprint, tagged)
        with self._lock:
            forgeries = self._forgeries.get(who)
            if forgeries is not None and forgeries.spent:
                raise Forbidden(f"too many wrong signatures as {certificate.name} at present", reason=BUSY)
        if found.is_of(certificate, key, payload, context):
            return
        with self._lock:
            self._forgeries.setdefault(who, Allowance(FORGERIES, self._monotonic)).take()
        text = f"the signature is not {certificate.name}'s of this: it was changed, or is another's"
        raise Forbidden(text, reason="signature", origin=certificate.name)

    def _check(self, certificate: Certificate, *, dated: bool = True) -> Certificate:
        """Raises :class:`Forbidden` unless it is of this fleet and in force."""
        name = certificate.name
        if certificate.fleet != self.fleet:
            raise Forbidden(f"{name} is of the fleet {certificate.fleet}, not of {self.fleet}", reason="fleet")
        if certificate.fingerprint in self._revoked:
            raise Forbidden(f"the certificate of {name} was revoked", reason="revoked", origin=name)
        try:
            if dated:
                certificate.check_dates(self.utc(), self._grace)
        except BadConfig as e:
            raise Forbidden(e.message, reason="expired", origin=name) from e
        return certificate


def _fingerprints(roster: Roster) -> tuple[frozenset[bytes], frozenset[bytes]]:
    """The roster's revoked certificates, and its members'; what is no fingerprint names nobody."""
    revoked, listed = (_bytes(texts) for texts in (roster.revoked, [m.fingerprint for m in roster.members]))
    return revoked, listed


def _roles(roster: Roster) -> dict[str, str]:
    """The role of each name that is on the roster and not revoked."""
    return {name: role.value for role in Role for name in roster.names(role.value)}


def _bytes(texts: Iterable[str]) -> frozenset[bytes]:
    found = set()
    for text in texts:
        with contextlib.suppress(ValueError):
            found.add(bytes.fromhex(text))
    return frozenset(found)
