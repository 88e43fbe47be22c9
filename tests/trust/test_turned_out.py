"""A newer roster at a vehicle: whom the fleet has turned out commands no more."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from zmav import wire
from zmav.client import Answer
from zmav.errors import Forbidden
from zmav.trust.roster import Roster, read_signed

if TYPE_CHECKING:
    from tests.trust.conftest import Guarded, StartGuarded


def newer(g: Guarded) -> Roster:
    return read_signed(g.authority.roster()).open(g.authority.certificate, "demo")


async def test_the_lease_of_who_was_turned_out_ends_at_once(guarded: StartGuarded) -> None:
    g: Guarded = await guarded()
    async with g.client("swap", "planner") as z:
        vehicle, member = z.vehicle("quad1"), z.member
        assert member is not None
        certificate = member.credentials.certificate
        async with vehicle.lease("alice", ttl=30.0):
            g.vehicle.take_roster(newer(g))
            assert g.vehicle.leases.holder == "alice", "it was admitted later than that roster was signed"
            again = {"name": "swap", "role": "planner", "fingerprint": "00" * 8, "not_after": certificate.not_after}
            g.authority.members.append(again)  # the name was given again, with another key
            g.authority.revoked.append(certificate.fingerprint.hex())
            g.vehicle.take_roster(newer(g))
            assert g.vehicle.leases.holder is None
            await g.b.event("lease of alice ended: the fleet turned swap out", kind="lease")
            with pytest.raises(Forbidden, match="revoked"):
                await vehicle.ping()


async def test_a_reader_who_was_turned_out_asks_a_flying_vehicle_in_vain(guarded: StartGuarded) -> None:
    g: Guarded = await guarded()
    asked = ("param", "body", "rates", "host", "msg/HEARTBEAT", "mission/mission", "file/x", "link/autopilot")
    async with g.client("lab", "viewer") as lab, g.client("alice", "operator") as alice:
        assert lab.member is not None
        assert [a for a in await lab.ask("zmav/demo/quad1/body") if isinstance(a, Answer)]
        await g.b.flying()
        g.authority.revoked.append(lab.member.credentials.certificate.fingerprint.hex())
        g.vehicle.take_roster(newer(g))
        for what in asked:
            answers = await lab.ask(f"zmav/demo/quad1/{what}")
            assert [type(a) for a in answers] == [Forbidden], what
            assert isinstance(answers[0], Forbidden)
            assert answers[0].detail["reason"] == "revoked"
        # Its state it publishes; and by asking for it over a challenge a member whose clock is off believes it again.
        assert [type(a) for a in await lab.ask("zmav/demo/quad1/state")] == [Answer]
        unsigned = await g.b.ground.ask("zmav/demo/quad1/body")
        assert [wire.error_from(r.err.payload.to_bytes()).detail["reason"] for r in unsigned if r.err] == ["unsigned"]
        for what in ("body", "state"):  # who is a member still signs it when it is told to, and is answered
            assert [type(a) for a in await alice.ask(f"zmav/demo/quad1/{what}")] == [Answer], what
        assert [type(a) for a in await alice.ask("zmav/demo/*/body")] == [Answer]
