"""A member on the key space: signs what it asks and puts, and believes of vehicles what they signed."""

from __future__ import annotations

import collections
import os
import threading
import time
from collections.abc import Callable, Collection

from zmav import keys
from zmav.bus import Bus
from zmav.errors import BadInput, BadKey, Forbidden
from zmav.trust.certificate import Certificate, Role
from zmav.trust.credentials import Credentials
from zmav.trust.gate import EPOCH, Gate
from zmav.trust.proof import ANSWERS, NONCE, NOTHING, WINDOW, Signer, challenge
from zmav.trust.rights import acts_as, check_source, may
from zmav.trust.roster import read_signed
from zmav.trust.verify import Allowance, Verifier

INTRODUCE_EVERY = 5.0
"""s between two puts to a vehicle that carry our certificate; orders always do"""
INTRODUCE_TO_ALL = 1.0
"""s between two puts on one of the fleet's topics that carry it: who begins to listen, to that alone, must believe a
planner well before its silence would count
"""
GRACE = 86_400.0
"""s that what a vehicle says is believed after its certificate's end: who flies it is not to lose sight of it"""
ROSTERS = 200.0
"""signatures of rosters that are checked in a second: anybody may bring one, and the true one comes again"""
MOST_HEARERS = 4096
"""places and channels of which it is remembered who answers there"""
SIGNED = (keys.STATE, keys.EVENT)
"""what vehicles sign of what they publish"""
_FLEET = "@fleet"
_UNSIGNED = tuple(
    c.template.removeprefix("{fleet}/{vehicle}/").partition("{")[0] for c in keys.VEHICLES_OWN if c not in SIGNED
)
"""how the rest of what vehicles alone say begins, under their names"""
_ENDS = tuple("/" + channel.template.rpartition("/")[2] for channel in SIGNED)
"""most of what comes is neither, and is not to be matched with every channel there is"""

Place = tuple[str, str]
"""a fleet's name and a vehicle's"""


