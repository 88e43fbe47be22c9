"""A member on the key space: signs what it asks and puts, and believes of vehicles what they signed."""

from __future__ import annotations

import collections
import threading
import time
from collections.abc import Callable, Collection

from zmav import keys
from zmav.errors import BadInput, BadKey, Forbidden
from zmav.trust.certificate import Role
from zmav.trust.credentials import Credentials
from zmav.trust.gate import EPOCH
from zmav.trust.proof import ANSWERS, NOTHING, WINDOW, Signer
from zmav.trust.rights import may
from zmav.trust.roster import read_signed
from zmav.trust.verify import Allowance, Verifier

INTRODUCE_EVERY = 5.0
"""s between two puts to a vehicle that carry our certificate; orders always do"""
GRACE = 86_400.0
"""s that what a vehicle says is believed after its certificate's end: who flies it is not to lose sight of it"""
ROSTERS = 20.0
"""rosters that are looked at in a second: anybody may bring one, and the true one comes again"""
SIGNED = (keys.STATE, keys.EVENT)
"""what vehicles sign of what they publish"""
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
        self.verifier, self._signer = Verifier.of(credentials, GRACE), Signer(credentials)
        self._gates: dict[Place, bytes] = {}
        self._others: dict[tuple[Place, str], bytes] = {}
        """of channels on which somebody else answers than the vehicle's agent: it has a gate of its own"""
        self._introduced: dict[Place, float] = {}
        self._lock = threading.Lock()
        self._rosters = Allowance(ROSTERS, monotonic)
        self.counts: collections.Counter[str] = collections.Counter()
        """states and events that were not believed, by reason"""

    # Out.

    def proof(self, key: str, payload: bytes) -> bytes | None:
        """The attachment for what is asked or put on a concrete key; None where the channel needs none."""
        try:
            channel, parts = keys.match(key)
        except BadKey:
            return None
        if not channel.proven:
            return None
        place = (parts["fleet"], parts["vehicle"])
        introduce = self._introduces(place) or channel is keys.DO
        gate = self._others.get((place, channel.name)) or self._gates.get(place, NOTHING)
        return self._signer.sign(key, payload, introduce=introduce, answers=gate)

    def _introduces(self, place: Place) -> bool:
        now = self._monotonic()
        with self._lock:
            if now - self._introduced.get(place, -INTRODUCE_EVERY) < INTRODUCE_EVERY:
                return False
            self._introduced[place] = now
            return True

    def answers(self, place: Place, gate: object) -> None:
        """What proofs for this vehicle are to answer from now on, as its state says."""
        found = _gate(gate)
        if found and self._gates.get(place) != found:
            with self._lock:
                self._gates[place] = found
                self._introduced.pop(place, None)
                self._others = {at: other for at, other in self._others.items() if at[0] != place}

    def may_try_again(self, key: str, error: Forbidden) -> bool:
        """A refusal that another proof mends: the vehicle's agent has been started anew, or does not know us yet."""
        channel, parts = keys.match(key)
        place, reason = (parts["fleet"], parts["vehicle"]), error.detail.get("reason")
        if reason == EPOCH and (gate := _gate(error.detail.get("gate"))):
            with self._lock:
                self._others[place, channel.name] = gate
                self._introduced.pop(place, None)
        elif reason == "unknown":
            with self._lock:
                self._introduced.pop(place, None)
        else:
            return False
        return True

    def check_role(self, key: str, given: Collection[str] = ()) -> None:
        """Raise :class:`Forbidden` where our own role may not use that key: the routers between drop it in silence.

        ``given``: verbs that the vehicle's fleet file may have given us; we do not know it.
        """
        may(self.credentials.role, self.credentials.name, *keys.match(key), given)

    # In.

    def judge(self, key: str, payload: bytes, attachment: bytes | None, newest: dict[Place, float]) -> None:
        """Raise :class:`Forbidden` for a vehicle's state or event that it did not sign, and for frames and beacons,
        which are not signed, under a name that is no vehicle's; other keys are not judged.

        ``newest``: one reader's own, of when the newest states that it believed were signed (UTC seconds). A state that
        is no newer was heard before, or overtaken.
        """
        _, fleet, name, *rest = (*key.split("/", 3), "", "", "")
        if rest[0].startswith(_UNSIGNED) and not self.verifier.is_vehicle(fleet, name):
            self._disown(name)
        if not key.endswith(_ENDS):
            return
        try:
            channel, parts = keys.match(key)
        except BadKey:
            return
        if channel not in SIGNED:
            return
        place = (parts["fleet"], parts["vehicle"])
        try:
            t = self._signed_at(channel, place, key, payload, attachment)
            if channel is keys.STATE:
                # Both were fresh when they came: one that is farther ahead than that shows that the clocks were set.
                if t <= newest.get(place, 0.0) <= t + 2 * WINDOW:
                    raise Forbidden("it was signed before the last one that came", reason="replayed")
                newest[place] = t
        except Forbidden as e:
            self.counts[str(e.detail["reason"])] += 1
            raise

    def _disown(self, name: str) -> None:
        role = self.verifier.role_of(name)
        reason, is_ = ("role", f"a {role}") if role else ("unknown", "not on the roster")
        self.counts[reason] += 1
        raise Forbidden(f"only a vehicle says this, and {name} is {is_}", reason=reason, origin=name)

    def _signed_at(
        self, channel: keys.Channel, place: Place, key: str, payload: bytes, attachment: bytes | None
    ) -> float:
        # Events are cached and recovered, so an old one is no forgery.
        found, certificate = self.verifier.verify(key, payload, attachment, fresh=channel is keys.STATE)
        if (certificate.name, certificate.role) != (place[1], Role.VEHICLE):
            text = f"{certificate.name} ({certificate.role.value}) signed it, and speaks as {place[1]}"
            raise Forbidden(text, reason="name", origin=certificate.name)
        return found.t

    def take_roster(self, data: bytes) -> None:
        """A roster that came over the network: what is none, or older than ours, changes nothing. On one thread."""
        if not self._rosters.take():
            return
        try:
            signed = read_signed(data)
            self.verifier.roster = signed.open(self.verifier.authority, self.verifier.fleet)
        except BadInput:
            self.counts["roster"] += 1


def _gate(text: object) -> bytes:
    """As it stands in a state or a refusal; empty for what is none."""
    try:
        found = bytes.fromhex(text) if isinstance(text, str) else b""
    except ValueError:
        return b""
    return found if len(found) == ANSWERS else b""
