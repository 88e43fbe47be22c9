"""What is said under names that are no vehicle's: a vehicle in flight takes no notice of it."""

from __future__ import annotations

import collections
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest

from zmav import keys, wire
from zmav.config import Separation
from zmav.errors import Forbidden
from zmav.tokens import OF_EACH, STRANGERS
from zmav.trust.certificate import Role
from zmav.trust.member import Member
from zmav.trust.rights import may
from zmav.trust.verify import Verifier
from zmav.wire.swarm import Beacon

if TYPE_CHECKING:
    from tests.trust.conftest import Authority, StartGuarded

ORIGIN = wire.Origin(lat_deg=-35.363261, lon_deg=149.165230, alt_amsl=584.09)


def token(name: str, instance: object) -> str:
    about: dict[str, Any] = {"role": keys.VEHICLE, "sys": 1, "autopilot": "ardupilot", "uid": f"uid-{instance}"}
    return keys.ALIVE.key("demo", name, instance=instance, **about)


def counting(call: Callable[[], None], name: str, calls: collections.Counter[str]) -> Callable[[], None]:
    def count() -> None:
        calls[name] += 1
        call()

    return count


async def test_beacons_of_who_is_no_vehicle_push_nobody(guarded: StartGuarded) -> None:
    g = await guarded(origin=ORIGIN, separation=Separation(on=True))
    assert g.vehicle.gate is not None
    g.vehicle.gate.learn(g.authority.member("quad2", "vehicle").certificate.der)
    g.vehicle.gate.learn(g.authority.member("view", "viewer").certificate.der)
    said = wire.encode(Beacon(t=time.time(), pos=(0.0, 0.0, -5.0), vel=(0.0, 0.0, 0.0), radius=1.0, ahead=[]))
    for name in ("view", "ghost", "quad2"):  # in this order
        g.b.ground.session.put(keys.BEACON.key("demo", name), said)
    await g.b.state(lambda state: bool(g.vehicle.separation.neighbours()), "a neighbour")
    assert [other.name for other in g.vehicle.separation.neighbours()] == ["quad2"]


async def test_a_flood_of_tokens_is_neither_remembered_nor_judged_one_by_one(
    guarded: StartGuarded, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each that seems to clash was compared with all before it: 10,000 of a viewer held a vehicle up for 24 s."""
    g = await guarded()
    presence, calls = g.vehicle.presence, collections.Counter[str]()
    for name in ("_judge", "tick"):
        monkeypatch.setattr(presence, name, counting(getattr(presence, name), name, calls))
    declare = g.b.ground.session.liveliness().declare_token
    flood = [declare(token(f"ghost{n % 100}", n)) for n in range(3000)]
    await g.b.state(lambda state: len(presence.others.strangers()) == STRANGERS, "some of them")
    assert len(presence.others) <= STRANGERS * OF_EACH
    assert presence.clash is None
    assert calls["_judge"] <= calls["tick"], "a token that proves nothing is not worth a look at all the others"
    for each in flood:
        each.undeclare()


def test_who_is_a_vehicle(authority: Authority) -> None:
    """By the newest roster, and by a certificate that was met before we had it."""
    ours = authority.member("quad1", "vehicle")
    verifier = Verifier.of(ours)
    assert not verifier.is_vehicle("demo", "quad2")
    quad2, view = (authority.member(name, role) for name, role in (("quad2", "vehicle"), ("view", "viewer")))
    for one in (quad2, view):
        verifier.meet(one.certificate.der)
    assert verifier.is_vehicle("demo", "quad2") and not verifier.is_vehicle("demo", "view")
    assert not verifier.is_vehicle("other", "quad2")
    member = Member(ours)
    member.verifier.meet(view.certificate.der)
    for channel in (keys.RX, keys.BEACON):
        key = channel.key("demo", "view", sys=1, comp=1, msg="HEARTBEAT")
        with pytest.raises(Forbidden, match="only a vehicle says this"):
            member.judge(key, b"", None, {})
    authority.revoked.append(quad2.certificate.fingerprint.hex())
    member.take_roster(authority.roster())
    verifier.roster = member.verifier.roster
    assert not verifier.is_vehicle("demo", "quad2"), "it was turned out"


@pytest.mark.parametrize("role", Role)
def test_tokens_say_what_their_giver_is(role: Role) -> None:
    """A viewer that is present as a planner would have the planners believe that somebody else is in charge."""
    allowed = {
        Role.VIEWER: {"viewer", "router"},
        Role.PLANNER: {"viewer", "router", "planner"},
        Role.OPERATOR: {"viewer", "router", "planner", "operator"},
        Role.VEHICLE: {"viewer", "router", "vehicle"},
    }[role]
    for said in ("viewer", "router", "planner", "operator", "vehicle"):
        parts = {"vehicle": "x1", "role": said, "fleet": "demo"}
        if said in allowed:
            may(role, "x1", keys.ALIVE, parts)
        else:
            with pytest.raises(Forbidden):
                may(role, "x1", keys.ALIVE, parts)


def test_a_gate_of_a_members_program_hears_who_is_turned_out(authority: Authority) -> None:
    """A planner's, or another agent's: it runs on while the fleet turns somebody out."""
    member = Member(authority.member("plan", "planner"))
    out = authority.member("out", "operator")
    gate = member.make_gate()
    authority.revoked = [out.certificate.fingerprint.hex()]
    member.take_roster(authority.roster())
    assert gate.roster.is_revoked(out.certificate.fingerprint)