class Member:
    """Thread-safe. ``monotonic`` is a clock in seconds."""

    def __init__(self, credentials: Credentials, monotonic: Callable[[], float] = time.monotonic) -> None:
        self.credentials, self._monotonic = credentials, monotonic
        self.verifier, self.signer = Verifier.of(credentials, GRACE), Signer(credentials)
        self._made: list[Gate] = []
        self._gates: dict[Place, bytes] = {}
        self._others: dict[tuple[Place, str], bytes] = {}
        """of channels on which somebody else answers than the vehicle's agent: it has a gate of its own"""
        self._challenges: dict[str, bytes] = {}
        """of keys on which our next proof is to answer one: the vehicle's clock and ours disagree"""
        self._clocks: dict[Place, float] = {}
        """s by which a vehicle's clock is ahead of ours, where it has shown that"""
        self._introduced: dict[tuple[Place, str], float] = {}
        """by place, and of the whole fleet by topic"""
        self._hearers: dict[tuple[str, str, str], Certificate] = {}
        """by fleet, vehicle and channel: who answers there, so that what we say there bears a tag for it"""
        self._lock = threading.Lock()
        self._rosters = Allowance(ROSTERS, monotonic)
        self._questions = False
        """a vehicle wants to know who asks: the fleet has turned somebody out"""
        self.counts: collections.Counter[str] = collections.Counter()
        """states and events that were not believed, by reason"""

    # Out.

    def proof(self, key: str, payload: bytes) -> bytes | None:
        """The attachment for what is asked or put on a concrete key; None where the channel needs none."""
        try:
            channel, parts = keys.match(key)
        except BadKey:
            return None
        if not keys.proven(channel, parts):
            return None
        place = (parts["fleet"], parts.get("vehicle", _FLEET))
        topic = parts.get("topic", channel.name) if place[1] == _FLEET else ""
        introduce = self._introduces(place, topic) or channel is keys.DO
        gate = self._challenges.pop(key, None) or self._others.get((place, channel.name))
        gate = gate or self._gates.get(place, NOTHING)
        to = self._hearers.get((*place, channel.name)) or self._hearers.get((*place, keys.STATE.name))
        return self.signer.sign(key, payload, introduce=introduce, answers=gate, to=to)

    def question(self, key: str, payload: bytes) -> bytes | None:
        """The attachment for what is asked: a proof where the channel needs one or a vehicle wants to know who asks,
        else a challenge where answers are signed.
        """
        if (proof := self.proof(key, payload)) is not None:
            return proof
        if self._questions:
            _, fleet, vehicle, *_ = (*key.split("/"), "", "")
            return self.signer.sign(
                key, payload, introduce=True, to=self._hearers.get((fleet, vehicle, keys.STATE.name))
            )
        return os.urandom(NONCE) if keys.answerers(key) else None

    def _introduces(self, place: Place, topic: str) -> bool:
        now, every = self._monotonic(), INTRODUCE_TO_ALL if topic else INTRODUCE_EVERY
        with self._lock:
            if now - self._introduced.get((place, topic), -every) < every:
                return False
            self._introduced[place, topic] = now
            return True

    def answers(self, place: Place, gate: object) -> None:
        """What proofs for this vehicle are to answer from now on, as its state says."""
        found = _gate(gate)
        if found and self._gates.get(place) != found:
            with self._lock:
                self._gates[place] = found
                self._introduced.pop((place, ""), None)
                self._others = {at: other for at, other in self._others.items() if at[0] != place}

    def may_try_again(self, key: str, error: Forbidden) -> bool:
        """A refusal that another proof mends: the vehicle's agent has been started again, does not know us yet, or has
        another time than we have, and gives a challenge instead, or has come to want to know who asks.
        """
        if error.detail.get("reason") == "unsigned" and not self._questions:
            self._questions = True
            return True
        try:
            channel, parts = keys.match(key)
        except BadKey:
            return False
        place, reason = (parts["fleet"], parts.get("vehicle", _FLEET)), error.detail.get("reason")
        if reason == EPOCH and (gate := _gate(error.detail.get("gate"))):
            with self._lock:
                self._others[place, channel.name] = gate
                self._introduced.pop((place, ""), None)
            if challenge := _gate(error.detail.get("challenge")):
                self._challenges[key] = challenge
        elif reason == "clock" and (challenge := _gate(error.detail.get("challenge"))):
            self._challenges[key] = challenge
        elif reason == "unknown":
            with self._lock:
                self._introduced.pop((place, ""), None)
        else:
            return False
        return True

    def make_gate(self, bus: Bus | None = None) -> Gate:
        """One for orders to a program of ours: it hears of who is turned out as we do."""
        self._made.append(gate := Gate(self.credentials, bus=bus))
        return gate

    def check_role(self, key: str, given: Collection[str] = ()) -> None:
        """Raise :class:`Forbidden` where our own role may not use that key: the routers between drop it in silence.

        ``given``: verbs that the vehicle's fleet file may have given us; we do not know it.
        """
        may(self.credentials.role, self.credentials.name, *keys.match(key), given)

    # In.

    def judge(self, key: str, payload: bytes, attachment: bytes | None, newest: dict[Place, float]) -> None:
        """Raise :class:`Forbidden` for what its name says that it did not: a vehicle's state or event that it did not
        sign; a frame or a beacon, which are not signed, under a name that is no vehicle's; a fleet's topic or an
        obstacle that nobody signed who may put it. Other keys are not judged.

        ``newest``: one reader's own, of when the newest that it believed were signed (UTC seconds). What is no newer
        was heard before, or overtaken.
        """
        _, fleet, name, *rest = (*key.split("/", 3), "", "", "")
        if rest[0].startswith(_UNSIGNED) and not self.verifier.is_vehicle(fleet, name):
            self._disown(name)
        if not key.endswith(_ENDS) and "/@" not in key:
            return
        try:
            channel, parts = keys.match(key)
        except BadKey:
            return
        topic = keys.told_to_all(channel, parts)
        if channel not in SIGNED and not topic:
            return
        try:
            place = (key, "") if topic else (parts["fleet"], parts["vehicle"])
            if channel is keys.STATE:  # events are cached and recovered, so an old one is no forgery
                self.verifier.check_time(self.verifier.read(attachment, fresh=False), self._clocks.get(place, 0.0))
            found, certificate = self.verifier.verify(key, payload, attachment, fresh=topic)
            if topic:
                place = (key, certificate.name)
                may(certificate.role, certificate.name, channel, parts)
                check_source(certificate.role, certificate.name, channel, payload)
            else:
                self._check_speaker(certificate, place)
            if channel is keys.STATE:
                self._hear(*place, channel, certificate)
            if channel is not keys.EVENT:
                t = found.t
                # Both were fresh when they came: one that is farther ahead than that shows that the clocks were set.
                if t <= newest.get(place, 0.0) <= t + 2 * WINDOW:
                    raise Forbidden("it was signed before the last one that came", reason="replayed")
                newest[place] = t
        except Forbidden as e:
            self.counts[str(e.detail["reason"])] += 1
            raise

    def believe(self, key: str, payload: bytes, proof: bytes | None, question: bytes | None) -> None:
        """Raise :class:`Forbidden` for an answer that does not come from who may answer there; where answers are not
        signed, any is believed. ``question``: the attachment of what was asked.

        The clocks do not matter: the asker's challenge says that it is new.
        """
        allowed = keys.answerers(key)
        if not allowed:
            return
        vehicle = keys.match(key)[1]["vehicle"]
        try:
            named = challenge(question) or NOTHING
            _, certificate = self.verifier.verify_answer(key, payload, proof, named)
            if not acts_as(certificate.role, certificate.name, vehicle) & set(allowed):
                text = f"{certificate.name} ({certificate.role.value}) answered in the place of {vehicle}"
                raise Forbidden(text, reason="name", origin=certificate.name)
            channel, parts = keys.match(key)
            self._hear(parts["fleet"], vehicle, channel, certificate)
        except Forbidden as e:
            self.counts[f"answer {e.detail['reason']}"] += 1
            raise

    def _hear(self, fleet: str, vehicle: str, channel: keys.Channel, certificate: Certificate) -> None:
        """That is who answers there."""
        with self._lock:
            if len(self._hearers) < MOST_HEARERS or (fleet, vehicle, channel.name) in self._hearers:
                self._hearers[fleet, vehicle, channel.name] = certificate

    def _disown(self, name: str) -> None:
        role = self.verifier.role_of(name)
        reason, is_ = ("role", f"a {role}") if role else ("unknown", "not on the roster")
        self.counts[reason] += 1
        raise Forbidden(f"only a vehicle says this, and {name} is {is_}", reason=reason, origin=name)

    def take_time(self, place: Place, key: str, payload: bytes, attachment: bytes | None, challenge: bytes) -> None:
        """From the state with which a vehicle answers our challenge: its states are of now by its own clock since.

        Raises :class:`Forbidden` for another's, or for no answer to it.
        """
        found, certificate = self.verifier.verify_answer(key, payload, attachment, challenge)
        self._check_speaker(certificate, place)
        self._clocks[place] = self.verifier.ahead(found)

    def _check_speaker(self, certificate: Certificate, place: Place) -> None:
        if (certificate.name, certificate.role) != (place[1], Role.VEHICLE):
            text = f"{certificate.name} ({certificate.role.value}) signed it, and speaks as {place[1]}"
            raise Forbidden(text, reason="name", origin=certificate.name)

    def take_roster(self, data: bytes) -> None:
        """A roster that came over the network: what is none, or no newer than ours, changes nothing. On one thread.

        The number that it says it has is looked at first, so that what is old costs those that are new no room.
        """
        try:
            signed = read_signed(data)
            if signed.number <= self.verifier.roster.number:
                return
            if not self._rosters.take():
                self.counts["roster busy"] += 1
                return
            roster = signed.open(self.verifier.authority, self.verifier.fleet)
            for verifier in (self.verifier, *self._made):
                verifier.roster = roster
        except BadInput:
            self.counts["roster"] += 1


def _gate(text: object) -> bytes:
    """As it stands in a state or a refusal; empty for what is none."""
    try:
        found = bytes.fromhex(text) if isinstance(text, str) else b""
    except ValueError:
        return b""
    return found if len(found) == ANSWERS else b""
